"""The start phase: when there is one, how long it takes, where it leads, and how it ends."""

import math
from dataclasses import replace

import pytest

from hil.core import start_phase
from hil.core.controller import ControllerConfig
from hil.core.gain_design import choose_rig_design
from hil.core.reconfiguration import Reconfiguration
from hil.core.start_phase import FAR_BELOW, LEVEL_MARGIN_CM, StartConfig, StartPhase, When, plan
from hil.core.tanks import equilibrium, linearise
from hil.core.types import UNRESOLVED, Alarm, Mode, Pair, TickRecord
from tests.core.core_bench import BENCH, LIMITS, Plant, bench_loop, run
from tests.narrowing import not_none, quad

REST = equilibrium(BENCH, (3.0, 3.0))
REST_V = (0.5 * REST[0], 0.5 * REST[1])
EMPTY = (0.0, 0.0, 0.0, 0.0)
START = StartConfig(When.AUTO, settle_s=60.0, level_max_cm=19.0, max_drives=(10.0, 10.0), max_V=10.0)
SHORT = replace(START, rate_cm_s=0.5, settle_s=30.0)
DESIGN = choose_rig_design(linearise(BENCH, REST), (-0.252, -0.184, -0.073, -0.06), 10.0)
STEP = (0.0, REST_V), (5.0, (REST_V[0] + 0.2, REST_V[1]))


def controller(start: StartConfig = START, duration_s: float = math.inf) -> ControllerConfig:
    design = Reconfiguration(BENCH, DESIGN, (10.0, 10.0), (3.0, 3.0))
    return ControllerConfig(bench_loop(references=STEP, rule=design, start=start), LIMITS, duration_s)


def filled(start: StartConfig = START, plant: Plant | None = None, extra_s: float = 10.0) -> list[TickRecord]:
    """The records of a run from empty tanks, until extra_s after time 0."""
    tanks = Plant(start_V=(0.0, 0.0)) if plant is None else plant
    phase = not_none(plan(start, BENCH, quad(tanks.level_cm), REST_V, 0.1))
    return run(controller(start), tanks, 3 + round((phase.length_s + extra_s) / 0.1))[1]


def lower(record: TickRecord) -> Pair:
    return record.measured_V[0], record.measured_V[1]


@pytest.mark.parametrize(
    ("when", "share", "expected"),
    [
        (When.AUTO, 1.0, False),
        (When.AUTO, FAR_BELOW + 0.01, False),
        (When.AUTO, FAR_BELOW - 0.01, True),
        (When.AUTO, 0.0, True),
        (When.ALWAYS, 1.0, True),
        (When.NEVER, 0.0, False),
    ],
)
def test_it_begins_where_a_lower_level_is_far_below(when: When, share: float, expected: bool) -> None:
    for tank in (0, 1):
        found = quad(share * h if i == tank else h for i, h in enumerate(REST))
        assert (plan(replace(START, when=when), BENCH, found, REST_V, 0.1) is not None) == expected


def test_its_length_is_that_of_the_ramp_and_the_settling_in_whole_periods() -> None:
    phase = not_none(plan(START, BENCH, EMPTY, REST_V, 0.07))
    assert phase.ramp_s == pytest.approx(max(REST[:2]) / 0.1)
    assert 0.0 <= phase.length_s - phase.ramp_s - 60.0 < 0.07
    assert phase.length_s / 0.07 == pytest.approx(round(phase.length_s / 0.07))


def test_outputs_to_aim_at_move_together_and_then_stay() -> None:
    phase = not_none(plan(START, BENCH, EMPTY, REST_V, 0.1))
    assert phase.toward(-phase.length_s, REST_V) == (0.0, 0.0)
    halfway = phase.toward(-phase.length_s + 0.5 * phase.ramp_s, REST_V)
    assert halfway == pytest.approx((0.5 * REST_V[0], 0.5 * REST_V[1]))
    assert phase.toward(-60.0, REST_V) == REST_V == phase.toward(0.0, REST_V)


def test_the_first_step_may_be_early_by_rounding() -> None:
    """From empty tanks the first target lay below 0 cm by 1e-12, and the run ended with a math domain error."""
    phase = StartPhase((0.0, 0.0), 100.0, 160.0, 0.1)
    assert phase.toward(-160.0 - 1e-9, REST_V) == (0.0, 0.0)


