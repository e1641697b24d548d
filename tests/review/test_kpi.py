from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import toy

from hil.core.types import Event, Severity
from hil.edge.recorder import Recorder
from hil.edge.run_folder import RunFolder, RunFolderError, Window
from hil.review.kpi import absolute_error_integral, compute

KEYS = {"iae_Vs", "iae_source", "applied_max_V", "level_max_cm", "alarms", "trips", "ticks", "skipped", "speed_x"}


@pytest.mark.parametrize(("from_s", "to_s"), [(0.0, 50.0), (1.234, 33.3333), (0.05, 0.07), (10.0, 10.0)])
def test_integral_of_an_exponential_error(from_s: float, to_s: float) -> None:
    """e = a exp(-t/T): its integral is a T (exp(-from/T) - exp(-to/T)), windows off the ticks too."""
    times_s = np.arange(0.0, 60.0, 0.1)
    a, T = 0.8, 12.0
    level = 6.0 - a * np.exp(-times_s / T)
    got, covered_s = absolute_error_integral(times_s, np.full_like(times_s, 6.0), level, from_s, to_s, 0.1)
    assert got == pytest.approx(a * T * (math.exp(-from_s / T) - math.exp(-to_s / T)), rel=1e-4, abs=1e-12)
    assert covered_s == pytest.approx(to_s - from_s)


def test_a_window_is_the_sum_of_its_parts() -> None:
    rng = np.random.default_rng(7)
    times_s = np.cumsum(rng.uniform(0.01, 0.3, 400))
    reference, level = np.where(times_s > 20.0, 6.5, 6.0), 6.2 + 0.5 * rng.standard_normal(400)

    def iae(from_s: float, to_s: float) -> float:
        return absolute_error_integral(times_s, reference, level, from_s, to_s, 0.1)[0]

    cuts = [1.0, 7.77, 20.0, 31.4, 50.0]
    assert sum(iae(a, b) for a, b in pairwise(cuts)) == pytest.approx(iae(1.0, 50.0))


def test_an_error_that_changes_sign_is_two_triangles() -> None:
    got, _ = absolute_error_integral(np.array([0.0, 1.0]), np.zeros(2), np.array([-1.0, 3.0]), 0.0, 1.0, 0.0)
    assert got == pytest.approx(0.5 * 0.25 * 1.0 + 0.5 * 0.75 * 3.0)


def test_a_step_of_the_reference_on_the_border_belongs_to_the_window_it_opens() -> None:
    times_s = np.arange(0.0, 20.0, 0.1)
    reference = np.where(times_s >= 10.0 - 1e-9, 7.0, 6.0)
    level = np.full_like(times_s, 6.0)
    before, _ = absolute_error_integral(times_s, reference, level, 0.0, 10.0, 0.1)
    after, covered_s = absolute_error_integral(times_s, reference, level, 10.0, 20.0, 0.1)
    assert before == pytest.approx(0.0, abs=1e-9)
    assert after == pytest.approx(10.0)
    assert covered_s == pytest.approx(10.0), "the last step holds for its period"


def test_a_window_outside_of_the_record_covers_nothing() -> None:
    times_s = np.arange(0.0, 5.0, 0.1)
    assert absolute_error_integral(times_s, times_s, 0 * times_s, 10.0, 20.0, 0.1) == (0.0, 0.0)
    assert absolute_error_integral(times_s[:0], times_s[:0], times_s[:0], 0.0, 1.0, 0.1) == (0.0, 0.0)


def test_kpi_file_has_the_agreed_keys(whole_run: RunFolder) -> None:
    kpi = compute(whole_run, speed_x=500.0)
    raw = json.loads(whole_run.kpi_path.read_text())
    assert set(raw) >= KEYS
    assert set(raw["iae_Vs"]) == {"gain_fall", "reference_step"}
    assert [len(pair) for pair in raw["iae_Vs"].values()] == [2, 2]
    assert raw["iae_source"] == "truth"
    assert raw["alarms"] == [
        {"detected_s": 201.0, "kind": "pump_effectiveness", "target": pump, "size": 0.4} for pump in (1, 2)
    ]
    assert (raw["ticks"], raw["skipped"], raw["speed_x"], raw["trips"]) == (5000, 0, 500.0, [])
    assert len(raw["level_max_cm"]) == 4
    assert kpi.status == "complete"
    assert compute(whole_run).speed_x == 412.0, "from run.json when not handed in"


def test_truth_is_taken_from_the_true_levels(whole_run: RunFolder) -> None:
    """Against a plain left-hand sum over the steps themselves."""
    kpi = compute(whole_run)
    steps = [(record, truth) for record, truth in toy.steps() if record.t_s >= 350.0 - 1e-6]
    crude = sum(abs(record.reference_V[0] - truth[0] * 0.5) * 0.1 for record, truth in steps)
    assert kpi.iae_Vs["reference_step"][0] == pytest.approx(crude, rel=0.01)
    highest = max(truth[1] for _, truth in toy.steps())
    assert kpi.level_max_cm[1] == pytest.approx(highest)


def test_without_true_levels_the_estimate_counts(tmp_path: Path) -> None:
    kpi = compute(toy.record_run(tmp_path / "run", live=True, until_s=360.0))
    assert kpi.iae_source == "estimate"
    assert kpi.iae_covered_s == {"gain_fall": 150.0, "reference_step": pytest.approx(10.0)}
    assert kpi.level_max_cm[0] == pytest.approx(13.0, abs=0.5)


def test_a_killed_run_is_reported_as_interrupted(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    recorder = Recorder.open(folder)
    for record, truth in toy.steps(until_s=210.0):
        recorder.tick(record, truth)
    recorder.flush()
    kpi = compute(folder)
    assert kpi.status == "interrupted"
    assert kpi.iae_covered_s["gain_fall"] == pytest.approx(10.0)
    recorder.close("stopped", "")


def test_a_run_that_never_got_going_has_figures_all_the_same(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    Recorder.open(folder).close("failed", "the rig did not become ready within 10 s")
    kpi = compute(folder)
    assert (kpi.ticks, kpi.applied_max_V, kpi.lateness_s["p99"]) == (0, (None, None), None)
    assert kpi.iae_Vs["gain_fall"] == (0.0, 0.0)


def test_trips_come_with_cause_and_text(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    recorder = Recorder.open(folder)
    trip = Event(Severity.ERROR, "trip", "tank 1 above 19 cm", {"cause": "high_level"})
    recorder.tick(replace(next(toy.steps())[0], t_s=12.3, events=(trip,)))
    recorder.close("tripped", "high_level")
    assert compute(folder).trips == ({"t_s": 12.3, "cause": "high_level", "text": "tank 1 above 19 cm"},)


def test_settings_without_the_level_gain_are_a_clear_error(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", replace(toy.plan(), settings={}, windows=(Window("all", 0, 1),)))
    Recorder.open(folder).close("complete", "")
    with pytest.raises(RunFolderError, match="gain_V_cm"):
        compute(folder)
