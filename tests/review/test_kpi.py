from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.core.types import Alarm, Event, Severity
from hil.edge.record.manifest import Window
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.recorder import Recorder
from hil.edge.record.run_folder import RunFolder
from hil.review.alarms import Injected
from hil.review.kpi import Kpi, compute
from hil.review.run_measures import absolute_error_integral, dry_run
from hil.review.run_report import write_report
from tests.review import toy

KEYS = {"false_alarms", "spurious_alarms", "overflow", "dry_run", "applied_out_of_range", "iae_after_fault_Vs"} | {
    "iae_Vs",
    "iae_source",
    "applied_max_V",
    "level_max_cm",
    "alarms",
    "trips",
    "ticks",
    "skipped",
    "speed_x",
}


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
    expected = {"detected_s": 201.0, "kind": "pump_effectiveness", "size": 0.4, "size_std": 0.02, "onset_s": 200.1}
    expected |= {"isolated_s": 201.0, "recovered_s": None, "flips": 0}
    for pump, alarm in zip((1, 2), raw["alarms"], strict=True):
        assert alarm.items() >= {**expected, "target": pump}.items()
        assert alarm["candidates"] == [f"pump_effectiveness {pump}"]
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
    assert (kpi.ticks, kpi.duration_s, kpi.applied_max_V, kpi.lateness_s["p99"]) == (0, 0.0, (None, None), None)
    assert kpi.iae_Vs["gain_fall"] == (0.0, 0.0)


