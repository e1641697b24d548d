"""The supervisor: modes, and what may be sent to the pumps.

DISARMED -> READY     every condition for arming holds (`not_ready` names the first that does not)
READY -> RUNNING      on the next step, if the conditions still hold; otherwise back to DISARMED
RUNNING <-> DEGRADED  DEGRADED while a fault is known and accommodated
controlling <-> MANUAL   the operator's voltages instead of the loop's until AUTO; begins with the present voltages
moving -> STOPPING    stop requested, or an interlock that stops: both pumps ramp down, then are disabled
moving, STOPPING -> TRIPPED   an interlock that trips, or a failure: disabled at 0 V in the same step, latched, first
                      cause kept
TRIPPED -> DISARMED   clear requested, and no interlock is active but the pump node's own trip

The worst action wins: a trip over a stop, a stop over MANUAL and control. A bypass disables an interlock for a limited
time; when it ends, the interlock counts again in the same step. A request that the mode does not allow is refused with
an event. In every mode but RUNNING, DEGRADED, MANUAL and the ramp of STOPPING the command is "disabled, 0 V"; it is
still sent, so that the node and its echo are checked before anything moves. See docs/decisions/0011-interlocks.md.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import NamedTuple

from hil.core.interlocks import (
    BYPASSABLE,
    NO_BELIEF,
    Belief,
    Interlock,
    Reaction,
    Situation,
    first_active,
    levels_cm,
)
from hil.core.interlocks import (
    Limits as Limits,
)
from hil.core.types import Action, Command, Event, Inputs, Mode, NodeState, Pair, Request, Severity, TripCause

OFF = Command((0.0, 0.0), enable=False)
CLEAR = Command((0.0, 0.0), enable=False, clear_trip=True)
OPERATOR = "operator"
RAMP_END_V = 0.01
"""What a ramp leaves below this is off: several steps of a pump node's converter, and nothing that turns a pump."""

ALLOWED_ACTIONS = {
    Mode.DISARMED: (Action.BYPASS, Action.STOP),
    Mode.READY: (Action.BYPASS, Action.STOP),
    Mode.RUNNING: (Action.BYPASS, Action.STOP, Action.MANUAL),
    Mode.DEGRADED: (Action.BYPASS, Action.STOP, Action.MANUAL),
    Mode.MANUAL: (Action.BYPASS, Action.STOP, Action.MANUAL, Action.AUTO),
    Mode.STOPPING: (Action.BYPASS, Action.STOP),
    Mode.TRIPPED: (Action.BYPASS, Action.STOP, Action.CLEAR),
}
"""The operator requests that each mode allows; others are refused."""


class Supervision(NamedTuple):
    """State of the supervisor.

    cause : of the trip. command_V : (2,) last command. mismatch_since_ns : since when the node has not applied what it
    echoes, -1 if it does. manual_V : (2,) the operator's voltages. bypasses : (interlock, end in ns). stopped_by : ""
    or who requested the stop (not set at the end of the run). clears_node : the operator cleared a trip, and the pump
    node's trip may be cleared too.
    """

    mode: Mode = Mode.DISARMED
    cause: TripCause | None = None
    command_V: Pair = (0.0, 0.0)
    mismatch_since_ns: int = -1
    manual_V: Pair = (0.0, 0.0)
    bypasses: tuple[tuple[TripCause, int], ...] = ()
    stopped_by: str = ""
    clears_node: bool = False


Step = tuple[Supervision, tuple[Event, ...]]
Requests = dict[Action, Request]


def next_mode(limits: Limits, state: Supervision, inputs: Inputs, now_ns: int, belief: Belief = NO_BELIEF) -> Step:
    """The mode for this step, and its events. belief : what the control loop estimates from the inputs."""
    requested: Requests = {}
    request_events: tuple[Event, ...] = ()
    if state.bypasses or inputs.requests:
        state, requested, request_events = _sort_requests(limits, state, inputs.requests, now_ns)
    if _mismatches(limits, inputs) != (state.mismatch_since_ns >= 0):
        state = state._replace(mismatch_since_ns=now_ns if state.mismatch_since_ns < 0 else -1)
    situation = _situation(limits, state, inputs, now_ns, belief)
    if state.mode is Mode.TRIPPED:
        state, events = _step_tripped(limits, state, requested, situation)
    elif state.mode in (Mode.DISARMED, Mode.READY):
        state, events = _step_disarmed(limits, state, requested, situation, belief)
    else:
        state, events = _step_moving(limits, state, requested, situation, belief)
    return state, request_events + events


def not_ready(limits: Limits, inputs: Inputs) -> str:
    """Why the rig can't be armed; "" when it can."""
    return _unready(limits, _situation(limits, Supervision(), inputs, 0, NO_BELIEF), ())


