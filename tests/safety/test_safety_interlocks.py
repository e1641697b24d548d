"""Interlocks at their limits, what they look at, and bypasses."""

import math
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core import interlocks, supervisor
from hil.core.interlocks import BYPASSABLE, INTERLOCKS, NO_BELIEF, Belief, Interlock, Limits, Reaction, Situation
from hil.core.live_levels import NONE
from hil.core.pumps import PumpPath
from hil.core.supervisor import OFF, Supervision
from hil.core.types import Action, Diagnosis, Event, Inputs, Mode, NodeState, Pair, Request, Severity, TripCause
from tests.narrowing import quad
from tests.safety.safety_bench import (
    ALL,
    BENCH,
    FAULTS,
    HEALTHY,
    LIMITS,
    READY,
    REST_CM,
    REST_V,
    believing,
    but,
    doubted,
    level,
)

NOW_NS = 7_000_000_000
SECOND = 1_000_000_000
RUNNING = Supervision(Mode.RUNNING, None, (3.0, 3.0))
JUST = 1e-9


def after(
    inputs: Inputs,
    belief: interlocks.Belief = NO_BELIEF,
    *,
    limits: interlocks.Limits = LIMITS,
    state: supervisor.Supervision = RUNNING,
    now_ns: int = NOW_NS,
) -> tuple[supervisor.Supervision, tuple[Event, ...]]:
    return supervisor.next_mode(limits, state, inputs, now_ns, belief)


def cause_of(inputs: Inputs, belief: interlocks.Belief = NO_BELIEF, **more: Any) -> TripCause | None:
    return after(inputs, belief, **more)[0].cause


def text_of(inputs: Inputs, belief: interlocks.Belief = NO_BELIEF, **more: Any) -> str:
    return after(inputs, belief, **more)[1][0].text


def runs(*lengths: int, base: Inputs = HEALTHY) -> Inputs:
    return but(base, "measurement", invalid_run=lengths, valid=tuple(n == 0 for n in lengths))


# the table


def test_every_cause_has_its_interlock() -> None:
    assert {interlock.cause for interlock in INTERLOCKS} == set(TripCause)


def test_only_what_the_diagnosis_or_a_counter_believes_can_be_bypassed() -> None:
    assert {
        TripCause.ECHO_MISMATCH,
        TripCause.ERROR_STORM,
        TripCause.DRY_RUN,
        TripCause.PUMP_DEAD,
        TripCause.ESTIMATOR_DIVERGED,
        TripCause.UNKNOWN_FAULT,
    } == BYPASSABLE


@pytest.mark.parametrize(
    "record",
    [LIMITS, NO_BELIEF, INTERLOCKS[0], RUNNING, supervisor._situation(LIMITS, RUNNING, HEALTHY, NOW_NS, NO_BELIEF)],
    ids=lambda record: type(record).__name__,
)
def test_records_can_not_be_changed(record: Any) -> None:
    is_tuple = isinstance(record, tuple)
    name = record._fields[0] if is_tuple else fields(record)[0].name
    with pytest.raises(AttributeError if is_tuple else FrozenInstanceError):
        setattr(record, name, getattr(record, name))
    assert not hasattr(record, "__dict__")


def test_the_supervisor_begins_with_nothing() -> None:
    assert Supervision() == Supervision(Mode.DISARMED, None, (0.0, 0.0), -1, (0.0, 0.0), (), "", clears_node=False)
    assert supervisor._situation(LIMITS, RUNNING, HEALTHY, NOW_NS, NO_BELIEF).mismatch_s == 0.0


def test_before_the_loop_there_is_nothing_to_believe() -> None:
    assert Belief(Diagnosis(), None, (0.0, 0.0), accommodates=False, open_share=(1.0, 1.0)) == NO_BELIEF


def test_trips_stand_before_stops() -> None:
    reactions = [interlock.reaction for interlock in INTERLOCKS]
    assert reactions == sorted(reactions, key=lambda reaction: reaction is Reaction.STOP)
    assert [i.cause for i in INTERLOCKS if i.reaction is Reaction.STOP] == [
        TripCause.PUMP_DEAD,
        TripCause.HIGH_LEVEL,
        TripCause.HIGH_LEVEL,
        TripCause.HIGH_LEVEL,
        TripCause.UNKNOWN_FAULT,
        TripCause.NO_STABLE_LAW,
        TripCause.START_FAILED,
        TripCause.SENSORS_LOST,
        TripCause.UNATTENDED,
    ]


def test_texts_have_their_numbers() -> None:
    gone = but(HEALTHY, "bus", is_up=False)
    assert text_of(gone) == "tripped: the CAN bus is gone"
    assert text_of(but(gone, "bus", last_error="no such device")) == "tripped: the CAN bus is gone: no such device"
    assert "23 within a second" in text_of(but(HEALTHY, "bus", errors_per_s=23))
    assert "levels of 12.26, 12.78, 1.63, 19.02 cm" in text_of(level(HEALTHY, 3, 9.51))
    state = RUNNING._replace(mismatch_since_ns=0)
    assert "short of 0.5 and -0.25 V" in text_of(but(HEALTHY, "pumps", shortfall_V=(0.5, -0.25)), state=state)


# levels: at, below and above their limits


@pytest.mark.parametrize("channel", range(4))
@pytest.mark.parametrize(("length", "cause"), [(1, None), (2, None), (3, TripCause.INVALID_LEVELS), (40, "same")])
def test_the_third_invalid_reading_trips_a_sensor_that_nobody_doubts(
    channel: int, length: int, cause: TripCause | str | None
) -> None:
    lengths = [0] * 4
    lengths[channel] = length
    assert cause_of(runs(*lengths), believing()) is (TripCause.INVALID_LEVELS if cause == "same" else cause)