def test_trips_come_with_cause_and_text(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    recorder = Recorder.open(folder)
    trip = Event(Severity.ERROR, "trip", "tank 1 above 19 cm", {"cause": "high_level"})
    recorder.tick(next(toy.steps())[0]._replace(t_s=12.3, events=(trip,)))
    recorder.close("tripped", "high_level")
    assert compute(folder).trips == ({"t_s": 12.3, "cause": "high_level", "text": "tank 1 above 19 cm"},)


def test_settings_without_the_level_gain_are_a_clear_error(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", replace(toy.plan(), settings={}, windows=(Window("all", 0, 1),)))
    Recorder.open(folder).close("complete", "")
    with pytest.raises(RunFolderError, match="gain_V_cm"):
        compute(folder)


def shortened(path: Path, *alarms: Alarm, settings: dict[str, Any] | None = None, **changes: Any) -> Kpi:
    """Key figures of the toy's steps from 195 to 215 s with other alarms, each at the step of its time."""
    folder = RunFolder.create(path, replace(toy.plan(), settings=settings or toy.SETTINGS))
    recorder = Recorder.open(folder)
    truth_cm = changes.pop("truth_cm", None)
    for record, truth in toy.steps(until_s=215.0):
        if record.t_s >= 195.0:
            due = [alarm for alarm in alarms if abs(alarm.detected_s - record.t_s) < 0.01]
            events = tuple(Event(Severity.WARNING, "alarm", "", asdict(alarm)) for alarm in due)
            recorder.tick(record._replace(events=events, **changes), truth_cm or truth)
    recorder.close("complete", "")
    return compute(folder)


def with_faults(*faults: dict[str, object]) -> dict[str, Any]:
    return {**toy.SETTINGS, "scenario": {"fault": list(faults)}}


def test_a_fault_told_twice_is_one_alarm_with_the_first_time_and_the_last_word(tmp_path: Path) -> None:
    vague = Alarm(200.3, "unresolved", 0, math.nan, candidates=("leak 1", "pump_effectiveness 1"), number=5)
    settled = Alarm(201.0, "pump_effectiveness", 1, 0.42, 0.03, 200.05, 201.0, ("pump_effectiveness 1",), number=5)
    better = replace(settled, detected_s=203.0, size=0.401, size_std=0.004)
    kpi = shortened(tmp_path / "run", vague, settled, better)
    (alarm,) = kpi.alarms
    assert (alarm["detected_s"], alarm["isolated_s"], alarm["size"]) == (200.3, 201.0, 0.401)
    assert alarm["first_candidates"] == ("leak 1", "pump_effectiveness 1")
    assert (kpi.false_alarms, kpi.spurious_alarms) == (0, 0)


def test_alarms_before_the_fault_are_false_and_those_of_no_fault_spurious(tmp_path: Path) -> None:
    early = Alarm(197.0, "sensor_bias", 3, 0.02, number=1)
    right = [Alarm(200.5, "pump_effectiveness", pump, 0.4, number=1 + pump) for pump in (1, 2)]
    extra = Alarm(210.0, "leak", 4, 0.1, number=4)
    kpi = shortened(tmp_path / "run", early, *right, extra)
    assert (len(kpi.alarms), kpi.false_alarms, kpi.spurious_alarms) == (4, 1, 1)
    healthy = shortened(tmp_path / "healthy", early, *right, settings=with_faults())
    assert (healthy.false_alarms, healthy.spurious_alarms) == (3, 0)


def test_iae_after_the_fault_ends_with_its_window(tmp_path: Path, whole_run: RunFolder) -> None:
    whole = compute(whole_run)
    assert whole.iae_after_fault_Vs == whole.iae_Vs["gain_fall"], "the fault comes with the window's start"
    late = shortened(
        tmp_path / "late", settings=with_faults({"kind": "leak", "target": 1, "value": 0.2, "at_s": 205.0})
    )
    assert late.iae_after_fault_Vs is not None
    assert 0.0 < late.iae_after_fault_Vs[0] < late.iae_Vs["gain_fall"][0]
    assert shortened(tmp_path / "none", settings=with_faults()).iae_after_fault_Vs is None


def test_broken_invariants_are_named(tmp_path: Path) -> None:
    healthy = shortened(tmp_path / "healthy")
    assert (healthy.overflow, healthy.dry_run, healthy.applied_out_of_range) == (False, False, False)
    assert shortened(tmp_path / "brim", truth_cm=(12.0, 20.0, 1.0, 1.0)).overflow
    assert shortened(tmp_path / "high", applied_V=(10.01, 3.0)).applied_out_of_range
    assert shortened(tmp_path / "low", applied_V=(3.0, -0.01)).applied_out_of_range
    assert not shortened(tmp_path / "edge", applied_V=(10.0, 0.0)).applied_out_of_range
    dry = with_faults({"kind": "reservoir_low", "target": 0, "value": 1.0, "at_s": 205.0})
    assert shortened(tmp_path / "dry", settings=dry).dry_run
    assert not shortened(tmp_path / "off", settings=dry, applied_V=(0.0, 0.0)).dry_run


@pytest.mark.parametrize(("driven_s", "is_dry"), [(1.9, False), (2.0, False), (2.1, True)])
def test_a_pump_may_run_two_seconds_after_the_reservoir_is_low(driven_s: float, is_dry: bool) -> None:
    """Nothing tried the limit: 4 s passed as well as 2 s."""
    times_s = np.linspace(0.0, 20.0, 201)
    applied_V = np.where(times_s[:, None] <= 5.0 + driven_s + 1e-9, [[3.0, 0.0]], [[0.0, 0.0]])
    assert dry_run(times_s, applied_V, (Injected("reservoir_low", 0, 1.0, 5.0),)) == is_dry


@pytest.mark.parametrize(("present_s", "is_dry"), [(1.9, False), (2.5, True)])
def test_a_reservoir_that_is_low_now_and_then_counts_from_each_time(present_s: float, is_dry: bool) -> None:
    times_s = np.arange(0.0, 60.0, 0.1)
    low = Injected("reservoir_low", 0, 1.0, 5.0, period_s=10.0, duty=present_s / 10.0)
    assert dry_run(times_s, np.ones((len(times_s), 2)), (low,)) == is_dry


def test_what_only_the_emulator_knows_is_not_made_up_for_a_live_run(tmp_path: Path) -> None:
    kpi = compute(toy.record_run(tmp_path / "run", live=True, until_s=30.0))
    assert (kpi.false_alarms, kpi.spurious_alarms, kpi.dry_run, kpi.iae_after_fault_Vs) == (None, None, None, None)
    assert (kpi.overflow, kpi.applied_out_of_range) == (False, False)


def test_how_a_live_loop_kept_time_is_in_the_figures(tmp_path: Path) -> None:
    """Lateness rises from 0 to 10 ms over a thousand and one steps, so that each quantile is its share of 10 ms.

    The command follows the newest frame by 1 ms, by 9 ms in the last ten steps.
    """
    folder = RunFolder.create(tmp_path / "run", toy.plan(mode="live"))
    recorder = Recorder.open(folder)
    for index, (record, _) in enumerate(toy.steps(until_s=100.1)):
        t_s = 50.0 + record.t_s
        recorder.frame(t_s - 0.02, 0x182, b"")
        recorder.frame(t_s, 0x282, b"")
        recorder.frame(t_s + (0.009 if index > 990 else 0.001), 0x201, b"", False)
        recorder.tick(record._replace(lateness_s=1e-5 * index), queue=index % 7)
    recorder.close("complete", "")
    kpi = compute(folder)
    assert kpi.lateness_s == pytest.approx({"p50": 0.005, "p99": 0.0099, "p99_9": 0.00999, "max": 0.01})
    assert kpi.latency_s["p50"] == pytest.approx(0.001)
    assert kpi.latency_s["p99"] == pytest.approx(0.001, rel=0.1)
    assert kpi.latency_s["max"] == pytest.approx(0.009)
    assert kpi.recorder_queue_max == 6.0


def test_a_record_older_than_a_column_has_figures_without_it(tmp_path: Path) -> None:
    folder = toy.record_run(tmp_path / "run", live=True, until_s=210.0)
    lines = folder.ticks_path.read_text().splitlines()
    folder.ticks_path.write_text("".join(line.rsplit(",", 3)[0] + "\n" for line in lines))
    assert "latency_s" not in folder.ticks_path.read_text()
    kpi = compute(folder)
    assert kpi.latency_s == {"p50": None, "p99": None, "max": None}
    assert kpi.recorder_queue_max is None
    lateness_s = kpi.lateness_s["p99_9"]
    assert lateness_s is not None
    assert lateness_s > 0.0
    assert kpi.ticks == 2100
    write_report(folder)
