"""`hil tune`: candidates, their margins, the rule of the choice, and the rig file."""

from __future__ import annotations

import math
import shutil
from datetime import datetime
from itertools import combinations
from pathlib import Path

import control
import numpy as np
import pytest
from matplotlib.figure import Figure

from hil.bench import tuning_run
from hil.bench.design_figures import process_figures
from hil.bench.designs import DESIGNS
from hil.bench.law_choices import LAWS, STATE_FEEDBACK
from hil.bench.loop_margins import is_stable, loop_margins, sampled
from hil.bench.tuning_candidates import candidates
from hil.bench.tuning_run import NotWrittenError, TuneOptions
from hil.campaigns.tuning_choice import Candidate, Robustness, Trial, judged
from hil.campaigns.tuning_report import LETTER_PT, PLOT_PT, _overlap, _spots, render
from hil.core.gain_design import gain_matrix
from hil.core.tanks import Array, LinearModel
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.settings_file import SettingsError
from tests.campaign.campaign_bench import CONFIG, SHORT

SCENARIO = (
    SHORT
    + """
[[reference]]
at_s = 2.0
change_V = [0.1, 0.1]

[[window]]
name = "rest"
from_s = 0.0
to_s = 2.0

[[window]]
name = "step"
from_s = 2.0
to_s = 4.0
"""
)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(CONFIG / "rig.toml")


@pytest.fixture(scope="module")
def loop(rig: Rig) -> tuple[LinearModel, Array]:
    linear = process_figures(rig).linear
    return linear, gain_matrix(DESIGNS.find("rig", "").make(rig).gains(linear))


def test_the_present_options_are_a_candidate_and_faster_poles_need_more_noise(rig: Rig) -> None:
    found = candidates(rig, STATE_FEEDBACK, {}, 4, "rig.toml")
    assert [one.is_present for one in found] == [True, False, False, False, False]
    needed = [one.values["control.noise_gain_max"] for one in found[1:]]
    assert needed == sorted(needed)


def test_each_law_has_candidates_within_its_options_or_says_that_it_has_none(rig: Rig) -> None:
    for name in LAWS.names:
        try:
            found = candidates(rig, name, {}, 3, "rig.toml")
        except SettingsError as error:
            assert "could be tuned" in str(error)  # noqa: PT017 - some laws have no numbers
            continue
        assert len({str(one.values) for one in found}) == 4, name


def test_a_plant_held_from_step_to_step_is_that_of_the_control_library(loop: tuple[LinearModel, Array]) -> None:
    linear, _ = loop
    A, B = sampled(linear.A, linear.B, linear.C, (0.0, 0.0), (0.0, 0.0), 0.1)
    held = control.c2d(control.ss(linear.A, linear.B, linear.C, np.zeros((2, 2))), 0.1)
    assert A[:4, :4] == pytest.approx(held.A, abs=1e-12)
    assert B[:4] == pytest.approx(held.B, abs=1e-12)


def test_a_gain_margin_is_where_the_loop_becomes_unstable(rig: Rig, loop: tuple[LinearModel, Array]) -> None:
    linear, K = loop
    found = loop_margins(linear, K, rig.lags_s, (0.0, 0.0), 0.1)
    A, B = sampled(linear.A, linear.B, linear.C, rig.lags_s, (0.0, 0.0), 0.1)
    F = np.hstack([K, np.zeros((2, len(A) - 6))])

    def with_gains(first: float, second: float) -> bool:
        return is_stable(A - B @ np.diag([first, second]) @ F)

    up = 0.99 * found.gain_up
    assert with_gains(up, 1.0)
    assert with_gains(1.0, up)
    over = 1.01 * found.gain_up
    assert not (with_gains(over, 1.0) and with_gains(1.0, over))
    assert all(found.losses.values()), "a decoupled loop only becomes slower"
    assert found.spread >= 0.1


def test_a_delay_margin_is_where_the_loop_becomes_unstable(rig: Rig, loop: tuple[LinearModel, Array]) -> None:
    """The margin comes from a frequency response; here the delay is put into the loop itself."""
    linear, K = loop
    margin_s = loop_margins(linear, K, rig.lags_s, (0.0, 0.0), 0.1).delay_s

    def with_delay(pump: int, delay_s: float) -> bool:
        delays_s = (delay_s, 0.0) if pump == 0 else (0.0, delay_s)
        A, B = sampled(linear.A, linear.B, linear.C, rig.lags_s, delays_s, 0.1)
        return is_stable(A - B @ np.hstack([K, np.zeros((2, len(A) - 6))]))

    assert all(with_delay(pump, margin_s - 0.2) for pump in (0, 1))
    assert not all(with_delay(pump, margin_s + 0.2) for pump in (0, 1))


ROBUST = Robustness(10.0, 0.0, 3.0, 0.9, (), 0.2)


def trial(label: str, step: float | None, loss: float, noise_V: float = 0.02, **changes: object) -> Trial:
    candidate = Candidate(label, {"control.noise_gain_max": 5.0}, is_present=label == "present")
    robust = changes.get("robustness", ROBUST)
    endings = {"tripped: high_level": 1} if step is None else {}
    assert isinstance(robust, Robustness)
    return Trial(candidate, step, loss, noise_V, 0.0, endings, robust)