@pytest.mark.parametrize("channel", range(4))
def test_the_model_takes_the_place_of_a_sensor_that_the_diagnosis_has_found_out(channel: int) -> None:
    lengths = [0] * 4
    lengths[channel] = 400
    bad = level(runs(*lengths), channel, 10.24)
    found = Diagnosis(trusted=doubted(channel), level_V=REST_V)
    assert cause_of(bad, believing(found)) is None
    other = Diagnosis(trusted=doubted((channel + 1) % 4), level_V=REST_V)
    assert cause_of(bad, believing(other)) is TripCause.INVALID_LEVELS
    for length, cause in ((2, None), (3, TripCause.INVALID_LEVELS)):
        lengths[channel] = length
        assert cause_of(runs(*lengths), believing(other)) is cause
    assert cause_of(bad, believing()) is TripCause.INVALID_LEVELS


@pytest.mark.parametrize("channel", range(4))
@pytest.mark.parametrize("nonsense", [math.nan, math.inf, -math.inf])
def test_a_level_that_is_no_number_trips_at_once_unless_nobody_asks_for_it(channel: int, nonsense: float) -> None:
    inputs = level(HEALTHY, channel, nonsense)
    assert cause_of(inputs, believing()) is TripCause.INVALID_LEVELS
    assert cause_of(inputs, believing(Diagnosis(trusted=doubted(channel), level_V=REST_V))) is None
    elsewhere = Diagnosis(trusted=doubted((channel + 1) % 4), level_V=REST_V)
    assert cause_of(inputs, believing(elsewhere)) is TripCause.INVALID_LEVELS


@pytest.mark.parametrize("channel", range(4))
@pytest.mark.parametrize("run", [1, 2])
def test_a_reading_that_is_not_valid_says_nothing_of_a_high_level(channel: int, run: int) -> None:
    """Shorted high for a reading or two; the estimate stands in, and it counts."""
    lengths = [0] * 4
    lengths[channel] = run
    shorted = level(runs(*lengths), channel, 10.24)
    assert cause_of(shorted, believing()) is None
    full = quad(19.1 if i == channel else h for i, h in enumerate(REST_CM))
    assert cause_of(shorted, believing()._replace(level_cm=full)) is TripCause.HIGH_LEVEL
    assert cause_of(shorted, NO_BELIEF) is TripCause.HIGH_LEVEL


@pytest.mark.parametrize("channel", range(4))
def test_levels_are_the_best_that_is_known(channel: int) -> None:
    others = tuple(i for i in range(4) if i != channel)
    inputs = level(HEALTHY, channel, 5.0)
    model_V, estimate_cm = (1.0, 2.0, 3.0, 4.0), (11.0, 12.0, 13.0, 14.0)
    lost = Diagnosis(trusted=doubted(channel), level_V=model_V)
    for seen, belief, expected in (
        (inputs, NO_BELIEF, 10.0),
        (inputs, Belief(lost, estimate_cm), 2.0 * model_V[channel]),
        (inputs, Belief(replace(lost, level_V=None), estimate_cm), 10.0),
        (but(inputs, "measurement", valid=doubted(channel)), Belief(Diagnosis(), estimate_cm), estimate_cm[channel]),
        (but(inputs, "measurement", valid=doubted(channel)), NO_BELIEF, 10.0),
        (but(inputs, "measurement", valid=doubted(channel)), Belief(lost, estimate_cm), 2.0 * model_V[channel]),
    ):
        found = interlocks.levels_cm(LIMITS, seen, belief)
        assert found[channel] == pytest.approx(expected)
        assert [found[i] for i in others] == pytest.approx([REST_CM[i] for i in others])


@pytest.mark.parametrize(("lost", "cause"), [((), None), ((2,), None), ((0, 1), TripCause.SENSORS_LOST)])
def test_one_sensor_may_be_lost_two_may_not(lost: tuple[int, ...], cause: TripCause | None) -> None:
    assert cause_of(HEALTHY, believing(Diagnosis(trusted=doubted(*lost), level_V=REST_V))) is cause


# sensors without trust that are alive


def without_trust(*channels: int, live_cm: float, limits: interlocks.Limits = LIMITS) -> tuple[Supervision, str]:
    """The supervisor's answer when these sensors without trust show a level, and the text of its first event."""
    shown = quad(live_cm if i in channels else -math.inf for i in range(4))
    diagnosis = Diagnosis(trusted=doubted(*channels), level_V=REST_V)
    state, events = after(HEALTHY, believing(diagnosis, live_cm=shown), limits=limits)
    return state, events[0].text


@pytest.mark.parametrize("channel", range(4))
def test_a_live_sensor_without_trust_keeps_its_veto_on_high_levels(channel: int) -> None:
    """The model's level alone was used: a lower tank whose outlet clogged slowly overflowed without a trip."""
    state, text = without_trust(channel, live_cm=19.01)
    assert (state.mode, state.cause) == (Mode.TRIPPED, TripCause.HIGH_LEVEL)
    assert text.endswith(f"cm; sensor {channel + 1}, which diagnosis does not trust, may be right")
    assert "19.01" in text
    for fine in (18.0, 0.0, -math.inf):
        assert without_trust(channel, live_cm=fine)[0].mode is Mode.DEGRADED


