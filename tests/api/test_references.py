"""References of a scenario: steps, ramps and trajectories, and what is wrong with a trajectory's file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.bench.reference_plan import reference_plan
from hil.bench.run_plan import run_plan
from hil.core.reference_path import RunReferences

HEAD = '[scenario]\nname = "moves"\nduration_s = 12.0\n[diagnosis]\nmethod = "none"\n'


def references(folder: Path, text: str) -> RunReferences:
    """Those of a scenario with these [[reference]] tables."""
    path = folder / "scenario.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    bench = hil.load(path)
    schedule, moves = reference_plan(bench.scenario, bench.rig, str(path))
    return RunReferences(schedule, None, moves)


def test_a_ramp_is_linear_from_the_reference_before(tmp_path: Path) -> None:
    given = references(
        tmp_path,
        "[[reference]]\nat_s = 2.0\nlevels_V = [5.0, 6.0]\n[[reference]]\nat_s = 4.0\n"
        "change_V = [0.4, -0.2]\nramp_s = 2.0\n",
    )
    assert given.at(3.9) == (5.0, 6.0)
    assert given.at(5.0) == pytest.approx((5.2, 5.9))
    assert given.rate(5.0) == pytest.approx((0.2, -0.1))
    assert given.at(6.0) == given.at(100.0) == pytest.approx((5.4, 5.8))
    assert given.rate(6.0) == given.rate(3.0) == (0.0, 0.0)


def test_a_ramp_that_is_interrupted_goes_on_from_where_it_is(tmp_path: Path) -> None:
    given = references(
        tmp_path,
        "[[reference]]\nat_s = 0.0\nlevels_V = [5.0, 5.0]\n[[reference]]\nat_s = 2.0\n"
        "levels_V = [7.0, 5.0]\nramp_s = 4.0\n[[reference]]\nat_s = 4.0\nlevels_V = [5.0, 5.0]\nramp_s = 1.0\n",
    )
    assert given.at(4.0) == pytest.approx((6.0, 5.0))
    assert given.at(4.5) == pytest.approx((5.5, 5.0))


def test_a_reference_at_time_0_replaces_the_operating_point(tmp_path: Path) -> None:
    """A run from empty tanks used to end with `start_failed`: its start phase led to the operating point."""
    given = references(tmp_path, "[[reference]]\nat_s = 0.0\nlevels_cm = [10.0, 11.0]\n")
    assert given.schedule == ((0.0, (5.0, 5.5)),)


def test_a_trajectory_is_linear_between_its_lines(tmp_path: Path) -> None:
    (tmp_path / "course.csv").write_text("t_s,y1_cm,y2_cm\n1,10,12\n3,11,12\n", encoding="utf-8")
    given = references(tmp_path, '[[reference]]\nat_s = 2.0\nfile = "course.csv"\n')
    first = given.at(0.0)
    assert given.at(2.5) == pytest.approx((0.5 * (first[0] + 5.0), 0.5 * (first[1] + 6.0)))
    assert given.at(4.0) == pytest.approx((5.25, 6.0))
    assert given.at(50.0) == (5.5, 6.0)


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ("t_s,y1_V,y2_V\n0,6,6\n1,nan,6\n", "line 3: y1_V = nan: must be finite"),
        ("t_s,y1_V,y2_V\n0,6,6\n0,6,6\n", "line 3: t_s = 0: not after 0 of the line before"),
        ("t_s,y1_V,y2_V\n0,6,x\n", "line 2: y2_V = 'x': is not a number"),
        ("t_s,y1_cm,y2_cm\n0,6,19.5\n", "line 2: y2_cm = 19.5: outside 0..19 (safety.level_max_cm)"),
        ("t_s,y1_V,y2_V\n-1,6,6\n", "line 2: t_s = -1: outside 0.."),
        ("t_s,y1_V\n0,6\n", "line 1: want t_s,y1_V,y2_V or t_s,y1_cm,y2_cm, not 't_s,y1_V'"),
        ("t_s,y1_V,y2_V\n0,6\n", "line 2: has 2 values, want 3"),
        ("t_s,y1_V,y2_V\n", "has 0 points"),
    ],
)
def test_what_is_wrong_with_a_trajectory_is_said_with_file_line_column_and_value(
    tmp_path: Path, lines: str, complaint: str
) -> None:
    (tmp_path / "course.csv").write_text(lines, encoding="utf-8")
    with pytest.raises(hil.SettingsError) as raised:
        references(tmp_path, '[[reference]]\nat_s = 2.0\nfile = "course.csv"\n')
    assert f"{tmp_path / 'course.csv'}: {complaint}" in str(raised.value)


def test_a_missing_trajectory_and_one_with_a_ramp_are_refused(tmp_path: Path) -> None:
    with pytest.raises(hil.SettingsError, match=r"course\.csv: can't be read"):
        references(tmp_path, '[[reference]]\nat_s = 2.0\nfile = "course.csv"\n')
    with pytest.raises(hil.SettingsError, match="has file and ramp_s"):
        references(tmp_path, '[[reference]]\nat_s = 2.0\nfile = "course.csv"\nramp_s = 3.0\n')


def test_a_ramp_is_followed_without_lag_and_announced_once(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(HEAD + "[[reference]]\nat_s = 2.0\nchange_V = [0.5, 0.5]\nramp_s = 5.0\n", encoding="utf-8")
    result = hil.simulate(path)
    series = {name: np.array(values) for name, values in result.series.items()}
    later = series["t_s"] > 4.0
    for output in (1, 2):
        error_V = series[f"r{output}_V"] - 0.5 * series[f"true_h{output}_cm"]
        assert np.abs(error_V[later]).max() < 0.02
    assert [event.data.get("move_s") for event in result.events if event.code == "reference"] == [5.0]


def test_the_copies_of_a_run_have_its_trajectory(tmp_path: Path) -> None:
    """They used to have the scenario alone, so that its run could not be repeated from its folder."""
    lines = "t_s,y1_V,y2_V\n1,5.2,6.1\n"
    (tmp_path / "paths").mkdir()
    (tmp_path / "paths/course.csv").write_text(lines, encoding="utf-8")
    given = references(tmp_path, '[[reference]]\nat_s = 2.0\nfile = "paths/course.csv"\n')
    copies = run_plan(hil.load(tmp_path / "scenario.toml"), is_live=False, seed=1).copies
    assert copies["scenarios/paths/course.csv"] == lines
    again = tmp_path / "again"
    for name, text in copies.items():
        (again / name).parent.mkdir(parents=True, exist_ok=True)
        (again / name).write_text(text, encoding="utf-8")
    bench = hil.load(again / "scenarios/scenario.toml")
    assert reference_plan(bench.scenario, bench.rig, str(bench.scenario_path)) == (given.schedule, given.moves)