def test_a_ramp_that_would_fill_the_upper_tanks_is_slower() -> None:
    """At 0.5 cm/s pump 2 would need 9.95 V and hold 17.9 cm in tank 3, of the 17 cm that the margin leaves."""
    fast = replace(START, rate_cm_s=2.0, max_drives=(math.inf, math.inf))
    ramp_s = start_phase.ramp_time_s(fast, BENCH, (0.0, 0.0), REST[:2])
    assert ramp_s == pytest.approx(8.0 * max(REST[:2]) / 2.0)
    at_limit = replace(START, rate_cm_s=2.0, level_max_cm=math.inf)
    assert start_phase.ramp_time_s(at_limit, BENCH, (0.0, 0.0), REST[:2]) > max(REST[:2]) / 2.0
    low = replace(START, level_max_cm=LEVEL_MARGIN_CM)  # no rate helps: what holds the reference is above it already
    assert start_phase.ramp_time_s(low, BENCH, (0.0, 0.0), REST[:2]) < math.inf


def test_it_leads_from_empty_tanks_to_the_first_reference_without_a_bump() -> None:
    """A run from empty tanks began with both pumps at 10 V."""
    records = filled()
    before = [record for record in records if record.t_s < 0.0]
    after = [record for record in records if record.t_s >= 0.0]
    assert after[0].t_s == 0.0
    assert before[0].t_s == pytest.approx(-not_none(plan(START, BENCH, EMPTY, REST_V, 0.1)).length_s)
    assert max(max(record.command_V) for record in records) < 6.0
    assert max(max(record.measured_V) for record in before) < max(REST_V) + 0.15
    assert lower(after[0]) == pytest.approx(REST_V, abs=0.02)
    for old, new in ((before[-1], after[0]), (after[0], after[1])):
        assert new.command_V == pytest.approx(old.command_V, abs=0.02)
        assert new.integral_Vs == pytest.approx(old.integral_Vs, abs=0.02)
    assert after[0].reference_V == after[0].target_V == REST_V
    assert [record.mode for record in records] == [Mode.RUNNING] * len(records)


def test_the_scenario_and_the_error_integral_begin_at_time_zero() -> None:
    records = filled(SHORT)
    codes = [(record.t_s, event.code, event.data.get("phase")) for record in records for event in record.events]
    begun = records[0].t_s
    assert [entry for entry in codes if entry[1] in ("start_phase", "reference")] == [
        (begun, "start_phase", "begin"),
        (0.0, "start_phase", "end"),
        (pytest.approx(5.0), "reference", None),
    ]
    assert {record.iae_Vs for record in records if record.t_s <= 0.0} == {(0.0, 0.0)}
    assert records[-1].iae_Vs[0] > 0.5


@pytest.mark.parametrize("left", [0.85, 1.15, 0.7, 1.3])
def test_pumps_that_differ_from_the_file_lead_there_too(left: float) -> None:
    plant = Plant(start_V=(0.0, 0.0))
    plant.effectiveness = (left, left)
    records = filled(plant=plant, extra_s=1.0)
    at_zero = next(record for record in records if record.t_s >= 0.0)
    assert lower(at_zero) == pytest.approx(REST_V, abs=0.05)
    assert records[-1].mode is Mode.RUNNING


def test_pumps_that_are_too_weak_end_in_an_orderly_stop_that_says_so() -> None:
    plant = Plant(start_V=(0.0, 0.0))
    plant.effectiveness = (0.2, 0.2)
    records = filled(SHORT, plant, extra_s=2.0)
    (stop,) = [event for record in records for event in record.events if event.code == "stop"]
    assert stop.data["cause"] == "start_failed"
    for part in ("level 1 is", "level 2 is", "pump 1 and 2 at 10 V", "too weak"):
        assert part in stop.text
    assert records[-1].command_V == (0.0, 0.0)
    assert {record.mode for record in records if record.t_s < 0.0} == {Mode.RUNNING}


def test_levels_that_still_move_ask_for_more_time() -> None:
    phase = not_none(plan(START, BENCH, EMPTY, REST_V, 0.1))
    text = start_phase.problem(phase, START, quad((REST[0] + 0.51, *REST[1:])), REST[:2], (3.0, 3.0))
    assert "level 1 is" in text
    assert "start.settle_s" in text
    assert start_phase.problem(phase, START, quad((REST[0] + 0.49, *REST[1:])), REST[:2], (10.0, 10.0)) == ""
    assert start_phase.problem(phase, START, (math.nan, *REST[1:]), REST[:2], (3.0, 3.0)) != ""