def test_the_higher_of_model_and_sensor_counts() -> None:
    diagnosis = Diagnosis(trusted=doubted(1), level_V=quad((1.0, 2.0, 3.0, 4.0)))
    for live, expected in ((5.0, 5.0), (3.0, 4.0), (-math.inf, 4.0)):
        belief = Belief(diagnosis, REST_CM, live_cm=(-math.inf, live, -math.inf, -math.inf))
        assert interlocks.levels_cm(LIMITS, HEALTHY, belief)[1] == expected


def test_the_text_names_the_sensors_without_trust_whose_levels_count() -> None:
    low = replace(LIMITS, level_max_cm=1.0)
    assert without_trust(0, live_cm=13.0, limits=low)[1].endswith(
        "; sensor 1, which diagnosis does not trust, may be right"
    )
    situation = supervisor._situation(LIMITS, RUNNING, HEALTHY, NOW_NS, NO_BELIEF)._replace(level_cm=(13.0,) * 4)
    high = next(interlock for interlock in INTERLOCKS if interlock.cause is TripCause.HIGH_LEVEL)
    two = high.describe(situation._replace(live_cm=(13.0, -math.inf, 13.0, 12.0)))
    assert two.endswith("13.00 cm; sensor 1 and 3, which diagnosis does not trust, may be right")
    assert high.describe(situation).endswith("13.00 cm")
    assert without_trust(0, live_cm=2.0, limits=low)[1].endswith(" cm")


# overshoot


def standing_at(h1: float, h3: float, *, side: int = 0) -> Inputs:
    """Lower and upper level in cm on one side, little on the other."""
    levels = (h1, 2.0, h3, 0.5) if side == 0 else (2.0, h1, 0.5, h3)
    return but(HEALTHY, "measurement", level_V=tuple(h / 2.0 for h in levels))


@pytest.mark.parametrize("side", [0, 1])
def test_a_tank_that_would_still_rise_to_the_rim_trips_before_its_level_does(side: int) -> None:
    idle = but(standing_at(18.0, 19.0, side=side), "pumps", applied_V=(0.0, 0.0))
    rim = replace(LIMITS, rim_margin_cm=0.0)
    off = RUNNING._replace(command_V=(0.0, 0.0))
    low, high = 18.0, 19.0
    for _ in range(40):  # the upper level at which the peak is at the limit, by bisection
        h3 = 0.5 * (low + high)
        trips = cause_of(standing_at(18.0, h3, side=side), state=off, limits=rim) is TripCause.HIGH_LEVEL
        low, high = (low, h3) if trips else (h3, high)
    assert cause_of(idle, state=off) is None
    assert cause_of(standing_at(18.9, 18.9, side=side), limits=rim) is None


@pytest.mark.parametrize("tank", [2, 3])
def test_a_peak_just_at_the_margin_is_good(tank: int) -> None:
    idle = but(HEALTHY, "pumps", applied_V=(0.0, 0.0))
    limits = replace(LIMITS, level_max_cm=20.0, lag_s=(0.0, 0.0))
    levels = [9.0] * 4
    for volts, cause in ((9.75 - JUST, None), (9.75, None), (9.75 + JUST, TripCause.HIGH_LEVEL)):
        levels[tank] = volts
        inputs = but(idle, "measurement", level_V=(0.0, 0.0, *levels[2:]))
        assert cause_of(inputs, limits=limits, state=RUNNING._replace(command_V=(0.0, 0.0))) is cause


def test_what_the_pumps_still_deliver_counts_whoever_says_so() -> None:
    """Command, applied voltage and the lagging flow: the largest of them is on its way."""
    brim = but(standing_at(2.0, 18.9), "pumps", applied_V=(0.0, 0.0))
    off = RUNNING._replace(command_V=(0.0, 0.0))
    tight = replace(LIMITS, rim_margin_cm=0.9, lag_s=(5.0, 5.0))
    assert cause_of(brim, state=off, limits=tight) is None
    assert cause_of(brim, state=off._replace(command_V=(0.0, 3.0)), limits=tight) is TripCause.HIGH_LEVEL
    assert cause_of(but(brim, "pumps", applied_V=(0.0, 3.0)), state=off, limits=tight) is TripCause.HIGH_LEVEL
    assert cause_of(brim, Belief(pump_V=(0.0, 3.0)), state=off, limits=tight) is TripCause.HIGH_LEVEL
    assert cause_of(brim, Belief(pump_V=(3.0, 0.0)), state=off, limits=tight) is None
    other = but(but(HEALTHY, "pumps", applied_V=(0.0, 0.0)), "measurement", level_V=(1.0, 1.0, 0.2, 9.45))
    assert cause_of(other, state=off._replace(command_V=(3.0, 0.0)), limits=tight) is TripCause.HIGH_LEVEL
    assert cause_of(other, state=off._replace(command_V=(0.0, 3.0)), limits=tight) is None


@pytest.mark.parametrize("side", [0, 1])
def test_a_blocked_outlet_brings_down_all_that_stands_above(side: int) -> None:
    shares = (0.02, 1.0) if side == 0 else (1.0, 0.02)
    inputs = standing_at(17.5, 2.5, side=side)
    assert cause_of(inputs) is None
    assert cause_of(inputs, Belief(open_share=shares)) is TripCause.HIGH_LEVEL
    assert cause_of(inputs, Belief(open_share=shares[::-1])) is None


# pumps