@pytest.mark.parametrize(
    ("other", "objection"),
    [
        (trial("loud", 1.0, 0.5, noise_V=0.03), "sigma(v) above 22 mV"),
        (trial("trips", None, 0.5), "tripped: high_level 1"),
        (trial("tight", 1.0, 0.5, robustness=Robustness(1.5, 0.0, 3.0, 0.9, (), 0.2)), "gain margin 1.5"),
        (trial("late", 1.0, 0.5, robustness=Robustness(9.0, 0.0, 0.4, 0.9, (), 0.2)), "delay margin 0.4 s"),
        (trial("frail", 1.0, 0.5, robustness=Robustness(9.0, 0.0, 3.0, 0.9, (), 0.05)), "10 % off"),
        (
            trial("fragile", 1.0, 0.5, robustness=Robustness(9.0, 0.0, 3.0, 0.9, ("both -60 %",), 0.2)),
            "not stable after both -60 % with gains kept",
        ),
    ],
)
def test_a_better_candidate_with_an_objection_is_not_chosen(other: Trial, objection: str) -> None:
    now, found = judged([trial("present", 2.0, 1.0), other], 0.1, None)
    assert objection in found.objection
    assert (now.is_chosen, found.is_chosen) == (True, False)


def test_the_possible_candidate_with_the_smallest_errors_is_chosen() -> None:
    trials = [trial("present", 2.0, 1.0), trial("a", 1.0, 1.0), trial("b", 0.5, 1.0), trial("c", 0.4, 9.0)]
    found = judged(trials, 0.1, None)
    assert [one.candidate.label for one in found if one.is_chosen] == ["b"]
    assert found[2].score == pytest.approx(0.5)
    assert judged([trials[0], trial("hardly", 1.9, 1.0)], 0.1, None)[0].is_chosen, "3 % is no reason to change a rig"
    page = render("rig.toml", STATE_FEEDBACK, found)
    assert page.count("<svg") == 2
    assert "control.noise_gain_max = 5.0" in page


def test_a_tuning_writes_the_rig_file_with_a_dated_copy(tmp_path: Path) -> None:
    folder = tmp_path / "config"
    folder.mkdir()
    for name in ("rig.toml", "emulator.toml", "bench.dbc"):
        shutil.copy(CONFIG / name, folder / name)
    (tmp_path / "short.toml").write_text(SCENARIO)
    options = TuneOptions(
        config_dir=folder, scenario=tmp_path / "short.toml", count=1, seeds=1, processes=1, out=tmp_path / "out"
    )
    prepared = tuning_run.prepare_tuning(options)
    found = tuning_run.tune(prepared, None, 10.0, lambda _: None)
    assert [one.step_iae_Vs is not None and math.isfinite(one.step_iae_Vs) for one in found.trials] == [True, True]
    assert found.present.score == 1.0
    (tmp_path / "out").mkdir()
    files = tuning_run.write_tuning(found, tmp_path / "out")
    assert [file.name for file in files] == ["tuning.json", "tuning.csv", "report.html"]
    old = (folder / "rig.toml").read_text()
    other = found.trials[1]
    taken = tuning_run.TuningResult(prepared, tuple(judged_as(one, one is other) for one in found.trials))
    copy = tuning_run.write_choice(taken, datetime(2026, 11, 26, 12, 0))
    assert copy.name == "rig-2026-11-26T12-00.toml"
    assert copy.read_text() == old
    assert list(load_rig(folder / "rig.toml").control.output_poles) == other.candidate.values["control.output_poles"]
    assert (folder / "rig.toml").read_text().count("#") == old.count("#"), "the comments stay"
    kept = tuning_run.TuningResult(prepared, tuple(judged_as(one, one is not other) for one in found.trials))
    with pytest.raises(NotWrittenError, match="no candidate is better"):
        tuning_run.write_choice(kept, datetime(2026, 11, 26, 12, 0))


def judged_as(one: Trial, is_chosen: bool) -> Trial:
    return Trial(
        one.candidate, one.step_iae_Vs, one.loss_iae_Vs, one.noise_V, one.overshoot_V, one.endings, one.robustness,
        one.score, "", is_chosen,
    )  # fmt: skip


def test_a_scenario_without_the_windows_is_refused(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    with pytest.raises(SettingsError, match="has no window rest, step"):
        tuning_run.prepare_tuning(TuneOptions(scenario=tmp_path / "short.toml", processes=1))


def test_the_names_beside_the_points_of_a_figure_do_not_overlap() -> None:
    """Names of candidates with nearly the same noise were once printed over each other."""
    axes = Figure().subplots()
    axes.set_xlim(0.0, 60.0)
    axes.set_ylim(0.0, 1.2)
    points = [(9.6, 1.16), (12.1, 0.89), (11.6, 0.72), (14.8, 0.71), (15.1, 0.71), (23.9, 0.70), (30.2, 0.70)]
    named = [
        (f"poles x {number}", *point) for number, point in zip(("0.5", "0.63", "0.78", "0.98"), points, strict=False)
    ]
    spots = _spots(axes, named, points)
    width, height = PLOT_PT
    boxes = [
        (left := x / 60.0 * width + dx, low := y / 1.2 * height + dy, left + LETTER_PT * len(name), low + 8.0)
        for (name, x, y), (dx, dy) in zip(named, spots, strict=True)
    ]
    assert not any(_overlap(one, other) for one, other in combinations(boxes, 2))
    assert all(low > 0.0 and right < width for _, low, right, _ in boxes)
