"""The table of recorded signals: one row more is one more column, curve, plot and line of the docs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from rerun.chunk import RrdReader

from hil.edge.record import signals
from hil.edge.record.manifest import RunMode
from hil.edge.record.run_folder import RunFolder
from hil.edge.record.signals import Curve, Signal, markdown_table, recorded
from hil.review import blueprint
from hil.review.ticks import read_ticks
from tests.review import toy

MINE = Signal(
    "error1_V",
    "V",
    "control error of output 1",
    lambda step: step.record.reference_V[0] - step.record.estimated_V[0],
    Curve("control/error", "error 1"),
)


def test_one_row_more_is_recorded_drawn_and_documented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An own recorded signal touches one file. It used to take four: columns, row, series and blueprint."""
    monkeypatch.setattr(signals, "SIGNALS", (*signals.SIGNALS, MINE))
    folder = toy.record_run(tmp_path / "run", with_rerun=True, until_s=5.0)
    ticks = read_ticks(folder.ticks_path)
    assert ticks["error1_V"] == pytest.approx(ticks["r1_V"] - ticks["h1_est_V"], abs=1e-5)
    chunks = RrdReader(folder.rrd_path).stream().to_chunks()
    drawn = [chunk for chunk in chunks if chunk.entity_path == "/control/error"]
    assert sum(chunk.num_rows for chunk in drawn if not chunk.is_static) == 50
    assert any("error 1 [V]" in str(chunk.to_record_batch().to_pylist()) for chunk in drawn if chunk.is_static)
    assert "| `error1_V` | V | control error of output 1 | every run | `control/error` |\n" in markdown_table()


@pytest.mark.parametrize("entity", ["levels/mine", "pumps/mine", "control/mine", "bench/mine", "mine"])
@pytest.mark.parametrize("mode", ["lockstep", "live"])
def test_every_drawn_entity_is_in_one_plot_of_the_layout(
    monkeypatch: pytest.MonkeyPatch, entity: str, mode: RunMode
) -> None:
    """Latency and recorder queue used to be recorded and shown nowhere."""
    row = Signal("mine_V", "V", "mine", lambda step: step.record.t_s, Curve(entity, "mine"))
    monkeypatch.setattr(signals, "SIGNALS", (*signals.SIGNALS, row))
    shown: list[str] = []
    real = blueprint._Layout._plot

    def plot(layout: blueprint._Layout, one: str, is_plain: bool = False) -> Any:
        shown.append(one)
        return real(layout, one, is_plain)

    monkeypatch.setattr(blueprint._Layout, "_plot", plot)
    blueprint.blueprint(mode, 10.0)
    expected = {signal.curve.entity for signal in recorded(mode) if signal.curve}
    assert sorted(shown) == sorted(expected)
    assert entity in expected


def test_columns_are_named_once_and_documented_in_their_order() -> None:
    columns = [signal.column for signal in signals.SIGNALS]
    assert len(set(columns)) == len(columns)
    lines = markdown_table().splitlines()[2:]
    assert [line.split("`")[1] for line in lines] == columns
    assert all(signal.meaning and "|" not in signal.meaning for signal in signals.SIGNALS)


def test_the_run_folder_of_each_mode_has_its_own_columns(tmp_path: Path) -> None:
    for name in ("lockstep", "live"):
        folder: RunFolder = toy.record_run(tmp_path / name, live=name == "live", until_s=1.0)
        header = folder.ticks_path.read_text().partition("\n")[0]
        assert header.split(",") == [signal.column for signal in recorded(folder.manifest().plan.mode)]


def test_curve_and_meaning_have_the_number_of_their_signal() -> None:
    """Tank 2 is drawn as tank 2 and explained as tank 2. K12 is the gain from state 2 to pump 1."""

    def numbers(text: str) -> list[str]:
        return re.findall(r"[0-9]", text.partition(":")[0])

    for signal in signals.SIGNALS:
        names = [signal.meaning, *([signal.curve.name] if signal.curve else [])]
        for name in names:
            assert numbers(name) in ([], numbers(signal.column), numbers(signal.column)[::-1]), (signal.column, name)
    assert sum(numbers(signal.meaning) != [] for signal in signals.SIGNALS) >= 30