@pytest.mark.parametrize(
    ("theta", "applied", "cause"),
    [
        ((0.1 - JUST, 0.1 - JUST), (0.5 + JUST, 0.0), TripCause.DRY_RUN),
        ((0.1 - JUST, 0.1 - JUST), (0.0, 0.5 + JUST), TripCause.DRY_RUN),
        ((0.1, 0.0), (3.0, 3.0), None),
        ((0.0, 0.1), (3.0, 3.0), None),
        ((0.0, 0.0), (0.5, 0.5), None),
        ((0.0, 1.0), (3.0, 3.0), None),
    ],
)
def test_both_pumps_without_effect_and_one_driven_run_dry(theta: Pair, applied: Pair, cause: TripCause | None) -> None:
    assert cause_of(but(HEALTHY, "pumps", applied_V=applied), believing(Diagnosis(theta))) is cause


@pytest.mark.parametrize(
    ("theta", "unproven", "applied", "cause"),
    [
        ((0.1 - JUST, 1.0), (False, True), (0.5 + JUST, 0.0), TripCause.DRY_RUN),
        ((1.0, 0.1 - JUST), (True, False), (0.0, 0.5 + JUST), TripCause.DRY_RUN),
        ((0.1 - JUST, 1.0), (False, True), (0.5, 0.0), None),
        ((0.1 - JUST, 1.0), (True, False), (3.0, 0.0), None),
        ((1.0, 0.1 - JUST), (False, True), (0.0, 3.0), None),
        ((0.1, 1.0), (False, True), (3.0, 0.0), None),
        ((1.0, 0.1), (True, False), (0.0, 3.0), None),
    ],
)
def test_a_dead_pump_beside_one_that_stands_still_is_no_proof_of_water(
    theta: Pair, unproven: tuple[bool, bool], applied: Pair, cause: TripCause | None
) -> None:
    diagnosis = Diagnosis(theta, unproven=unproven)
    assert cause_of(but(HEALTHY, "pumps", applied_V=applied), believing(diagnosis)) is cause


@pytest.mark.parametrize(("applied", "cause"), [((0.5, 0.5), None), ((0.5 + JUST, 0.0), TripCause.DRY_RUN)])
def test_pumps_whose_water_does_not_arrive_run_dry_whatever_is_believed_of_them(
    applied: Pair, cause: TripCause | None
) -> None:
    inputs = but(HEALTHY, "pumps", applied_V=applied)
    assert cause_of(inputs, believing(Diagnosis(), is_dry=True)) is cause
    assert cause_of(inputs, believing(Diagnosis())) is None


@pytest.mark.parametrize("theta", [(0.1 - JUST, 1.0), (1.0, 0.1 - JUST), (0.0, 0.0)])
def test_a_dead_pump_stops_the_run_if_so_configured(theta: Pair) -> None:
    stops = replace(LIMITS, stops_on_dead_pump=True)
    off = but(HEALTHY, "pumps", applied_V=(0.0, 0.0))
    state, events = after(off, believing(Diagnosis(theta)), limits=stops)
    assert (state.mode, state.cause, state.stopped_by) == (Mode.STOPPING, None, "pump_dead")
    assert [(e.code, e.severity) for e in events] == [("stop", Severity.ERROR), ("mode", Severity.INFO)]
    assert events[0].data == {"cause": "pump_dead"}
    assert after(off, believing(Diagnosis(theta)))[0].mode is Mode.DEGRADED
    assert after(off, believing(Diagnosis((0.1, 0.1))), limits=stops)[0].mode is Mode.DEGRADED


@pytest.mark.parametrize("tank", [0, 1])
def test_a_tank_that_may_be_fuller_than_its_sensor_shows_stops_the_run(tank: int) -> None:
    """A slow drift downwards was held at the reference, unnoticed, while the tank filled up."""
    full = (19.0 + JUST, 13.0) if tank == 0 else (13.0, 19.0 + JUST)
    state, events = after(HEALTHY, believing(Diagnosis(), possible_cm=full))
    assert (state.mode, state.cause, state.stopped_by) == (Mode.STOPPING, None, "high_level")
    assert events[0].text == (
        "stopping: a lower tank leaks, or it is fuller than its sensor shows: "
        f"its inflow would hold up to {full[tank]:.2f} cm"
    )
    assert after(HEALTHY, believing(Diagnosis(), possible_cm=(19.0, 19.0)))[0].mode is Mode.RUNNING
    unknown = supervisor._situation(LIMITS, RUNNING, HEALTHY, NOW_NS, NO_BELIEF)
    stop = next(i for i in INTERLOCKS if i.cause is TripCause.HIGH_LEVEL and i.reaction is Reaction.STOP)
    assert stop.describe(unknown) == stop.text


@pytest.mark.parametrize("tank", [0, 1])
def test_a_tank_that_may_be_full_by_a_drift_that_is_not_excluded_stops_the_run(tank: int) -> None:
    """A drift downwards was named a leak, and no interlock used the level that the drift implied."""
    full = (19.0 + JUST, -math.inf) if tank == 0 else (-math.inf, 19.0 + JUST)
    state, events = after(HEALTHY, believing(Diagnosis(hidden_cm=full)))
    assert (state.mode, state.cause, state.stopped_by) == (Mode.STOPPING, None, "high_level")
    assert events[0].text == (
        "stopping: a lower tank may be nearly full: nothing excludes that its sensor drifts: "
        f"it would hold {full[tank]:.2f} cm"
    )
    assert after(HEALTHY, believing(Diagnosis(hidden_cm=(19.0, 19.0))))[0].mode is Mode.RUNNING


