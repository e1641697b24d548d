"""Every mode times every event: the mode after it, the command, and what is said."""

from dataclasses import replace
from typing import Any

import pytest

from hil.core import supervisor
from hil.core.supervisor import Supervision
from hil.core.types import Action, Diagnosis, Inputs, Mode, NodeState, Pair, Request, Severity, TripCause
from tests.safety.safety_bench import FAULTS, HEALTHY, LIMITS, READY, VERDICTS, believing, but

NOW_NS = 5_000_000_000
PERIOD_S = 0.1
LETTERS = {
    "D": Mode.DISARMED,
    "R": Mode.READY,
    "U": Mode.RUNNING,
    "G": Mode.DEGRADED,
    "S": Mode.STOPPING,
    "T": Mode.TRIPPED,
    "M": Mode.MANUAL,
}
MODES = tuple(LETTERS.values())
DRIVEN = (Mode.RUNNING, Mode.DEGRADED, Mode.STOPPING, Mode.MANUAL)
WANTED_V = (4.0, 2.5)
BEFORE_V = (3.0, 3.0)
MANUAL_V = (3.5, 1.5)
LOST = Diagnosis((0.4, 1.0))
DEAD = Diagnosis((0.05, 1.0))
STOPS_ON_DEAD = replace(LIMITS, stops_on_dead_pump=True)
STOPS_ON_LOST = replace(LIMITS, stops_on_lost_lower_level=True)


def asked(*requests: Request, base: Inputs = READY) -> Inputs:
    return replace(base, requests=requests)


def request(action: Action, **details: Any) -> Request:
    return Request(action, **details)


MANUAL, AUTO, CLEAR, STOP = (request(a) for a in (Action.MANUAL, Action.AUTO, Action.CLEAR, Action.STOP))
MANUAL_AT = request(Action.MANUAL, voltage_V=(6.0, 1.0))
BYPASS = request(Action.BYPASS, interlock=TripCause.ESTIMATOR_DIVERGED, for_s=60.0)
NODE_TRIPPED = but(HEALTHY, "pumps", state=NodeState.TRIPPED)
BOTH_DEAD = Diagnosis((0.05, 0.0))

# event: inputs, diagnosis, limits, and the modes after it, in the order of the header
#                                                                                  from  D R U G S T M
EVENTS = {
    "all is well, the node waits": (READY, Diagnosis(), LIMITS, "RUUUSTM"),
    "all is well, the node runs": (HEALTHY, Diagnosis(), LIMITS, "DDUUSTM"),
    "a pump lost gain": (READY, LOST, LIMITS, "RGGGSTM"),
    "a sensor is replaced": (
        READY, Diagnosis(trusted=(True, False, True, True), level_V=(2.0,) * 4), LIMITS, "RGGGSTM",
    ),
    "a lower sensor is lost, which stops": (
        READY, Diagnosis(trusted=(True, False, True, True), level_V=(2.0,) * 4), STOPS_ON_LOST, "DDSSSTS",
    ),
    "a pump is dead, the other goes on": (READY, DEAD, LIMITS, "RGGGSTM"),
    "a pump is dead, which stops": (READY, DEAD, STOPS_ON_DEAD, "DDSSSTS"),
    "both pumps run dry": (HEALTHY, BOTH_DEAD, LIMITS, "DDTTTTT"),
    "both pumps run dry, and dead ones stop": (HEALTHY, BOTH_DEAD, STOPS_ON_DEAD, "DDTTTTT"),
    "both pumps are dead and off": (READY, BOTH_DEAD, LIMITS, "RGGGSTM"),
    "the run is to stop": (replace(READY, stop_requested=True), Diagnosis(), LIMITS, "DDSSSTS"),
    "the run is to stop, a pump lost gain": (replace(READY, stop_requested=True), LOST, LIMITS, "DDSSSTS"),
    "asked for manual": (asked(MANUAL), Diagnosis(), LIMITS, "RUMMSTM"),
    "asked for manual voltages": (asked(MANUAL_AT), LOST, LIMITS, "RGMMSTM"),
    "asked for auto": (asked(AUTO), Diagnosis(), LIMITS, "RUUUSTU"),
    "asked for auto, a pump lost gain": (asked(AUTO), LOST, LIMITS, "RGGGSTG"),
    "asked to clear": (asked(CLEAR), Diagnosis(), LIMITS, "RUUUSDM"),
    "asked to clear, the node runs": (asked(CLEAR, base=HEALTHY), Diagnosis(), LIMITS, "DDUUSDM"),
    "asked to clear, the node tripped": (asked(CLEAR, base=NODE_TRIPPED), Diagnosis(), LIMITS, "DDTTTDT"),
    "asked to clear, a dead pump stands": (asked(CLEAR), DEAD, STOPS_ON_DEAD, "DDSSSTS"),
    "asked to stop": (asked(STOP), Diagnosis(), LIMITS, "DDSSSTS"),
    "asked to bypass": (asked(BYPASS), Diagnosis(), LIMITS, "RUUUSTM"),
    "asked to bypass what stands": (asked(BYPASS), Diagnosis(is_diverged=True), LIMITS, "RUUUSTM"),
    "asked to bypass and clear": (asked(BYPASS, CLEAR), Diagnosis(is_diverged=True), LIMITS, "RUUUSDM"),
    "manual and auto at once": (asked(MANUAL, AUTO), Diagnosis(), LIMITS, "RUMMSTM"),
    "manual and stop at once": (asked(MANUAL, STOP), Diagnosis(), LIMITS, "DDSSSTS"),
    "auto and stop at once": (asked(AUTO, STOP), Diagnosis(), LIMITS, "DDSSSTS"),
    "auto while the run is to stop": (
        replace(asked(AUTO), stop_requested=True), Diagnosis(), LIMITS, "DDSSSTS",
    ),
    "manual while a dead pump stops": (asked(MANUAL), DEAD, STOPS_ON_DEAD, "DDSSSTS"),
    **{f"{name} (inputs)": (fault(HEALTHY), Diagnosis(), LIMITS, "DDTTTTT") for name, _, fault in FAULTS},
    **{f"{name} (diagnosis)": (READY, verdict, LIMITS, "DDTTTTT") for name, _, verdict in VERDICTS},
    **{
        f"{name}, asked for everything": (
            replace(fault(HEALTHY), stop_requested=True, requests=(MANUAL_AT, AUTO, CLEAR, STOP, BYPASS)),
            LOST,
            STOPS_ON_DEAD,
            "DDTTTTT",
        )
        for name, cause, fault in FAULTS
        if cause is not TripCause.NODE_TRIPPED
    },
}  # fmt: skip


