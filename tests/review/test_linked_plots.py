"""The plots of a recording share one time range, and a recording without steps is small."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rerun.chunk import RrdReader

from hil.edge.record.rerun_log import APPLICATION, RerunLog, RunCard
from hil.review.blueprint import SHARED_AXIS, blueprint, live_blueprint


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording without a step; what an installed package's law would show is left out."""
    path = tmp_path_factory.mktemp("empty") / "run.rrd"
    layout = blueprint("live", 500.0, has_picture=True)
    RerunLog(path, RunCard("empty", {}, ""), level_gain_V_cm=0.5, mode="live", blueprint=layout).close()
    return path


def layout_rows(path: Path) -> dict[str, dict[str, Any]]:
    """Entity of the layout -> its only row."""
    reader = RrdReader(path)
    (store,) = reader.blueprints()
    return {c.entity_path: c.to_record_batch().to_pylist()[0] for c in reader.stream(store=store).to_chunks()}


def test_who_zooms_one_plot_zooms_all_and_they_open_on_the_whole_run(empty: Path) -> None:
    """The plots opened on one range, but each was zoomed and moved for itself."""
    rows = layout_rows(empty)
    shared = rows.pop(f"/{SHARED_AXIS}")["TimeAxis:view_range"][0]
    assert [shared["start"], shared["end"]] == [0, 500 * 10**9]
    classes = ("TimeSeries", "StateTimeline")
    views = [e for e, row in rows.items() if row.get("ViewBlueprint:class_identifier") in [[c] for c in classes]]
    links = [rows[f"{view}/TimeAxis"]["TimeAxis:link"] for view in views]
    assert len(links) > 25
    assert links == [[2]] * len(links), "to the shared range"


def test_the_plots_of_a_run_that_goes_on_share_its_last_minutes(tmp_path: Path) -> None:
    path = tmp_path / "live.rbl"
    live_blueprint("live", has_picture=True).save(APPLICATION, str(path))
    shared = layout_rows(path)[f"/{SHARED_AXIS}"]["TimeAxis:view_range"][0]
    assert shared["start"] is not None


def test_a_recording_without_steps_is_small(empty: Path) -> None:
    """Each part of the layout costs some 3 kB, most of it in the file's index; 188 parts made 0.6 MB."""
    assert empty.stat().st_size < 620_000
