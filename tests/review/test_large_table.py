"""A tick table of a long run, read in pieces: the same numbers as all at once, in less memory."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review import kpi, run_report, ticks
from hil.review.alarms import Injected
from hil.review.run_figures import _shares_left
from hil.review.ticks import Ticks, read_ticks


@pytest.fixture
def in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the tables of the tests were larger than what is read at once."""
    monkeypatch.setattr(ticks, "LARGE_BYTES", 1)
    monkeypatch.setattr(ticks, "PIECE_BYTES", 1 << 16)


def test_pieces_give_the_same_numbers(whole_run: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = read_ticks(whole_run.ticks_path)
    monkeypatch.setattr(ticks, "LARGE_BYTES", 1)
    for piece_bytes in (1 << 17, 500_001, 1 << 23):
        monkeypatch.setattr(ticks, "PIECE_BYTES", piece_bytes)
        table = read_ticks(whole_run.ticks_path)
        assert list(table.columns) == list(at_once.columns)
        for name, values in at_once.columns.items():
            np.testing.assert_array_equal(table[name], values, err_msg=name)
    assert not table["t_s"].flags.writeable


@pytest.mark.usefixtures("in_pieces")
def test_cells_of_every_kind_and_half_a_last_line(tmp_path: Path) -> None:
    path = tmp_path / "ticks.csv"
    path.write_text("t_s,a,b\n1.0,inf,NaN\n2.0,-inf,nan\n3.0,,1e-320\n4.0,-0.1,2\n5.0,1.")
    table = read_ticks(path)
    np.testing.assert_array_equal(table["t_s"], [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(table["a"], [np.inf, -np.inf, np.nan, -0.1])
    np.testing.assert_array_equal(table["b"], [np.nan, np.nan, 1e-320, 2.0])
    path.write_text("t_s,a,b\n1.0")
    assert len(read_ticks(path)) == 0


@pytest.mark.parametrize("is_large", [False, True])
def test_columns_on_demand(whole_run: RunFolder, monkeypatch: pytest.MonkeyPatch, is_large: bool) -> None:
    if is_large:
        monkeypatch.setattr(ticks, "LARGE_BYTES", 1)
    table = read_ticks(whole_run.ticks_path, ("v1_V", "not_recorded"))
    assert list(table.columns) == ["t_s", "v1_V"]
    assert len(table["v1_V"]) == 5000


@pytest.mark.usefixtures("in_pieces")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t_s,a\n1.0,x\n", r"ticks\.csv is damaged: .*'x'"),
        ("t_s,a\n1.0,2.0,3.0\n", r"ticks\.csv is damaged: .*Expected 2 columns, got 3"),
        ("a,b\n1.0,2.0\n", "has no column t_s"),
    ],
)
def test_what_is_damaged_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "ticks.csv"
    path.write_text(text)
    with pytest.raises(RunFolderError, match=message):
        read_ticks(path)


class Watched(dict[str, Any]):
    """Columns, and which of them were asked for."""

    def __init__(self, columns: Mapping[str, Any]) -> None:
        super().__init__(columns)
        self.asked: set[str] = set()

    def __getitem__(self, name: str) -> Any:
        self.asked.add(name)
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self.asked.add(name)
        return super().get(name, default)


def test_figures_and_report_need_no_other_column_than_they_say(whole_run: RunFolder) -> None:
    """Of a long run only these columns are read."""
    manifest, (table, events) = whole_run.manifest(), ticks.read(whole_run)
    asked = Watched(table.columns)
    figures = kpi.evaluate(manifest, Ticks(asked), events)
    assert asked.asked <= set(kpi.COLUMNS)
    assert kpi.evaluate(manifest, ticks.read(whole_run, kpi.COLUMNS)[0], events) == figures
    assert len(kpi.COLUMNS) < len(table.columns) / 2
    run_report.render(run_report.Run(manifest, Ticks(asked), events, figures))
    assert asked.asked <= set(run_report.COLUMNS)


def test_the_effectiveness_that_faults_leave_is_that_of_each_moment() -> None:
    """It was computed step by step: a quarter of the report of a long run."""
    faults = (
        Injected("pump_effectiveness", 1, 0.4, at_s=10.0, until_s=60.0, ramp_s=7.0),
        Injected("pump_effectiveness", 1, 0.7, at_s=20.0, period_s=9.0, duty=0.3),
        Injected("pump_dead", 1, 0.0, at_s=80.0, until_s=90.0),
    )
    times_s = np.arange(0.0, 100.0, 0.1)

    def share(t_s: float) -> float:
        there = [fault for fault in faults if fault.course.is_present(t_s)]
        return there[-1].course.size(t_s, 1.0, there[-1].value) if there else 1.0

    np.testing.assert_allclose(_shares_left(faults, times_s), [share(t_s) for t_s in times_s.tolist()], atol=1e-12)


def test_reading_in_pieces_imports_no_pandas(tmp_path: Path) -> None:
    """Arrow imports pandas for a conversion to numpy: a second for each report."""
    path = tmp_path / "ticks.csv"
    path.write_text("t_s,a\n1.0,2.0\n")
    code = (
        "import sys; from pathlib import Path; from hil.review import ticks; ticks.LARGE_BYTES = 1\n"
        f"assert ticks.read_ticks(Path({str(path)!r}))['a'][0] == 2.0; print('pandas' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
