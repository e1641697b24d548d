"""Modes and interlocks: what may be sent to the pumps, whatever the control law asks for.

DISARMED -> READY     every condition for arming holds (`not_ready` names the first that does not)
READY -> RUNNING      on the next step, if they still hold; otherwise back to DISARMED
RUNNING <-> DEGRADED  DEGRADED while a pump is known to have lost gain
controlling -> STOPPING   asked to stop: both pumps ramp down, then are disabled
any but DISARMED -> TRIPPED   an interlock (`trip_cause`): disabled at 0 V in the same step, latched, first cause kept

A trip wins over a stop, a stop over control. In every mode but RUNNING, DEGRADED and the ramp of STOPPING the command
is "disabled, 0 V"; it is sent all the same, so that the node and its echo are watched before anything moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

from hil.core.types import Command, Event, Inputs, Mode, NodeState, Pair, Severity, TripCause

OFF = Command((0.0, 0.0), enable=False)
CLEAR = Command((0.0, 0.0), enable=False, clear_trip=True)


@dataclass(frozen=True, slots=True)
class Limits:
    """Configuration of the supervisor, from the rig file's [safety], [pumps] and [sensors]."""

    range_V: Pair
    rate_V_s: float
    stop_ramp_V_s: float
    level_max_cm: float
    level_gain_V_cm: float
    levels_age_max_s: float
    status_age_max_s: float
    heartbeat_age_max_s: float
    echo_age_max_s: float


@dataclass(frozen=True, slots=True)
class Supervision:
    """State: the mode, the first cause of a trip, the last voltages that were let pass."""

    mode: Mode = Mode.DISARMED
    cause: TripCause | None = None
    command_V: Pair = (0.0, 0.0)


Interlock = tuple[TripCause, Callable[[Limits, Inputs], bool], str]


INTERLOCKS: tuple[Interlock, ...] = (
    (TripCause.BUS_FAILED, lambda _, i: not i.bus.is_up, "the CAN bus is gone"),
    (TripCause.FOREIGN_COMMAND, lambda _, i: i.bus.foreign_commands > 0, "somebody else sends pump commands"),
    (TripCause.NODE_TRIPPED, lambda _, i: i.pumps.state is NodeState.TRIPPED, "the pump node has tripped"),
    (TripCause.NODE_REBOOTED, lambda _, i: i.nodes.rebooted, "a node has booted anew"),
    (TripCause.WRONG_CONTRACT, lambda _, i: not i.nodes.contract_matches, "a node was built for another DBC"),
    (TripCause.STALE_LEVELS, lambda m, i: i.measurement.age_s > m.levels_age_max_s, "levels are too old"),
    (
        TripCause.STALE_STATUS,
        lambda m, i: i.pumps.age_s > m.status_age_max_s,
        "the pump node's status is too old",
    ),
    (
        TripCause.NODE_LOST,
        lambda m, i: i.nodes.age_s > m.heartbeat_age_max_s,
        "a node's heartbeat is too old",
    ),
    (TripCause.ECHO_MISSING, lambda m, i: i.pumps.unechoed_s > m.echo_age_max_s, "commands are not echoed"),
    (
        TripCause.INVALID_LEVELS,
        lambda _, i: not all(i.measurement.valid) or not all(map(isfinite, i.measurement.level_V)),
        "a level is out of range or its sensor has failed",
    ),
    (
        TripCause.HIGH_LEVEL,
        lambda m, i: max(i.measurement.level_V) > m.level_max_cm * m.level_gain_V_cm,
        "a tank is about to overflow",
    ),
)
"""In the order in which a trip names its cause when several stand."""


def standing_interlock(limits: Limits, inputs: Inputs) -> tuple[TripCause, str] | None:
    """The first interlock that stands, with its text; None when all is well."""
    for cause, stands, text in INTERLOCKS:
        if stands(limits, inputs):
            return cause, text
    return None


def not_ready(limits: Limits, inputs: Inputs) -> str:
    """Why the rig can't be armed; "" when it can. Everything that would trip, and a node that waits for commands."""
    standing = standing_interlock(limits, inputs)
    if standing is not None:
        return standing[1]
    if inputs.pumps.state is not NodeState.READY:
        return f"the pump node is in state {inputs.pumps.state.name.lower()}, not ready"
    return ""


def next_mode(
    limits: Limits, state: Supervision, inputs: Inputs, is_degraded: bool
) -> tuple[Supervision, tuple[Event, ...]]:
    """The mode for this step, with what is to be said about it."""
    mode = state.mode
    if mode is Mode.TRIPPED:
        return state, ()
    if mode in (Mode.DISARMED, Mode.READY):
        ready = not not_ready(limits, inputs) and not inputs.stop_requested
        new = (Mode.READY if mode is Mode.DISARMED else Mode.RUNNING) if ready else Mode.DISARMED
        return _moved(state, new)
    standing = standing_interlock(limits, inputs)
    if standing is not None:
        return trip(state, *standing)
    if mode is Mode.STOPPING or inputs.stop_requested:
        return _moved(state, Mode.STOPPING)
    return _moved(state, Mode.DEGRADED if is_degraded else Mode.RUNNING)


def trip(state: Supervision, cause: TripCause, text: str) -> tuple[Supervision, tuple[Event, ...]]:
    """Latch TRIPPED; the first cause stays."""
    if state.mode is Mode.TRIPPED:
        return state, ()
    event = Event(Severity.ERROR, "trip", f"tripped: {text}", {"cause": cause.value})
    return Supervision(Mode.TRIPPED, cause, (0.0, 0.0)), (event,)


def safe_command(limits: Limits, state: Supervision, wanted_V: Pair, period_s: float) -> tuple[Supervision, Command]:
    """The command for this step: within range and rate of the last one, or off.

    wanted_V must be finite where the mode is controlling (ValueError otherwise: the caller trips).
    """
    if state.mode is Mode.STOPPING:
        step_V = limits.stop_ramp_V_s * period_s
        voltage = (max(state.command_V[0] - step_V, 0.0), max(state.command_V[1] - step_V, 0.0))
        if voltage == (0.0, 0.0):
            return Supervision(state.mode, state.cause, voltage), OFF
        return Supervision(state.mode, state.cause, voltage), Command(voltage, enable=True)
    if not state.mode.is_controlling:
        return Supervision(state.mode, state.cause), OFF
    if not all(map(isfinite, wanted_V)):
        raise ValueError(f"the control law asked for {wanted_V} V")
    low, high = limits.range_V
    step_V = limits.rate_V_s * period_s
    first, second = (
        min(max(wanted, last - step_V, low), last + step_V, high)
        for wanted, last in zip(wanted_V, state.command_V, strict=True)
    )
    return Supervision(state.mode, state.cause, (first, second)), Command((first, second), enable=True)


def is_at_rest(inputs: Inputs) -> bool:
    """Whether the pump node itself says that both outputs are at 0 V and that it no longer runs."""
    return inputs.pumps.applied_V == (0.0, 0.0) and inputs.pumps.state is not NodeState.RUN


def _moved(state: Supervision, mode: Mode) -> tuple[Supervision, tuple[Event, ...]]:
    if mode is state.mode:
        return state, ()
    event = Event(Severity.INFO, "mode", f"{state.mode.name} -> {mode.name}", {"mode": mode.name})
    return Supervision(mode, state.cause, state.command_V), (event,)