@pytest.mark.parametrize("tank", range(4))
def test_while_a_fault_is_unknown_a_level_near_its_limit_stops_the_run(tank: int) -> None:
    unknown = Diagnosis(is_unknown=True, unknown_s=1.0)
    high = level(HEALTHY, tank, 0.5 * (17.0 + JUST))
    state, events = after(high, believing(unknown))
    assert (state.mode, state.cause, state.stopped_by) == (Mode.STOPPING, None, "high_level")
    assert events[0].text.startswith(
        "stopping: something is wrong that no known fault explains, and a level is or may be high: levels of "
    )
    assert after(level(HEALTHY, tank, 0.5 * 17.0), believing(unknown))[0].mode is Mode.DEGRADED
    assert after(high, believing(Diagnosis()))[0].mode is Mode.RUNNING


@pytest.mark.parametrize("tank", range(4))
def test_while_a_fault_is_unknown_a_level_by_the_model_above_its_limit_stops_the_run(tank: int) -> None:
    """The sensors may be what is wrong, and the tank as full as the pumps have made it."""
    model_V = [6.0, 6.0, 1.0, 1.0]
    model_V[tank] = 0.5 * (19.0 + JUST)
    diagnosis = Diagnosis(is_unknown=True, unknown_s=1.0, possible_V=quad(model_V))
    assert after(HEALTHY, believing(diagnosis))[0].stopped_by == "high_level"
    model_V[tank] = 0.5 * 19.0
    just = replace(diagnosis, possible_V=quad(model_V))
    assert after(HEALTHY, believing(just))[0].mode is Mode.DEGRADED


def test_a_fault_that_stays_unknown_stops_the_run() -> None:
    known = Diagnosis(is_unknown=True, unknown_s=60.0)
    state, events = after(HEALTHY, believing(replace(known, unknown_s=60.0 + JUST)))
    assert (state.mode, state.cause, state.stopped_by) == (Mode.STOPPING, None, "unknown_fault")
    assert events[0].text == "stopping: something is wrong that no known fault explains: for 60 s"
    assert after(HEALTHY, believing(known))[0].mode is Mode.DEGRADED


def test_a_law_that_can_not_be_stable_stops_the_run_and_says_why() -> None:
    """A valve beyond gamma1 + gamma2 = 1 was named in 0.3 s, and the run went on into the high-level trip."""
    why = "valve splits of 0.250 and 0.600 leave no stable law"
    state, events = after(HEALTHY, believing(Diagnosis(), law_problem=why))
    assert (state.mode, state.cause, state.stopped_by) == (Mode.STOPPING, None, "no_stable_law")
    assert events[0].text == f"stopping: no control law can hold the outputs: {why}"
    assert after(HEALTHY, believing(Diagnosis()))[0].mode is Mode.RUNNING


def test_a_start_phase_that_has_failed_stops_the_run_and_says_why() -> None:
    why = "after 188 s level 1 is 9.00 cm, want 12.26 cm"
    state, events = after(HEALTHY, believing(Diagnosis(), start_problem=why))
    assert state.mode is Mode.STOPPING
    assert state.stopped_by == "start_failed"
    assert events[0].text == f"stopping: the start phase has failed: {why}"
    assert after(HEALTHY, believing(Diagnosis(), start_problem=""))[0].mode is Mode.RUNNING


@pytest.mark.parametrize("sensor", range(4))
def test_a_lost_lower_level_stops_the_run_if_so_configured(sensor: int) -> None:
    stops = replace(LIMITS, stops_on_lost_lower_level=True)
    off = but(HEALTHY, "pumps", applied_V=(0.0, 0.0))
    lost = Diagnosis(trusted=quad(one != sensor for one in range(4)), level_V=(2.0,) * 4)
    state, events = after(off, believing(lost), limits=stops)
    if sensor < 2:
        assert (state.mode, state.cause, state.stopped_by) == (Mode.STOPPING, None, "sensors_lost")
        assert events[0].data == {"cause": "sensors_lost"}
    else:
        assert state.mode is Mode.DEGRADED
    assert after(off, believing(lost))[0].mode is Mode.DEGRADED


def test_nobody_has_to_watch_a_run_unless_it_is_asked_for() -> None:
    unset = {field.name: field.default for field in fields(Limits)}
    assert (unset["unattended_s"], unset["attended_s"]) == (0.0, 0.0)


def test_a_run_that_nobody_watches_stops() -> None:
    why = "no request of an operator for 120 s"
    state, events = after(HEALTHY, believing(unattended=why))
    assert (state.mode, state.cause, state.stopped_by) == (Mode.STOPPING, None, "unattended")
    assert events[0].text == f"stopping: nobody watches the run: {why}"
    assert after(HEALTHY, believing(unattended=""))[0].mode is Mode.RUNNING


# counters and echoes


@pytest.mark.parametrize(
    ("key", "limit", "cause"),
    [("refused_run", 5, TripCause.FRAMES_REFUSED), ("errors_per_s", 20, TripCause.ERROR_STORM)],
)
def test_counters_trip_at_their_limit(key: str, limit: int, cause: TripCause) -> None:
    for count, expected in ((0, None), (limit - 1, None), (limit, cause), (limit + 1, cause)):
        assert cause_of(but(HEALTHY, "bus", **{key: count})) is expected


@pytest.mark.parametrize(("is_lossy", "limit_s"), [(False, 0.25), (True, 0.75)])
def test_a_heartbeat_may_be_three_times_as_old_on_a_bus_that_loses_frames(is_lossy: bool, limit_s: float) -> None:
    for age_s, cause in ((limit_s, None), (limit_s + JUST, TripCause.NODE_LOST)):
        assert cause_of(but(HEALTHY, "nodes", age_s=age_s, is_lossy=is_lossy)) is cause