def begun(mode: Mode) -> Supervision:
    cause = TripCause.ECHO_MISSING if mode is Mode.TRIPPED else None
    return Supervision(mode, cause, BEFORE_V if mode in DRIVEN else (0.0, 0.0), manual_V=MANUAL_V)


def expected_command(before: Mode, after: Mode, inputs: Inputs) -> tuple[Pair, bool]:
    """Voltages and whether enabled; the rate is 2 V a step, the ramp 1 V."""
    if after in (Mode.DISARMED, Mode.READY, Mode.TRIPPED):
        return (0.0, 0.0), False
    if after is Mode.STOPPING:
        return (2.0, 2.0), True
    if after is Mode.MANUAL:
        asked_V = [r.voltage_V for r in inputs.requests if r.action is Action.MANUAL]
        if not asked_V:
            return MANUAL_V, True
        return (5.0, 1.0) if asked_V[-1] else BEFORE_V, True
    return (WANTED_V if before in DRIVEN else (2.0, 2.0)), True


@pytest.mark.parametrize("name", EVENTS)
@pytest.mark.parametrize("before", MODES, ids=lambda mode: mode.name)
def test_every_mode_times_every_event(before: Mode, name: str) -> None:
    inputs, diagnosis, limits, row = EVENTS[name]
    expected = LETTERS[row[MODES.index(before)]]
    state, events = supervisor.next_mode(limits, begun(before), inputs, NOW_NS, believing(diagnosis))
    state, command = supervisor.safe_command(limits, state, WANTED_V, PERIOD_S)
    assert state.mode is expected
    assert (command.voltage_V, command.enable) == expected_command(before, expected, inputs)
    assert not command.clear_trip
    assert state.command_V == command.voltage_V
    codes = [event.code for event in events]
    if before is Mode.TRIPPED:
        assert state.cause is (TripCause.ECHO_MISSING if expected is Mode.TRIPPED else None)
        assert "trip" not in codes
    else:
        assert codes.count("trip") == (expected is Mode.TRIPPED)
        assert (state.cause is not None) == (expected is Mode.TRIPPED)
    assert codes.count("mode") == (expected not in (before, Mode.TRIPPED))
    refusals = [e.data["action"] for e in events if e.code == "refused"]
    not_allowed = [r.action.value for r in inputs.requests if r.action not in supervisor.ALLOWED_ACTIONS[before]]
    stays_tripped = before is expected is Mode.TRIPPED and CLEAR in inputs.requests
    assert refusals == not_allowed + ["clear"] * stays_tripped


def test_the_letters_name_every_mode() -> None:
    assert set(MODES) == set(Mode)
    assert [mode.value for mode in Mode] == [0, 1, 2, 3, 4, 5, 6]


TRIPS = [(name, cause, fault(HEALTHY), Diagnosis()) for name, cause, fault in FAULTS]
TRIPS += [(name, cause, READY, verdict) for name, cause, verdict in VERDICTS]
TRIPS += [("both pumps run dry", TripCause.DRY_RUN, HEALTHY, BOTH_DEAD)]


@pytest.mark.parametrize(("cause", "inputs", "verdict"), [t[1:] for t in TRIPS], ids=[t[0] for t in TRIPS])
@pytest.mark.parametrize("mode", DRIVEN, ids=lambda mode: mode.name)
def test_a_trip_names_its_cause_and_cuts_the_relay_of_a_pump_that_is_stuck_on(
    mode: Mode, cause: TripCause, inputs: Inputs, verdict: Diagnosis
) -> None:
    state, events = supervisor.next_mode(LIMITS, begun(mode), inputs, NOW_NS, believing(verdict))
    assert state.cause is cause
    assert state.command_V == (0.0, 0.0)
    assert events[0].code == "trip"
    assert events[0].severity is Severity.ERROR
    assert events[0].data == {"cause": cause.value}
    assert events[0].text.startswith("tripped: ")
    further = ["relay_cut"] if cause is TripCause.PUMP_STUCK_ON else []
    assert [e.code for e in events[1:]] == further
    assert all(e.severity is Severity.ERROR for e in events)
