"""Stored records of format 1: empty cells in ticks.csv, R and T and monotonic times in can.log."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import can
import numpy as np
import pytest

from hil.edge.record.manifest import ClockOffsets
from hil.edge.record.run_folder import RunFolder
from hil.review.kpi import compute
from hil.review.run_report import write_report
from hil.review.ticks import read_ticks

STORED = Path(__file__).parent / "format1"


@pytest.fixture(params=["lockstep", "live"])
def stored(request: pytest.FixtureRequest, tmp_path: Path) -> RunFolder:
    shutil.copytree(STORED / request.param, tmp_path / "run")
    return RunFolder.open(tmp_path / "run")


def test_a_stored_record_of_format_1_is_read_and_reported(stored: RunFolder) -> None:
    """Nothing read one before: a program that took format 2 only passed all tests."""
    assert json.loads(stored.manifest_path.read_text())["format"] == 1
    manifest = stored.manifest()
    assert (manifest.status, manifest.clock) == ("complete", ClockOffsets(None, None))
    kpi = compute(stored)
    assert kpi.ticks == 20
    assert kpi.iae_source == ("truth" if manifest.plan.mode == "lockstep" else "estimate")
    text = write_report(stored).read_text(encoding="utf-8")
    assert "Upper tanks." in text
    assert manifest.plan.scenario in text


def test_key_figures_of_a_stored_record_are_those_of_its_time() -> None:
    before = json.loads((STORED / "lockstep" / "kpi.json").read_text())
    folder = RunFolder.open(STORED / "lockstep")
    from hil.review.kpi import evaluate
    from hil.review.ticks import read

    now = evaluate(folder.manifest(), *read(folder))
    assert now.iae_Vs["after_the_fault"] == pytest.approx(before["iae_Vs"]["after_the_fault"])
    assert list(now.level_max_cm) == pytest.approx(before["level_max_cm"])
    assert [alarm["detected_s"] for alarm in now.alarms] == [alarm["detected_s"] for alarm in before["alarms"]]


def test_cells_that_a_run_could_not_know_are_not_a_number(stored: RunFolder) -> None:
    ticks = read_ticks(stored.ticks_path)
    is_live = stored.manifest().plan.mode == "live"
    assert ticks.has_truth == (not is_live)
    assert np.isnan(ticks["latency_s"]).all() == (not is_live)


def test_its_can_log_is_read_with_the_direction(stored: RunFolder) -> None:
    with can.LogReader(stored.can_log_path) as reader:
        frames = list(reader)
    assert {frame.is_rx for frame in frames} == {True, False}
