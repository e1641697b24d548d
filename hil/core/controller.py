"""One control step, composed: supervise, close the loop, let through what is safe, record.

`step(config, state, inputs, now_ns) -> (state, output)`. Nothing here knows where inputs come from or commands go.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from hil.core import closed_loop, supervisor
from hil.core.closed_loop import TIME_TOLERANCE_S, LoopConfig, LoopState
from hil.core.supervisor import Limits, Supervision
from hil.core.types import Command, Event, Inputs, Mode, Pair, TickRecord, TripCause


@dataclass(frozen=True)
class ControllerConfig:
    """The loop, the limits around it, and when the run stops by itself (inf: never)."""

    loop: LoopConfig
    limits: Limits
    duration_s: float


@dataclass(frozen=True, slots=True)
class ControllerState:
    """Supervision always; the loop's state from the first step in control on."""

    supervision: Supervision = field(default_factory=Supervision)
    loop: LoopState | None = None


@dataclass(frozen=True, slots=True)
class Output:
    """The command to send, the events of this step, and the record once the run's time has begun."""

    command: Command
    events: tuple[Event, ...]
    record: TickRecord | None


def step(
    config: ControllerConfig, state: ControllerState, inputs: Inputs, now_ns: int
) -> tuple[ControllerState, Output]:
    """One step at now_ns (monotonic). The command is always safe; what it raises, the caller turns into a trip."""
    loop = state.loop
    if loop is not None and (now_ns - loop.started_ns) * 1e-9 >= config.duration_s - TIME_TOLERANCE_S:
        inputs = replace(inputs, stop_requested=True)
    supervision, events = supervisor.next_mode(config.limits, state.supervision, inputs, _is_degraded(config, loop))
    if loop is None:
        if supervision.mode is not Mode.RUNNING:
            return ControllerState(supervision), Output(supervisor.OFF, events, None)
        loop = closed_loop.begin(config.loop, inputs, now_ns)
    loop, loop_events = closed_loop.step(config.loop, loop, inputs, now_ns)
    events += loop_events
    supervision, command = supervisor.safe_command(config.limits, supervision, loop.raw_V, config.loop.period_s)
    record = _record(loop, supervision.mode, inputs, command.voltage_V, events)
    if supervision.mode.is_controlling:
        loop = replace(loop, integral_Vs=closed_loop.integrate(config.loop, loop, inputs, command.voltage_V))
    return ControllerState(supervision, loop), Output(command, events, record)


def fail(state: ControllerState, cause: TripCause, text: str) -> tuple[ControllerState, Output]:
    """The way out when a step could not be completed: trip, 0 V in the same step."""
    supervision, events = supervisor.trip(state.supervision, cause, text)
    return ControllerState(supervision, state.loop), Output(supervisor.OFF, events, None)


def _is_degraded(config: ControllerConfig, loop: LoopState | None) -> bool:
    """Whether a fault is being accommodated."""
    return loop is not None and config.loop.reconfigure and loop.diagnosis.effectiveness != closed_loop.SOUND


def _record(loop: LoopState, mode: Mode, inputs: Inputs, command_V: Pair, events: tuple[Event, ...]) -> TickRecord:
    law = loop.law
    return TickRecord(
        t_s=(loop.stepped_ns - loop.started_ns) * 1e-9,
        mode=mode,
        measured_V=inputs.measurement.level_V,
        estimated_V=loop.estimate.level_V,
        reference_V=loop.reference_V,
        target_V=law.target_V,
        operating_V=law.operating_V,
        raw_V=loop.raw_V,
        command_V=command_V,
        applied_V=inputs.pumps.applied_V,
        effectiveness=loop.diagnosis.effectiveness,
        integral_Vs=loop.integral_Vs,
        gain=law.pump_gain,
        iae_Vs=loop.iae_Vs,
        levels_age_s=inputs.measurement.age_s,
        status_age_s=inputs.pumps.age_s,
        lateness_s=inputs.timing.lateness_s,
        skipped=inputs.timing.skipped,
        accepted=inputs.bus.accepted,
        rejected=inputs.bus.rejected,
        events=events,
    )