def trip(state: Supervision, cause: TripCause, text: str) -> Step:
    """Latch TRIPPED; the first cause is kept. For a pump that is stuck on, an event asks to cut its supply."""
    if state.mode is Mode.TRIPPED:
        return state, ()
    events: tuple[Event, ...] = (Event(Severity.ERROR, "trip", f"tripped: {text}", {"cause": cause.value}),)
    if cause is TripCause.PUMP_STUCK_ON:
        events += (Event(Severity.ERROR, "relay_cut", "cut the pumps' supply: 0 V does not stop them"),)
    return state._replace(mode=Mode.TRIPPED, cause=cause, command_V=(0.0, 0.0), clears_node=False), events


def safe_command(limits: Limits, state: Supervision, wanted_V: Pair, period_s: float) -> tuple[Supervision, Command]:
    """The command for this step: within range and rate limit, or off.

    wanted_V : (2,) of the law; must be finite while the mode is controlling, otherwise ValueError (the caller trips).
    """
    mode = state.mode
    if mode is Mode.STOPPING:
        step_V = limits.stop_ramp_V_s * period_s
        voltage = (max(state.command_V[0] - step_V, 0.0), max(state.command_V[1] - step_V, 0.0))
        if max(voltage) < RAMP_END_V:
            return _with_command(state, (0.0, 0.0)), OFF
        return _with_command(state, voltage), Command(voltage, enable=True)
    if not mode.moves_pumps:
        return _with_command(state, (0.0, 0.0)), OFF
    wanted1, wanted2 = state.manual_V if mode is Mode.MANUAL else wanted_V
    if not (isfinite(wanted1) and isfinite(wanted2)):
        raise ValueError(f"the control law asked for {wanted_V} V")
    low, high = limits.range_V
    step_V = limits.rate_V_s * period_s
    last1, last2 = state.command_V
    voltage = (
        min(max(wanted1, last1 - step_V, low), last1 + step_V, high),
        min(max(wanted2, last2 - step_V, low), last2 + step_V, high),
    )
    return _with_command(state, voltage), Command(voltage, enable=True)


def is_at_rest(inputs: Inputs) -> bool:
    """Whether the pump node reports both outputs at 0 V and is not in state RUN."""
    return inputs.pumps.applied_V == (0.0, 0.0) and inputs.pumps.state is not NodeState.RUN


def _sort_requests(
    limits: Limits, state: Supervision, requests: tuple[Request, ...], now_ns: int
) -> tuple[Supervision, Requests, tuple[Event, ...]]:
    """Update the bypasses; return the other requests that this mode allows, the last one of each kind."""
    events: list[Event] = []
    bypasses = {cause: until_ns for cause, until_ns in state.bypasses if until_ns > now_ns}
    for cause, _ in state.bypasses:
        if cause not in bypasses:
            events.append(Event(Severity.WARNING, "bypass_end", f"{cause} counts again", {"interlock": cause.value}))
    requested: Requests = {}
    for request in requests:
        reason = _refusal_reason(limits, state.mode, request)
        if reason:
            events.append(_refusal(request, reason, reason))
        elif request.action is Action.BYPASS and request.interlock is not None:
            for_s = min(request.for_s, limits.bypass_max_s)
            bypasses[request.interlock] = now_ns + round(for_s * 1e9)
            data: dict[str, object] = {"interlock": request.interlock.value, "for_s": for_s}
            events.append(Event(Severity.WARNING, "bypass", f"{request.interlock} bypassed for {for_s:g} s", data))
        else:
            requested[request.action] = request
    return state._replace(bypasses=tuple(bypasses.items())), requested, tuple(events)


def _refusal_reason(limits: Limits, mode: Mode, request: Request) -> str:
    """Why a request is refused; "" when it is not."""
    if request.action not in ALLOWED_ACTIONS[mode]:
        return f"not while {mode.name}"
    if request.action is Action.BYPASS:
        if request.interlock not in BYPASSABLE:
            return f"{request.interlock} can't be bypassed"
        if not 0.0 < request.for_s < inf:
            return f"for_s must be positive and finite, not {request.for_s:g} s"
    low, high = limits.range_V
    if request.voltage_V is not None and not all(low <= voltage <= high for voltage in request.voltage_V):
        return f"{request.voltage_V} V is outside {low:g}..{high:g} V"
    return ""


def _step_tripped(limits: Limits, state: Supervision, requested: Requests, situation: Situation) -> Step:
    """Latched until cleared while no interlock is active. The pump node's own trip is cleared by the clear command."""
    if Action.STOP in requested:
        state = state._replace(stopped_by=OPERATOR)
    if Action.CLEAR not in requested:
        return state, ()
    active = first_active(limits, situation, (*_bypassed(state), TripCause.NODE_TRIPPED))
    if active is not None:
        return state, (_refusal(requested[Action.CLEAR], active.cause.value, active.describe(situation)),)
    return _enter_mode(state._replace(cause=None, clears_node=True), Mode.DISARMED)


