"""Runs compared: what differs, figures and ratios, alignment, records that are not whole."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from hil.compare.compared_run import CompareError, compared_runs, names_of, run_paths
from hil.compare.comparison import Comparison
from hil.compare.figure_rows import figure_rows, label
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review import kpi
from hil.review.moment import UnknownMomentError


def test_only_what_differs_is_a_difference(runs: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    text = json.loads((runs / "first/run.json").read_text())
    text["seed"] = 2
    text["settings"]["rig"]["sensors"]["gain_V_cm"] = 0.25
    text["settings"]["scenario"]["fault"][1]["value"] = 0.6
    text["settings"]["rig"]["tanks"]["new"] = [1.0, 2.0]
    text["copies"]["bench.dbc"] = "another"
    (other / "run.json").write_text(json.dumps(text))
    for name in ("ticks.csv", "events.jsonl"):
        (other / name).write_bytes((runs / "first" / name).read_bytes())
    found = Comparison.of([runs / "first", other, runs / "killed"]).differences
    assert {one.key: one.values for one in found} == {
        "seed": ("1", "2", "1"),
        "rig.sensors.gain_V_cm": ("0.5", "0.25", "0.5"),
        "rig.tanks.new": ("–", "[1, 2]", "–"),
        "scenario.fault[1].value": ("0.4", "0.6", "0.4"),
        "file bench.dbc": ("–", "text A", "–"),
    }


def test_runs_of_one_configuration_have_no_difference(runs: Path) -> None:
    assert Comparison.of([runs / "first", runs / "slow"]).differences == ()


def test_figures_are_those_of_kpi_json_with_ratios_to_the_first(runs: Path) -> None:
    comparison = Comparison.of([runs / "first", runs / "fixed", runs / "slow"])
    rows = {row.key: row for row in comparison.rows}
    expected = [kpi.compute(RunFolder.open(runs / name)).iae_Vs["gain_fall"][0] for name in ("first", "fixed", "slow")]
    row = rows["iae_Vs.gain_fall[0]"]
    assert row.values == pytest.approx(expected)
    assert row.ratios == pytest.approx([1.0, expected[1] / expected[0], expected[2] / expected[0]])
    assert (row.low, row.median, row.high) == (min(expected), sorted(expected)[1], max(expected))
    assert (row.label, row.unit) == ("IAE (gain_fall), output 1", "V s")
    assert rows["alarms"].values == (2.0, 0.0, 2.0)
    assert rows["overflow"].values == (False, False, False)
    assert rows["overflow"].is_same


def test_two_runs_have_no_spread(runs: Path) -> None:
    assert all(row.median is None for row in Comparison.of([runs / "first", runs / "fixed"]).rows)


@pytest.mark.parametrize(
    ("values", "ratios"),
    [([2.0, 3.0], (1.0, 1.5)), ([0, 3.0], (None, None)), ([None, 3.0], (None, None)), ([2.0, None], (1.0, None))],
)
def test_there_is_no_ratio_to_nothing(values: list[float | None], ratios: tuple[float | None, ...]) -> None:
    (row,) = figure_rows([{"level_max_cm": [value]} for value in values])
    assert row.ratios == ratios


def test_a_figure_that_an_older_record_lacks_is_a_gap_in_its_place() -> None:
    rows = figure_rows([{"a_s": 1.0, "c_s": 3.0}, {"a_s": 1.0, "b_s": 2.0, "c_s": 3.0}])
    assert [row.key for row in rows] == ["a_s", "b_s", "c_s"]
    assert rows[1].values == (None, 2.0)


def test_a_window_that_a_run_did_not_reach_has_no_error() -> None:
    """Its integral used to be 0, and so the best of all runs."""
    ended = {"iae_Vs": {"late": [0.0, 0.0]}, "iae_covered_s": {"late": 0.0}}
    whole = {"iae_Vs": {"late": [2.0, 1.0]}, "iae_covered_s": {"late": 9.0}}
    row = {row.key: row for row in figure_rows([whole, ended])}["iae_Vs.late[0]"]
    assert (row.values, row.ratios) == ((2.0, None), (1.0, None))


def test_labels_say_what_a_path_means() -> None:
    assert label("level_max_cm[2]") == "highest level, tank 3"
    assert label("applied_max_V[0]") == "largest applied voltage, pump 1"
    assert label("commands.frames_lost") == "frames lost"
    assert label("new_figure_s") == "new figure s"


def test_runs_are_aligned_at_an_event_or_a_time(runs: Path) -> None:
    first, slow = compared_runs([runs / "first", runs / "slow"], "alarm:2")
    assert (first.zero_s, slow.zero_s) == (201.0, 201.0)
    for run in (first, slow):
        alarm = int(np.flatnonzero(run.times_s == 0.0)[0])
        assert run.ticks["theta1"][alarm - 1 : alarm + 1].tolist() == [1.0, 0.4]
    assert compared_runs([runs / "first", runs / "slow"], "100")[0].times_s[0] == -100.0


@pytest.mark.parametrize(("align", "said"), [("trip", "no trip event; it has"), ("alarm:9", "1, 2"), ("999", "lasts")])
def test_a_run_without_the_moment_is_named(runs: Path, align: str, said: str) -> None:
    with pytest.raises(UnknownMomentError, match=re.escape(f"--align {align}")) as raised:
        compared_runs([runs / "first", runs / "fixed"], align)
    assert said in str(raised.value)
    assert str(runs / "first") in str(raised.value)


def test_periods_that_differ_killed_and_empty_runs_are_said_in_a_line_each(runs: Path) -> None:
    comparison = Comparison.of([runs / name for name in ("first", "slow", "killed", "bare")])
    notes = "\n".join(comparison.notes)
    assert "killed: unfinished" in notes
    assert "bare: no control step" in notes
    assert "of the window gain_fall the runs have different parts (11.6" in notes
    assert len(comparison.notes) == 4
    status = {row.key: row for row in comparison.rows}["status"]
    assert status.values == ("complete", "complete", "interrupted", "interrupted")


def test_different_control_periods_are_said(runs: Path, tmp_path: Path) -> None:
    manifest = json.loads((runs / "slow/run.json").read_text()) | {"period_s": 1.0}
    (tmp_path / "run.json").write_text(json.dumps(manifest))
    for name in ("ticks.csv", "events.jsonl"):
        (tmp_path / name).write_bytes((runs / "slow" / name).read_bytes())
    assert "0.1 s, 1 s" in " ".join(Comparison.of([runs / "first", tmp_path]).notes)


def test_a_folder_stands_for_the_runs_within(runs: Path) -> None:
    assert [path.name for path in run_paths([runs])] == ["bare", "first", "fixed", "killed", "slow"]
    assert [path.name for path in run_paths([runs / "slow", runs / "first", runs / "slow"])] == ["slow", "first"]


def test_one_run_is_no_comparison(runs: Path) -> None:
    with pytest.raises(CompareError, match="two or more"):
        run_paths([runs / "first", runs / "../" / runs.name / "first"])


def test_runs_of_one_name_are_told_apart() -> None:
    assert names_of([Path("/a/x/run"), Path("/a/y/run")]) == ("x/run", "y/run")


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("run.json", "{}"),
        ("run.json", '{"format": 99}'),
        ("ticks.csv", "no table\n1\n"),
        ("ticks.csv", "t_s,mode\n1,2\n"),
        ("events.jsonl", "no event\n"),
    ],
)
def test_a_record_that_can_not_be_read_is_one_line_that_names_it(
    runs: Path, tmp_path: Path, file: str, content: str
) -> None:
    for name in ("run.json", "ticks.csv", "events.jsonl"):
        (tmp_path / name).write_bytes((runs / "first" / name).read_bytes())
    (tmp_path / file).write_text(content)
    with pytest.raises(RunFolderError) as raised:
        compared_runs([runs / "first", tmp_path])
    assert str(tmp_path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_record_of_format_1_is_compared(runs: Path) -> None:
    old = next(Path(__file__).parents[1].glob("review/format1/**/run.json")).parent
    comparison = Comparison.of([runs / "first", old])
    assert comparison.runs[1].kpi.duration_s > 0.0
    json.dumps(comparison.as_dict(), allow_nan=False)