def test_the_step_nearest_to_time_zero_ends_the_phase() -> None:
    """In real time a step may come 2 ms early; the emulator then started its scenario a control period late."""
    config, tanks = controller(SHORT), Plant(start_V=(0.0, 0.0))
    steps = 3 + round(not_none(plan(SHORT, BENCH, EMPTY, REST_V, 0.1)).length_s / 0.1)
    late = {1: 2_000_000}  # the first step in control comes late, so that all others are early
    _, records = run(config, tanks, steps, late_ns=late)
    ended = [record.t_s for record in records for event in record.events if event.data.get("phase") == "end"]
    assert ended == [pytest.approx(-0.002, abs=1e-6)]


def test_an_open_question_about_a_lower_level_ends_the_phase_with_a_stop() -> None:
    """A drift while the tanks filled looked like a valve or a leak, and the run began with 18 cm in tank 1."""

    def alarm(number: int, kind: str, *candidates: str, is_recovery: bool = False) -> Alarm:
        return Alarm(1.0, kind, 0, math.nan, candidates=candidates, number=number, is_recovery=is_recovery)

    drift = alarm(1, UNRESOLVED, "valve_split 1", "leak 1", "sensor_drift 1")
    doubts = start_phase.open_doubts((), [drift, alarm(2, UNRESOLVED, "pump_effectiveness 1")], -50.0)
    assert "valve_split 1 or leak 1 or sensor_drift 1" in start_phase.hidden_level(doubts, -49.0, is_over=True)
    assert start_phase.hidden_level(doubts, -36.0, is_over=False) == ""
    assert start_phase.hidden_level(doubts, -35.0, is_over=False) != "", "a tank fills on in the meantime"
    assert start_phase.open_doubts(doubts, [], -40.0) is doubts
    again = start_phase.open_doubts(doubts, [drift], -36.0)
    assert start_phase.hidden_level(again, -35.0, is_over=False) != "", "a report on an open alarm is not a new doubt"
    for end in (alarm(1, "valve_split", "valve_split 1"), alarm(1, UNRESOLVED, "leak 1", is_recovery=True)):
        later = start_phase.open_doubts(doubts, [end], -40.0)
        assert later == ((2, ("pump_effectiveness 1",), -50.0),)
        assert start_phase.hidden_level(later, 0.0, is_over=True) == ""


@pytest.mark.parametrize(
    ("kind", "target", "is_doubt"), [("leak", 2, True), ("leak", 3, False), ("sensor_drift", 2, False)]
)
def test_a_leak_of_a_lower_tank_ends_the_phase_at_once(kind: str, target: int, is_doubt: bool) -> None:
    """Sensor 1 drifted downwards while the tanks filled, and was called a leak: 59 cm3 went over the rim."""
    named = Alarm(1.0, kind, target, 0.2, candidates=(f"{kind} {target}",), number=1)
    doubts = start_phase.open_doubts((), [named], -60.0)
    assert bool(start_phase.hidden_level(doubts, -60.0, is_over=False)) is is_doubt
    assert start_phase.open_doubts(doubts, [replace(named, is_recovery=True)], -50.0) == ()


def test_an_open_question_about_a_tank_whose_water_is_balanced_does_not_end_the_phase() -> None:
    """On rigs whose pumps were not as the file says, 1 of 16 starts was stopped by such a question."""
    question = Alarm(1.0, UNRESOLVED, 0, math.nan, candidates=("pump_lag 1", "leak 1", "sensor_drift 1"), number=1)
    doubts = start_phase.open_doubts((), [question], -60.0)
    for balanced, is_doubt in (((True, False), False), ((False, True), True), ((False, False), True)):
        for t_s, is_over in ((-40.0, False), (0.0, True)):
            assert bool(start_phase.hidden_level(doubts, t_s, balanced, is_over=is_over)) is is_doubt
    named = start_phase.open_doubts((), [Alarm(1.0, "leak", 1, 0.2, candidates=("leak 1",), number=1)], -60.0)
    assert start_phase.hidden_level(named, -60.0, (True, True), is_over=False) != ""