def _step_disarmed(
    limits: Limits, state: Supervision, requested: Requests, situation: Situation, belief: Belief
) -> Step:
    """DISARMED or READY: one mode on if every condition holds, otherwise DISARMED. After a stop it stays disarmed."""
    if Action.STOP in requested:
        state = state._replace(stopped_by=OPERATOR)
    is_stop_requested = situation.inputs.stop_requested or bool(state.stopped_by)
    if is_stop_requested or _unready(limits, situation, _bypassed(state)):
        return _enter_mode(state, Mode.DISARMED)
    if state.mode is Mode.DISARMED:
        return _enter_mode(state, Mode.READY)
    return _enter_mode(state._replace(clears_node=False), _automatic(belief))


def _step_moving(limits: Limits, state: Supervision, requested: Requests, situation: Situation, belief: Belief) -> Step:
    """RUNNING, DEGRADED, MANUAL or STOPPING: the worst requested action wins."""
    active = first_active(limits, situation, _bypassed(state))
    if active is not None and active.reaction is Reaction.TRIP:
        return trip(state, active.cause, active.describe(situation))
    if state.mode is Mode.STOPPING:
        return state, ()
    if active is not None:
        return _stop_for(state, active, situation)
    if Action.STOP in requested:
        return _enter_mode(state._replace(stopped_by=OPERATOR), Mode.STOPPING)
    if situation.inputs.stop_requested:
        return _enter_mode(state, Mode.STOPPING)
    if Action.MANUAL in requested:
        asked_V = requested[Action.MANUAL].voltage_V
        return _enter_mode(state._replace(manual_V=state.command_V if asked_V is None else asked_V), Mode.MANUAL)
    if state.mode is Mode.MANUAL and Action.AUTO not in requested:
        return state, ()
    return _enter_mode(state, _automatic(belief))


def _refusal(request: Request, reason: str, text: str) -> Event:
    data: dict[str, object] = {"action": request.action.value, "reason": reason}
    if request.number:
        data["number"] = request.number
    return Event(Severity.WARNING, "refused", f"{request.action} refused: {text}", data)


def _stop_for(state: Supervision, active: Interlock, situation: Situation) -> Step:
    """Begin the orderly stop that an interlock requires."""
    event = Event(Severity.ERROR, "stop", f"stopping: {active.describe(situation)}", {"cause": active.cause.value})
    state, events = _enter_mode(state._replace(stopped_by=active.cause.value), Mode.STOPPING)
    return state, (event, *events)


def _unready(limits: Limits, situation: Situation, bypassed: tuple[TripCause, ...]) -> str:
    """An active interlock, a reading that is not valid, or a pump node that is not ready, as text; "" if none."""
    active = first_active(limits, situation, bypassed)
    if active is not None:
        return active.describe(situation)
    inputs, diagnosis = situation.inputs, situation.diagnosis
    invalid = [t and not v for t, v in zip(diagnosis.trusted, inputs.measurement.valid, strict=True)]
    if any(invalid):
        return "a level is out of range or its sensor has failed"
    if inputs.pumps.state is not NodeState.READY:
        return f"the pump node is in state {inputs.pumps.state.name.lower()}, not ready"
    return ""


def _automatic(belief: Belief) -> Mode:
    return Mode.DEGRADED if belief.accommodates and belief.diagnosis.has_fault else Mode.RUNNING


def _mismatches(limits: Limits, inputs: Inputs) -> bool:
    """Whether the applied voltages differ from the echoed command by more than the converters explain."""
    short1, short2 = inputs.pumps.shortfall_V
    return abs(short1) > limits.echo_tolerance_V or abs(short2) > limits.echo_tolerance_V


def _situation(limits: Limits, state: Supervision, inputs: Inputs, now_ns: int, belief: Belief) -> Situation:
    since_ns = state.mismatch_since_ns
    pumps, (b1, b2) = limits.pumps, belief.pump_V
    (c1, c2), (a1, a2) = pumps.drive(state.command_V), pumps.drive(inputs.pumps.applied_V)
    theta1, theta2 = belief.diagnosis.effectiveness
    return Situation(
        inputs=inputs,
        diagnosis=belief.diagnosis,
        level_cm=levels_cm(limits, inputs, belief),
        pump_V=(max(theta1, 1.0) * max(c1, a1, b1), max(theta2, 1.0) * max(c2, a2, b2)),
        mismatch_s=(now_ns - since_ns) * 1e-9 if since_ns >= 0 else 0.0,
        open_share=belief.open_share,
        live_cm=belief.live_cm,
        law_problem=belief.law_problem,
        start_problem=belief.start_problem,
        possible_cm=belief.possible_cm,
        is_dry=belief.is_dry,
        unattended=belief.unattended,
    )


def _bypassed(state: Supervision) -> tuple[TripCause, ...]:
    return tuple(cause for cause, _ in state.bypasses) if state.bypasses else ()


def _with_command(state: Supervision, voltage: Pair) -> Supervision:
    return state if voltage == state.command_V else state._replace(command_V=voltage)


def _enter_mode(state: Supervision, mode: Mode) -> Step:
    if mode is state.mode:
        return state, ()
    event = Event(Severity.INFO, "mode", f"{state.mode.name} -> {mode.name}", {"mode": mode.name})
    return state._replace(mode=mode), (event,)
