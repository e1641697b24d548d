"""The supervisor: every mode times every interlock and event; limits swept; nothing unsafe is ever let through."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core import supervisor
from hil.core.interlocks import INTERLOCKS, Belief
from hil.core.supervisor import CLEAR, OFF, RAMP_END_V, Supervision
from hil.core.types import Action, Command, Diagnosis, Inputs, Mode, NodeState, Pair, Request, Severity, TripCause
from tests.safety.safety_bench import FAULTS, HEALTHY, LIMITS, READY, but, level

CONTROLLING = (Mode.RUNNING, Mode.DEGRADED)
TRIPPING = (*CONTROLLING, Mode.STOPPING)
WAITING = (Mode.DISARMED, Mode.READY)
NOW_NS = 5_000_000_000
NO_FAULT = Belief(accommodates=True)
FAULTY = Belief(Diagnosis((0.4, 1.0)), accommodates=True)
FAULT_IDS = [name for name, _, _ in FAULTS]
ONE_FAULT = pytest.mark.parametrize("fault", [fault for _, _, fault in FAULTS], ids=FAULT_IDS)


def supervision(mode: Mode, command_V: Pair = (3.0, 3.0)) -> supervisor.Supervision:
    cause = TripCause.ECHO_MISSING if mode is Mode.TRIPPED else None
    return Supervision(mode, cause, command_V if mode in TRIPPING else (0.0, 0.0))


def step(
    mode: Mode, inputs: Inputs, *, is_degraded: bool = False, wanted_V: Pair = (5.0, 5.0)
) -> tuple[supervisor.Supervision, Command, list[str]]:
    """One step of the supervisor: the mode after it, the cause, the command, the codes of its events."""
    state, events = supervisor.next_mode(LIMITS, supervision(mode), inputs, NOW_NS, FAULTY if is_degraded else NO_FAULT)
    state, command = supervisor.safe_command(LIMITS, state, wanted_V, 0.1)
    return state, command, [event.code for event in events]


# every mode times every event


@pytest.mark.parametrize(("cause", "fault"), [(cause, fault) for _, cause, fault in FAULTS], ids=FAULT_IDS)
@pytest.mark.parametrize("mode", TRIPPING)
@pytest.mark.parametrize("stop", [False, True])
def test_an_interlock_trips_in_the_same_step_and_wins_over_a_stop(
    mode: Mode, cause: TripCause, fault: Callable[[Inputs], Inputs], stop: bool
) -> None:
    state, command, codes = step(mode, replace(fault(HEALTHY), stop_requested=stop))
    assert state == Supervision(Mode.TRIPPED, cause, (0.0, 0.0))
    assert command == OFF
    assert codes == ["trip"]


@ONE_FAULT
@pytest.mark.parametrize("mode", WAITING)
def test_an_interlock_keeps_the_rig_disarmed(mode: Mode, fault: Callable[[Inputs], Inputs]) -> None:
    state, command, codes = step(mode, fault(READY))
    assert state.mode is Mode.DISARMED
    assert state.cause is None
    assert command == OFF
    assert codes == ([] if mode is Mode.DISARMED else ["mode"])
    assert supervisor.not_ready(LIMITS, fault(READY))


@ONE_FAULT
def test_a_trip_keeps_its_first_cause_whatever_comes_after(fault: Callable[[Inputs], Inputs]) -> None:
    state, command, codes = step(Mode.TRIPPED, fault(HEALTHY))
    assert state == supervision(Mode.TRIPPED)
    assert command == OFF
    assert codes == []


@pytest.mark.parametrize("is_degraded", [False, True])
@pytest.mark.parametrize("stop", [False, True])
@pytest.mark.parametrize("inputs", [HEALTHY, READY], ids=["node runs", "node ready"])
def test_a_trip_is_for_ever(inputs: Inputs, stop: bool, is_degraded: bool) -> None:
    state = supervision(Mode.TRIPPED)
    for _ in range(100):
        belief = FAULTY if is_degraded else NO_FAULT
        state, events = supervisor.next_mode(LIMITS, state, replace(inputs, stop_requested=stop), NOW_NS, belief)
        state, command = supervisor.safe_command(LIMITS, state, (5.0, 5.0), 0.1)
        assert command == OFF
        assert events == ()
    assert state.mode is Mode.TRIPPED
    assert state.cause is TripCause.ECHO_MISSING


def test_trip_of_a_tripped_supervisor_changes_nothing() -> None:
    state, events = supervisor.trip(supervision(Mode.TRIPPED), TripCause.HIGH_LEVEL, "late")
    assert state == supervision(Mode.TRIPPED)
    assert events == ()


@pytest.mark.parametrize("mode", [m for m in Mode if m is not Mode.TRIPPED])
def test_trip_from_any_other_mode_latches_with_its_cause(mode: Mode) -> None:
    state, (event,) = supervisor.trip(supervision(mode), TripCause.CONTROLLER_FAILED, "it broke")
    assert state == Supervision(Mode.TRIPPED, TripCause.CONTROLLER_FAILED, (0.0, 0.0))
    assert event.severity is Severity.ERROR
    assert event.data == {"cause": "controller_failed"}
    assert "it broke" in event.text


HEALTHY_STEPS = [
    # mode, node, stop, degraded -> mode
    (Mode.DISARMED, "ready", False, False, Mode.READY),
    (Mode.DISARMED, "ready", False, True, Mode.READY),
    (Mode.DISARMED, "ready", True, False, Mode.DISARMED),
    (Mode.DISARMED, "run", False, False, Mode.DISARMED),
    (Mode.DISARMED, "boot", False, False, Mode.DISARMED),
    (Mode.READY, "ready", False, False, Mode.RUNNING),
    (Mode.READY, "ready", True, False, Mode.DISARMED),
    (Mode.READY, "run", False, False, Mode.DISARMED),
    (Mode.READY, "boot", False, False, Mode.DISARMED),
    (Mode.RUNNING, "ready", False, False, Mode.RUNNING),
    (Mode.RUNNING, "run", False, False, Mode.RUNNING),
    (Mode.RUNNING, "run", False, True, Mode.DEGRADED),
    (Mode.RUNNING, "run", True, False, Mode.STOPPING),
    (Mode.RUNNING, "run", True, True, Mode.STOPPING),
    (Mode.DEGRADED, "run", False, True, Mode.DEGRADED),
    (Mode.DEGRADED, "run", False, False, Mode.RUNNING),
    (Mode.DEGRADED, "run", True, True, Mode.STOPPING),
    (Mode.STOPPING, "run", True, False, Mode.STOPPING),
    (Mode.STOPPING, "run", False, False, Mode.STOPPING),
    (Mode.STOPPING, "ready", False, True, Mode.STOPPING),
]


@pytest.mark.parametrize(("mode", "node", "stop", "degraded", "expected"), HEALTHY_STEPS)
def test_healthy_steps(mode: Mode, node: str, stop: bool, degraded: bool, expected: Mode) -> None:
    inputs = but(READY, "pumps", state=NodeState[node.upper()])
    state, command, codes = step(mode, replace(inputs, stop_requested=stop), is_degraded=degraded)
    assert state.mode is expected
    assert state.cause is None
    assert command.enable == (expected in TRIPPING)
    assert codes == ([] if expected is mode else ["mode"])


@pytest.mark.parametrize("mode", [Mode.DISARMED, Mode.READY, Mode.TRIPPED])
@pytest.mark.parametrize("wanted_V", [(5.0, 5.0), (0.0, 0.0), (math.nan, 1.0), (math.inf, -math.inf)])
def test_nothing_is_enabled_unless_controlling_or_ramping_down(mode: Mode, wanted_V: Pair) -> None:
    state, command = supervisor.safe_command(LIMITS, supervision(mode), wanted_V, 0.1)
    assert command == OFF
    assert state.mode is mode
    assert state.command_V == (0.0, 0.0)


def test_off_and_clear_are_disabled_at_0_volts() -> None:
    assert OFF.voltage_V == CLEAR.voltage_V == (0.0, 0.0)
    assert not OFF.enable
    assert not CLEAR.enable
    assert not OFF.clear_trip
    assert CLEAR.clear_trip


def test_of_several_interlocks_the_root_names_the_trip() -> None:
    """A bus that is gone makes everything stale as well: the trip says "bus"."""
    inputs = HEALTHY
    for _, _, fault in reversed(FAULTS):
        inputs = fault(inputs)
    state, _, _ = step(Mode.RUNNING, inputs)
    assert state.cause is TripCause.BUS_FAILED
    assert {interlock.cause for interlock in INTERLOCKS} | {TripCause.CONTROLLER_FAILED} == set(TripCause)


def test_what_is_not_ready_is_said() -> None:
    assert supervisor.not_ready(LIMITS, READY) == ""
    assert supervisor.not_ready(LIMITS, HEALTHY) == "the pump node is in state run, not ready"
    assert supervisor.not_ready(LIMITS, but(READY, "bus", is_up=False)) == "the CAN bus is gone"


def test_at_rest_is_what_the_node_says_of_itself() -> None:
    assert supervisor.is_at_rest(READY)
    assert supervisor.is_at_rest(but(READY, "pumps", state=NodeState.TRIPPED))
    assert not supervisor.is_at_rest(but(READY, "pumps", state=NodeState.RUN))
    assert not supervisor.is_at_rest(but(READY, "pumps", applied_V=(0.0, 0.0002)))
    assert not supervisor.is_at_rest(but(READY, "pumps", applied_V=(math.nan, math.nan)))


# limits: at, just below, just above, in every mode

JUST = 1e-9
SWEEPS = [
    ("measurement", "age_s", LIMITS.levels_age_max_s, TripCause.STALE_LEVELS),
    ("pumps", "age_s", LIMITS.status_age_max_s, TripCause.STALE_STATUS),
    ("nodes", "age_s", LIMITS.heartbeat_age_max_s, TripCause.NODE_LOST),
    ("pumps", "unechoed_s", LIMITS.echo_age_max_s, TripCause.ECHO_MISSING),
]


def expected_after(mode: Mode, stands: bool) -> Mode:
    if mode is Mode.TRIPPED:
        return Mode.TRIPPED
    if stands:
        return Mode.DISARMED if mode in WAITING else Mode.TRIPPED
    return {Mode.DISARMED: Mode.READY, Mode.READY: Mode.RUNNING}.get(mode, mode)


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize(("part", "key", "limit", "cause"), SWEEPS)
@pytest.mark.parametrize(("offset", "stands"), [(-JUST, False), (0.0, False), (JUST, True), (1e6, True)])
def test_ages_are_good_up_to_their_limit(
    mode: Mode, part: str, key: str, limit: float, cause: TripCause, offset: float, stands: bool
) -> None:
    state, command, _ = step(mode, but(READY, part, **{key: limit + offset}), is_degraded=mode is Mode.DEGRADED)
    assert state.mode is expected_after(mode, stands)
    if stands and mode in TRIPPING:
        assert state.cause is cause
    if stands:
        assert command == OFF


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("channel", range(4))
@pytest.mark.parametrize(("volts", "stands"), [(9.5 - JUST, False), (9.5, False), (9.5 + JUST, True), (10.24, True)])
def test_levels_are_good_up_to_19_cm_in_every_tank(mode: Mode, channel: int, volts: float, stands: bool) -> None:
    state, command, _ = step(mode, level(READY, channel, volts), is_degraded=mode is Mode.DEGRADED)
    assert state.mode is expected_after(mode, stands)
    if stands:
        assert command == OFF
    if stands and mode in TRIPPING:
        assert state.cause is TripCause.HIGH_LEVEL


@pytest.mark.parametrize("mode", CONTROLLING)
@pytest.mark.parametrize("pump", [0, 1])
@pytest.mark.parametrize(
    ("last", "wanted", "passed"),
    [
        (9.0, 10.0 - JUST, 10.0 - JUST),
        (9.0, 10.0, 10.0),
        (9.0, 10.0 + JUST, 10.0),
        (9.0, 1e300, 10.0),
        (1.0, JUST, JUST),
        (1.0, 0.0, 0.0),
        (1.0, -JUST, 0.0),
        (1.0, -1e300, 0.0),
    ],
)
def test_commands_stay_within_the_range(mode: Mode, pump: int, last: float, wanted: float, passed: float) -> None:
    wanted_V = (wanted, 5.0) if pump == 0 else (5.0, wanted)
    before = (last, 5.0) if pump == 0 else (5.0, last)
    state, command = supervisor.safe_command(LIMITS, Supervision(mode, None, before), wanted_V, 0.1)
    assert command.voltage_V[pump] == pytest.approx(passed, abs=1e-15)
    assert command.voltage_V[1 - pump] == 5.0
    assert command.enable
    assert state.command_V == command.voltage_V


@pytest.mark.parametrize("mode", CONTROLLING)
@pytest.mark.parametrize(
    ("wanted", "passed"),
    [
        (7.0 - JUST, 7.0 - JUST),
        (7.0, 7.0),
        (7.0 + JUST, 7.0),
        (9.0, 7.0),
        (3.0 + JUST, 3.0 + JUST),
        (3.0, 3.0),
        (3.0 - JUST, 3.0),
        (0.0, 3.0),
    ],
)
def test_commands_change_by_20_volts_a_second_at_most(mode: Mode, wanted: float, passed: float) -> None:
    state, command = supervisor.safe_command(LIMITS, Supervision(mode, None, (5.0, 5.0)), (wanted, wanted), 0.1)
    assert command.voltage_V == pytest.approx((passed, passed), abs=1e-12)
    assert state.command_V == command.voltage_V


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.floats(allow_nan=False, allow_infinity=False), st.floats(-20, 20)), max_size=20),
    st.floats(0.001, 1.0),
)
def test_no_sequence_of_wanted_voltages_leaves_range_or_rate(voltages: list[Pair], period_s: float) -> None:
    state = Supervision(Mode.RUNNING)
    for wanted_V in voltages:
        before = state.command_V
        state, command = supervisor.safe_command(LIMITS, state, wanted_V, period_s)
        for now, then in zip(command.voltage_V, before, strict=True):
            assert 0.0 <= now <= 10.0
            assert abs(now - then) <= 20.0 * period_s + 1e-12


@pytest.mark.parametrize("mode", CONTROLLING)
@pytest.mark.parametrize("pump", [0, 1])
@pytest.mark.parametrize("nonsense", [math.nan, math.inf, -math.inf])
def test_a_wanted_voltage_that_is_no_number_is_an_error_and_never_a_command(
    mode: Mode, pump: int, nonsense: float
) -> None:
    wanted_V = (nonsense, 5.0) if pump == 0 else (5.0, nonsense)
    with pytest.raises(ValueError, match="the control law asked for"):
        supervisor.safe_command(LIMITS, supervision(mode), wanted_V, 0.1)


def test_a_stop_ramps_both_pumps_down_and_then_disables_them() -> None:
    state = Supervision(Mode.STOPPING, None, (3.0, 1.5))
    commands = []
    for _ in range(6):
        state, command = supervisor.safe_command(LIMITS, state, (math.nan, 9.0), 0.1)
        commands.append(command)
    assert [c.voltage_V for c in commands] == [(2.0, 0.5), (1.0, 0.0), *[(0.0, 0.0)] * 4]
    assert [c.enable for c in commands] == [True, True, False, False, False, False]


@pytest.mark.parametrize("from_V", [(2.8, 1.0), (1.0, 2.8), (3.2004, 0.3)])
def test_a_ramp_ends_disabled_and_not_with_a_command_of_less_than_the_wire_can_say(from_V: Pair) -> None:
    """2.8 V in steps of 0.4 leaves 1e-16 V, which was sent as 0 V, enabled."""
    state = Supervision(Mode.STOPPING, None, from_V)
    limits = replace(LIMITS, stop_ramp_V_s=20.0)
    for _ in range(10):
        state, command = supervisor.safe_command(limits, state, (0.0, 0.0), 0.02)
        assert min(command.voltage_V) >= 0.0
        assert command.enable == (max(command.voltage_V) > 0.3)
        assert state.command_V == command.voltage_V


def test_a_ramp_goes_on_as_long_as_a_pump_has_its_end_voltage() -> None:
    held = replace(LIMITS, stop_ramp_V_s=0.0)
    _, command = supervisor.safe_command(held, Supervision(Mode.STOPPING, None, (RAMP_END_V, 0.0)), (0.0, 0.0), 0.1)
    assert command == Command((RAMP_END_V, 0.0), enable=True)


def test_a_ramp_begins_at_the_last_command() -> None:
    state, command = supervisor.safe_command(LIMITS, Supervision(Mode.RUNNING, None, (4.0, 5.0)), (4.5, 4.0), 0.1)
    stopping, _ = supervisor.next_mode(LIMITS, state, replace(HEALTHY, stop_requested=True), NOW_NS)
    _, command = supervisor.safe_command(LIMITS, stopping, (4.5, 4.0), 0.1)
    assert command.voltage_V == pytest.approx((3.5, 3.0))


INPUTS = st.tuples(
    st.sampled_from([HEALTHY, READY]), st.lists(st.sampled_from(FAULTS), max_size=1), st.booleans(), st.booleans()
)


@settings(max_examples=100, deadline=None)
@given(st.lists(INPUTS, max_size=40), st.lists(st.floats(-50, 50), min_size=40, max_size=40))
def test_invariants_over_any_history(history: list[Any], voltages: list[float]) -> None:
    """Never enabled while an interlock stands; latched once tripped; only DISARMED leads to READY, READY to RUNNING."""
    state = Supervision()
    for (base, faults, stop, degraded), voltage in zip(history, voltages, strict=False):
        inputs = replace(base, stop_requested=stop)
        for _, _, fault in faults:
            inputs = fault(inputs)
        before = state
        state, _ = supervisor.next_mode(LIMITS, state, inputs, NOW_NS, FAULTY if degraded else NO_FAULT)
        state, command = supervisor.safe_command(LIMITS, state, (voltage, -voltage), 0.1)
        if faults:
            assert command == OFF
        if before.mode is Mode.TRIPPED:
            assert state == before
        if state.mode in CONTROLLING and before.mode not in CONTROLLING:
            assert before.mode is Mode.READY
        if before.mode is Mode.STOPPING:
            assert state.mode in (Mode.STOPPING, Mode.TRIPPED)
            assert max(command.voltage_V) <= max(before.command_V)
        if command.enable:
            assert state.mode in TRIPPING
        else:
            assert command.voltage_V == (0.0, 0.0)


@pytest.mark.parametrize(("number", "in_data"), [(7, {"number": 7}), (0, {})])
def test_a_refusal_has_the_number_of_its_request(number: int, in_data: dict[str, int]) -> None:
    """By which the control channel finds the request that it answers; a scheduled request has none."""
    inputs = replace(HEALTHY, requests=(Request(Action.AUTO, number=number),))
    _, events = supervisor.next_mode(LIMITS, supervision(Mode.RUNNING), inputs, NOW_NS, NO_FAULT)
    (refused,) = [event for event in events if event.code == "refused"]
    assert refused.data == {"action": "auto", "reason": "not while RUNNING", **in_data}