@pytest.mark.parametrize("pump", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_node_that_does_not_apply_what_it_echoes_trips_after_a_while(pump: int, sign: float) -> None:
    def short(volts: float) -> Inputs:
        return but(HEALTHY, "pumps", shortfall_V=tuple(sign * volts if i == pump else 0.0 for i in (0, 1)))

    for begun_ns in (0, NOW_NS):
        state, _ = after(short(0.05), now_ns=begun_ns)
        assert state.mismatch_since_ns == -1
        state, _ = after(short(0.05 + JUST), state=state, now_ns=begun_ns)
        assert state.mismatch_since_ns == begun_ns
        state, _ = after(short(0.3), state=state, now_ns=begun_ns + SECOND // 5)
        assert (state.mode, state.mismatch_since_ns) == (Mode.RUNNING, begun_ns)
        again, _ = after(short(0.0), state=state, now_ns=begun_ns + SECOND // 5 + 1)
        assert again.mismatch_since_ns == -1
        assert again.mode is Mode.RUNNING
        late_ns = begun_ns + SECOND // 5 + 1000
        assert cause_of(short(0.3), state=state, now_ns=late_ns) is TripCause.ECHO_MISMATCH


# bypasses


def bypass(interlock: TripCause | None = TripCause.ESTIMATOR_DIVERGED, for_s: float = 60.0) -> Request:
    return Request(Action.BYPASS, interlock=interlock, for_s=for_s)


DIVERGED = believing(Diagnosis(is_diverged=True))


@pytest.mark.parametrize(("for_s", "lasts_s"), [(1.5, 1.5), (600.0, 600.0), (600.1, 600.0), (1e9, 600.0)])
def test_a_bypass_is_logged_and_ends_by_itself_within_ten_minutes(for_s: float, lasts_s: float) -> None:
    state, (event,) = after(replace(HEALTHY, requests=(bypass(for_s=for_s),)), DIVERGED)
    assert (event.code, event.severity) == ("bypass", Severity.WARNING)
    assert event.data == {"interlock": "estimator_diverged", "for_s": lasts_s}
    assert event.text == f"estimator_diverged bypassed for {lasts_s:g} s"
    ends_ns = NOW_NS + round(lasts_s * 1e9)
    assert state.bypasses == ((TripCause.ESTIMATOR_DIVERGED, ends_ns),)
    during, events = after(HEALTHY, DIVERGED, state=state, now_ns=ends_ns - 1)
    assert (during, events) == (state, ())
    over, events = after(HEALTHY, DIVERGED, state=state, now_ns=ends_ns)
    assert (over.mode, over.cause, over.bypasses) == (Mode.TRIPPED, TripCause.ESTIMATOR_DIVERGED, ())
    assert [e.code for e in events] == ["bypass_end", "trip"]
    assert (events[0].severity, events[0].data) == (Severity.WARNING, {"interlock": "estimator_diverged"})
    assert events[0].text == "estimator_diverged counts again"


def test_a_bypass_leaves_out_one_interlock_only() -> None:
    state, _ = after(replace(HEALTHY, requests=(bypass(),)), DIVERGED)
    for name, cause, fault in FAULTS:
        assert cause_of(fault(HEALTHY), DIVERGED, state=state) is cause, name
    dry = but(READY, "pumps", applied_V=(3.0, 3.0))
    dead = believing(Diagnosis((0.0, 0.0), is_diverged=True))
    assert cause_of(dry, dead, state=state) is TripCause.DRY_RUN
    both, _ = after(replace(dry, requests=(bypass(TripCause.DRY_RUN, 1.0),)), dead, state=state)
    assert both.cause is None
    assert dict(both.bypasses) == {
        TripCause.ESTIMATOR_DIVERGED: NOW_NS + 60 * SECOND,
        TripCause.DRY_RUN: NOW_NS + SECOND,
    }
    one, events = after(but(HEALTHY, "pumps", applied_V=(0.0, 0.0)), DIVERGED, state=both, now_ns=NOW_NS + SECOND)
    assert [c for c, _ in one.bypasses] == [TripCause.ESTIMATOR_DIVERGED]
    assert [e.code for e in events if e.code != "mode"] == ["bypass_end"]


def test_a_bypass_asked_for_again_lasts_again() -> None:
    state, _ = after(replace(HEALTHY, requests=(bypass(for_s=10.0),)))
    state, _ = after(replace(HEALTHY, requests=(bypass(for_s=5.0),)), state=state, now_ns=NOW_NS + 8 * SECOND)
    assert state.bypasses == ((TripCause.ESTIMATOR_DIVERGED, NOW_NS + 13 * SECOND),)


@pytest.mark.parametrize("cause", [None, *(c for c in TripCause if c not in BYPASSABLE)])
def test_an_interlock_without_which_nothing_is_safe_can_not_be_bypassed(cause: TripCause | None) -> None:
    state, (event,) = after(replace(HEALTHY, requests=(bypass(cause),)))
    assert state == RUNNING
    assert (event.code, event.severity) == ("refused", Severity.WARNING)
    assert event.data == {"action": "bypass", "reason": f"{cause} can't be bypassed"}
    assert event.text == f"bypass refused: {cause} can't be bypassed"


@pytest.mark.parametrize("for_s", [0.0, -1.0, math.nan, math.inf])
def test_a_bypass_for_no_time_or_for_ever_is_refused(for_s: float) -> None:
    state, (event,) = after(replace(HEALTHY, requests=(bypass(for_s=for_s),)))
    assert state.bypasses == ()
    assert "for_s must be positive and finite" in event.text


def test_a_request_that_names_an_interlock_is_no_bypass_by_that() -> None:
    request = Request(Action.MANUAL, interlock=TripCause.DRY_RUN, for_s=5.0)
    state, _ = after(replace(HEALTHY, requests=(request,)))
    assert (state.mode, state.bypasses) == (Mode.MANUAL, ())


def test_a_bypassed_interlock_does_not_keep_the_rig_from_arming() -> None:
    waiting = Supervision(bypasses=((TripCause.ERROR_STORM, NOW_NS + SECOND),))
    storm = but(READY, "bus", errors_per_s=50)
    assert after(storm, state=waiting)[0].mode is Mode.READY
    assert after(storm, state=Supervision())[0].mode is Mode.DISARMED


# clearing


def test_clearing_while_the_cause_stands_is_refused_and_says_why() -> None:
    tripped = Supervision(Mode.TRIPPED, TripCause.HIGH_LEVEL)
    inputs = replace(level(READY, 0, 9.6), requests=(Request(Action.CLEAR),))
    state, (event,) = after(inputs, state=tripped)
    assert state == tripped
    assert (event.code, event.severity) == ("refused", Severity.WARNING)
    assert event.data == {"action": "clear", "reason": "high_level"}
    assert event.text.startswith("clear refused: a tank is about to overflow: levels of 19.20")


def test_clearing_ends_disarmed_and_takes_the_nodes_own_trip_along() -> None:
    tripped = Supervision(Mode.TRIPPED, TripCause.NODE_TRIPPED)
    inputs = but(replace(READY, requests=(Request(Action.CLEAR),)), "pumps", state=NodeState.TRIPPED)
    state, (event,) = after(inputs, state=tripped)
    assert state == Supervision(clears_node=True)
    assert event.text == "TRIPPED -> DISARMED"
    state, _ = after(READY, state=state)
    assert (state.mode, state.clears_node) == (Mode.READY, True)
    state, _ = after(READY, state=state)
    assert (state.mode, state.clears_node) == (Mode.RUNNING, False)
    stopped, _ = after(but(READY, "bus", is_up=False), state=state._replace(clears_node=True))
    assert (stopped.mode, stopped.clears_node) == (Mode.TRIPPED, False)


@pytest.mark.parametrize("mode", [Mode.DISARMED, Mode.READY, Mode.TRIPPED])
def test_a_stop_while_nothing_moves_is_kept(mode: Mode) -> None:
    state, _ = after(replace(READY, requests=(Request(Action.STOP),)), state=Supervision(mode))
    assert state.stopped_by == "operator"
    if mode is not Mode.TRIPPED:
        for _ in range(3):
            state, _ = after(READY, state=state)
            assert state.mode is Mode.DISARMED


# manual


@pytest.mark.parametrize("volts", [(-JUST, 1.0), (1.0, 10.0 + JUST), (math.nan, 1.0), (1.0, math.inf)])
@pytest.mark.parametrize("mode", [Mode.RUNNING, Mode.MANUAL])
def test_manual_voltages_out_of_range_are_refused_and_change_nothing(mode: Mode, volts: Pair) -> None:
    before = Supervision(mode, None, (3.0, 3.0), manual_V=(3.5, 3.5))
    state, events = after(replace(HEALTHY, requests=(Request(Action.MANUAL, voltage_V=volts),)), state=before)
    assert state == before
    assert [e.code for e in events] == ["refused"]
    assert events[0].text == f"manual refused: {volts} V is outside 0..10 V"


def test_the_ends_of_the_range_can_be_asked_for() -> None:
    request = Request(Action.MANUAL, voltage_V=(0.0, 10.0))
    state, _ = after(replace(HEALTHY, requests=(request,)))
    assert (state.mode, state.manual_V) == (Mode.MANUAL, (0.0, 10.0))


def test_what_is_refused_names_mode_and_action() -> None:
    _, (event,) = after(replace(HEALTHY, requests=(Request(Action.AUTO),)))
    assert event.text == "auto refused: not while RUNNING"
    assert event.data == {"action": "auto", "reason": "not while RUNNING"}


# any history

REQUESTS = st.one_of(
    st.builds(Request, st.sampled_from([Action.AUTO, Action.CLEAR, Action.STOP])),
    st.builds(
        Request,
        st.just(Action.MANUAL),
        st.one_of(st.none(), st.tuples(st.floats(-2.0, 12.0), st.floats(allow_nan=True, allow_infinity=True))),
    ),
    st.builds(
        Request,
        st.just(Action.BYPASS),
        interlock=st.one_of(st.none(), st.sampled_from(TripCause)),
        for_s=st.floats(allow_nan=True, allow_infinity=True),
    ),
)
DIAGNOSES = st.sampled_from(
    [
        Diagnosis(),
        Diagnosis((0.4, 1.0)),
        Diagnosis((0.0, 0.0)),
        Diagnosis(is_diverged=True),
        Diagnosis(stuck_on=(True, False)),
        Diagnosis(trusted=doubted(1), level_V=REST_V),
    ]
)
STEPS = st.tuples(
    st.sampled_from([HEALTHY, READY, READY, READY]),
    st.lists(st.sampled_from(FAULTS), max_size=1),
    st.lists(REQUESTS, max_size=2),
    DIAGNOSES,
    st.booleans(),
    st.integers(1, 400),
    st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
)


@settings(max_examples=150, deadline=None)
@given(st.lists(STEPS, max_size=60), st.sampled_from([LIMITS, replace(LIMITS, stops_on_dead_pump=True)]))
def test_no_history_leaves_range_or_rate_or_forgets_a_trip(history: list[Any], limits: interlocks.Limits) -> None:
    state, now_ns = Supervision(), 0
    for base, faults, requests, diagnosis, stop, seconds, wanted_V in history:
        now_ns += seconds * SECOND
        inputs = replace(base, stop_requested=stop and not requests, requests=tuple(requests))
        for _, _, fault in faults:
            inputs = fault(inputs)
        before = state
        state, _ = supervisor.next_mode(limits, state, inputs, now_ns, believing(diagnosis))
        state, command = supervisor.safe_command(limits, state, wanted_V, 0.1)
        assert all(0.0 <= v <= 10.0 for v in command.voltage_V)
        for v, last in zip(command.voltage_V, before.command_V, strict=True):
            assert v - last <= 2.0 + 1e-12
            if command.enable:
                assert last - v <= 2.0 + 1e-12
        if state.mode is Mode.TRIPPED:
            assert command == OFF
            assert before.cause in (None, state.cause), "the first cause stays"
            assert state.cause is not None
        elif before.mode is Mode.TRIPPED:
            assert state.mode is Mode.DISARMED
            assert any(r.action is Action.CLEAR for r in requests)
        for cause, until_ns in state.bypasses:
            assert cause in BYPASSABLE
            assert now_ns <= until_ns <= now_ns + 600 * SECOND


def test_the_bench_is_healthy() -> None:
    assert LIMITS.model == BENCH
    assert HEALTHY.measurement.valid == ALL


REJECTIONS_EXPLAIN = {
    TripCause.BUS_FAILED,
    TripCause.NODE_TRIPPED,
    TripCause.FRAMES_REFUSED,
    TripCause.ERROR_STORM,
    TripCause.STALE_LEVELS,
    TripCause.STALE_STATUS,
    TripCause.NODE_LOST,
    TripCause.ECHO_MISSING,
}
"""Causes for which frames or lines that were rejected may be the reason: something is missing or refused on the bus."""


@pytest.mark.parametrize("interlock", INTERLOCKS, ids=lambda interlock: interlock.text)
def test_rejected_frames_are_named_where_they_may_be_the_reason(interlock: Interlock) -> None:
    """Nowhere else, and without a trace where nothing was rejected."""
    summary = "7 frames of 0x181 rejected: 7 crc"
    quiet, noisy = (
        Situation(
            inputs=replace(HEALTHY, bus=replace(HEALTHY.bus, rejection_summary=text)),
            diagnosis=Diagnosis(),
            level_cm=(10.0, 10.0, 2.0, 2.0),
            pump_V=(3.0, 3.0),
            mismatch_s=0.0,
            open_share=(1.0, 1.0),
            live_cm=NONE,
            law_problem="",
            start_problem="",
            possible_cm=None,
            is_dry=False,
        )
        for text in ("", summary)
    )
    plain = interlock.describe(quiet)
    expected = f"{plain}; {summary}" if interlock.cause in REJECTIONS_EXPLAIN else plain
    assert plain.startswith(interlock.text)
    assert interlock.describe(noisy) == expected
    assert Interlock(interlock.cause, interlock.is_active, "by default none").describe(noisy) == "by default none"


@pytest.mark.parametrize(("theta", "expected"), [((1.5, 0.5), (4.5, 3.0)), ((0.5, 1.5), (3.0, 4.5))])
def test_a_stronger_pump_still_delivers_more_and_a_weak_one_may_not_be_weak(theta: Pair, expected: Pair) -> None:
    situation = supervisor._situation(LIMITS, RUNNING, HEALTHY, NOW_NS, Belief(Diagnosis(theta), pump_V=(3.0, 3.0)))
    assert situation.pump_V == pytest.approx(expected)


# rigs as they are


@pytest.mark.parametrize("tank", range(4))
def test_every_tank_has_its_own_rim(tank: int) -> None:
    heights = quad(15.0 if i == tank else 20.0 for i in range(4))
    limits = replace(LIMITS, model=replace(LIMITS.model, height_cm=heights), lag_s=(0.0, 0.0))
    idle = but(HEALTHY, "pumps", applied_V=(0.0, 0.0))
    off = RUNNING._replace(command_V=(0.0, 0.0))
    for other in range(4):
        for volts, trips in ((7.25 - JUST, False), (7.25 + JUST, other == tank)):
            inputs = but(idle, "measurement", level_V=quad(volts if i == other else 0.0 for i in range(4)))
            assert (cause_of(inputs, limits=limits, state=off) is TripCause.HIGH_LEVEL) is trips


def test_what_a_pump_still_delivers_is_counted_by_its_curve() -> None:
    """Command and applied voltage are volts; what arrives by the model is a drive already."""
    pumps = PumpPath((0.5, 0.5), (0.1, 0.05))
    limits = replace(LIMITS, pumps=pumps)
    drives = pumps.drive((3.0, 4.0))
    seen = but(HEALTHY, "pumps", applied_V=(3.0, 1.0))
    situation = supervisor._situation(limits, RUNNING._replace(command_V=(1.0, 4.0)), seen, NOW_NS, Belief())
    assert situation.pump_V == pytest.approx(drives)
    late = supervisor._situation(limits, RUNNING, HEALTHY, NOW_NS, Belief(pump_V=(50.0, 60.0)))
    assert late.pump_V == (50.0, 60.0)
    assert limits.max_drives == pytest.approx(pumps.drive((10.0, 10.0)))
    assert replace(limits, range_V=(0.0, 8.0)).max_drives == pytest.approx(pumps.drive((8.0, 8.0)))
