"""One control step: the loop computes a command, the supervisor decides what is sent, the step is recorded.

`step(config, state, inputs, now_ns) -> (state, output)`. This module does not know where inputs come from or where
commands go. The loop runs first, so that the supervisor decides with this step's diagnosis; see
docs/decisions/0011-interlocks.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, nan
from typing import NamedTuple

from hil.core import active_isolation, closed_loop, live_operation, start_goal, start_phase, supervisor
from hil.core.active_isolation import IDLE, NO_PROBE, Occasion, ProbeConfig, ProbeState
from hil.core.alarm_list import AlarmList
from hil.core.attendance import Attendance, is_asked_for, unattended, watch_attendance
from hil.core.control_law import FeedbackRecord
from hil.core.interlocks import Belief, Limits
from hil.core.live_operation import UNTOUCHED, LiveState, Operation
from hil.core.live_request import LiveAnswer, LiveRequest
from hil.core.loop_state import LoopConfig, LoopState
from hil.core.monitors import Monitors, step_monitors
from hil.core.reference_path import TIME_TOLERANCE_S
from hil.core.supervisor import Supervision
from hil.core.types import (
    Action,
    Command,
    Event,
    Inputs,
    Mode,
    Pair,
    Request,
    TickRecord,
    TripCause,
)

NO_FEEDBACK = FeedbackRecord((nan, nan), (nan, nan), (nan,) * 12)
"""In the record of a law that is no state feedback."""


@dataclass(frozen=True)
class ControllerConfig:
    """The loop, its limits, the duration of the run (inf: no end), and the scheduled operator requests.

    requests : (at_s, request), ascending in run time. probe : see `active_isolation`. waits_for_clearing :
    a tripped run waits for an operator, who clears the trip or stops the run, as long as one can be heard.
    """

    loop: LoopConfig
    limits: Limits
    duration_s: float
    requests: tuple[tuple[float, Request], ...] = ()
    probe: ProbeConfig = NO_PROBE
    waits_for_clearing: bool = False


class ControllerState(NamedTuple):
    """State of the supervisor; of the loop, the monitors and the probe, from the first step in control on.

    alarms : what an operator has to look at. attendance : whether somebody is there. operation : what an operator has
    changed while the run goes on.
    """

    supervision: Supervision = Supervision()
    loop: LoopState | None = None
    monitors: Monitors = Monitors()
    probe: ProbeState = IDLE
    alarms: AlarmList = AlarmList()
    attendance: Attendance = Attendance()
    operation: Operation = UNTOUCHED


class Output(NamedTuple):
    """The command to send, the events of this step, and the record once the run's time has begun.

    answers : to the requests that an operator has sent while the run goes on.
    """

    command: Command
    events: tuple[Event, ...]
    record: TickRecord | None
    answers: tuple[LiveAnswer, ...] = ()


def step(
    config: ControllerConfig,
    state: ControllerState,
    inputs: Inputs,
    now_ns: int,
    asked: tuple[LiveRequest, ...] = (),
) -> tuple[ControllerState, Output]:
    """One step at now_ns (monotonic). The command is always safe. The caller answers an exception with `fail`.

    asked : by an operator since the last step, while the run goes on.
    """
    if not asked:
        return _step(_with_operation(config, state.operation), state, inputs, now_ns)
    before = LiveState(state.operation, state.alarms, state.loop, state.supervision)
    taken = live_operation.take(config.loop, config.limits, before, asked, now_ns)
    state = state._replace(operation=taken.operation, alarms=taken.alarms)
    inputs = replace(inputs, requests=inputs.requests + taken.requests, is_attended=True)
    new, output = _step(_with_operation(config, taken.operation), state, inputs, now_ns)
    replies, events = live_operation.settle(taken, new.supervision, output.events)
    events += tuple(event for _, event in replies)
    record = None if output.record is None else output.record._replace(events=events)
    return new, Output(output.command, events, record, tuple(answer for answer, _ in replies))


def _with_operation(config: ControllerConfig, operation: Operation) -> ControllerConfig:
    """The configuration with the references as the operator has changed them."""
    return config if operation.loop is None else replace(config, loop=operation.loop)


def _step(
    config: ControllerConfig, state: ControllerState, inputs: Inputs, now_ns: int
) -> tuple[ControllerState, Output]:
    loop, monitors, probe = state.loop, state.monitors, state.probe
    attendance = state.attendance
    attendance_events: tuple[Event, ...] = ()
    probe_events: tuple[Event, ...] = ()
    if loop is None:
        supervision, events = supervisor.next_mode(config.limits, state.supervision, inputs, now_ns)
        if not supervision.mode.is_controlling:
            waiting = ControllerState(supervision, alarms=_listed(state, inputs, events), operation=state.operation)
            return waiting, Output(command=supervisor.OFF, events=events, record=None)
        loop = closed_loop.begin(config.loop, inputs, now_ns)
        loop, loop_events = closed_loop.step(config.loop, loop, inputs, now_ns)
    else:
        inputs = _with_schedule(config, loop, state.operation, inputs, now_ns)
        period_s = (now_ns - loop.stepped_ns) * 1e-9
        loop, loop_events = closed_loop.step(config.loop, loop, inputs, now_ns, probe)
        monitors, belief = step_monitors(
            config.limits, monitors, loop, inputs.measurement, now_ns, accommodates=config.loop.reconfigure
        )
        if is_asked_for(config.limits):
            attendance, attendance_events = watch_attendance(attendance, config.limits, inputs.is_attended, loop.t_s)
            belief = belief._replace(unattended=unattended(attendance, state.alarms, config.limits, loop.t_s))
        if loop.start is not None and state.supervision.mode.is_controlling:
            is_end = state.loop is not None and state.loop.is_starting and not loop.is_starting
            problem = _start_problem(config, loop, monitors, state.supervision.command_V, is_end=is_end)
            if problem:
                belief = belief._replace(start_problem=problem)
            if problem or is_end:
                loop_events += (start_phase.ends(problem),)
        supervision, events = supervisor.next_mode(config.limits, state.supervision, inputs, now_ns, belief)
        if not loop.is_starting and not active_isolation.has_nothing_to_do(config.probe, probe, loop.diagnosis):
            probe, probe_events = _probe(
                config, probe, loop, supervision.mode, inputs, belief, period_s, state.operation
            )
    events += loop_events + probe_events + attendance_events
    supervision, command = supervisor.safe_command(config.limits, supervision, loop.raw_V, config.loop.period_s)
    if loop.is_starting or supervision.stopped_by == TripCause.START_FAILED:
        command = replace(command, start_phase=True)
    record = _record(config, loop, supervision.mode, inputs, command.voltage_V, events, state.probe.offset_V)
    loop = closed_loop.conclude(config.loop, loop, inputs, command.voltage_V, supervision.mode)
    alarms = _listed(state, inputs, events, loop.t_s)
    new = ControllerState(supervision, loop, monitors, probe, alarms, attendance, state.operation)
    return new, Output(command=command, events=events, record=record)


def _listed(state: ControllerState, inputs: Inputs, events: tuple[Event, ...], t_s: float = 0.0) -> AlarmList:
    """The alarm list with the events of the step, and those that came from elsewhere since the last one."""
    return state.alarms.take_all((*inputs.noted, *events), t_s) if events or inputs.noted else state.alarms


def fail(state: ControllerState, cause: TripCause, text: str) -> tuple[ControllerState, Output]:
    """State and output for a step that raised an exception: trip, 0 V in the same step."""
    supervision, events = supervisor.trip(state.supervision, cause, text)
    t_s = 0.0 if state.loop is None else state.loop.t_s
    failed = state._replace(supervision=supervision, alarms=state.alarms.take_all(events, t_s))
    return failed, Output(command=supervisor.OFF, events=events, record=None)


def will_be_cleared(config: ControllerConfig, state: ControllerState, can_be_asked: bool) -> bool:
    """Whether a request to clear a trip is still scheduled within the run's duration, or is left to an operator.

    can_be_asked : whether an operator's requests can come; a run that nobody can clear any more is over.
    """
    if state.loop is None or state.supervision.stopped_by:
        return False
    if config.waits_for_clearing and can_be_asked:
        return True
    t_s = state.operation.scenario_s(_run_time_s(state.loop, state.loop.stepped_ns)) + TIME_TOLERANCE_S
    return any(t_s < at_s < config.duration_s and request.action is Action.CLEAR for at_s, request in config.requests)


def is_over(config: ControllerConfig, state: ControllerState) -> bool:
    """Whether the run has reached its duration."""
    loop = state.loop
    if loop is None:
        return False
    return state.operation.scenario_s(_run_time_s(loop, loop.stepped_ns)) >= config.duration_s - TIME_TOLERANCE_S


def _start_problem(
    config: ControllerConfig, loop: LoopState, monitors: Monitors, command_V: Pair, *, is_end: bool
) -> str:
    """Why the start phase has failed; "" if it has not. is_end : it ends with this step."""
    if loop.start is None or loop.t_s > start_phase.DOUBTED_UNTIL_S:
        return ""
    limits, trusted = config.limits, loop.diagnosis.trusted
    if loop.is_starting and not (trusted[0] and trusted[1]):
        return start_phase.lost_sensor(trusted)
    balanced = monitors.filling.balanced(limits.model)
    hidden = start_phase.hidden_level(monitors.doubts, loop.t_s, balanced, is_over=is_end)
    hidden = hidden or monitors.filling.problem(limits.model, loop.estimate.level_cm, trusted, limits.level_max_cm)
    if hidden or not is_end:
        return hidden
    goal_cm = start_goal.goal_cm(limits.model, config.loop, loop)
    return start_phase.problem(loop.start, config.loop.start, loop.level_cm, goal_cm, command_V)


def _probe(
    config: ControllerConfig,
    probe: ProbeState,
    loop: LoopState,
    mode: Mode,
    inputs: Inputs,
    belief: Belief,
    period_s: float,
    operation: Operation,
) -> tuple[ProbeState, tuple[Event, ...]]:
    """One step of the probe, with what it needs to know."""
    t_s = _run_time_s(loop, loop.stepped_ns)
    past = [at_s for at_s, _ in config.loop.references[1:] if at_s <= t_s + TIME_TOLERANCE_S]
    coming = [at_s for at_s, _ in config.loop.references if at_s > t_s + TIME_TOLERANCE_S]
    is_moving = loop.is_starting or loop.inputs.references.rate(t_s) != (0.0, 0.0)
    at = Occasion(
        mode=mode,
        inputs=inputs,
        belief=belief,
        raw_V=loop.raw_V,
        reference_s=t_s if is_moving else max(past, default=-inf),
        next_reference_s=min(coming, default=inf),
        end_s=operation.run_s(config.duration_s),
    )
    return active_isolation.step(config.probe, config.limits, probe, at, t_s, period_s)


def _run_time_s(loop: LoopState, now_ns: int) -> float:
    return (now_ns - loop.started_ns) * 1e-9


def _with_schedule(
    config: ControllerConfig, loop: LoopState, operation: Operation, inputs: Inputs, now_ns: int
) -> Inputs:
    """The inputs, with a stop at the end of the run and the scheduled requests due since the last step.

    Both by the scenario's time, which stands while the operator holds it.
    """
    t_s = operation.scenario_s(_run_time_s(loop, now_ns))
    if t_s >= config.duration_s - TIME_TOLERANCE_S:
        inputs = replace(inputs, stop_requested=True)
    if config.requests:
        last_s = operation.scenario_s(_run_time_s(loop, loop.stepped_ns))
        due = tuple(r for at_s, r in config.requests if last_s < at_s - TIME_TOLERANCE_S <= t_s)
        if due:
            inputs = replace(inputs, requests=inputs.requests + due)
    return inputs


def _record(
    config: ControllerConfig,
    loop: LoopState,
    mode: Mode,
    inputs: Inputs,
    command_V: Pair,
    events: tuple[Event, ...],
    probe_V: Pair,
) -> TickRecord:
    shown = loop.request.feedback or NO_FEEDBACK
    return TickRecord(
        t_s=loop.t_s,
        mode=mode,
        measured_V=inputs.measurement.level_V,
        estimated_V=loop.estimate.level_V,
        reference_V=loop.reference_V,
        target_V=loop.request.target_V,
        operating_V=config.loop.pumps.voltage(shown.operating_V),
        raw_V=loop.raw_V,
        command_V=command_V,
        applied_V=inputs.pumps.applied_V,
        effectiveness=loop.diagnosis.effectiveness,
        integral_Vs=shown.integral_Vs,
        gain=shown.gain,
        iae_Vs=loop.iae_Vs,
        levels_age_s=inputs.measurement.age_s,
        status_age_s=inputs.pumps.age_s,
        lateness_s=inputs.timing.lateness_s,
        skipped=inputs.timing.skipped,
        accepted=inputs.bus.accepted,
        rejected=inputs.bus.rejected,
        events=events,
        monotonic_ns=loop.stepped_ns,
        level_walk_cm_sqrt_s=loop.diagnosis.level_walk_cm_sqrt_s,
        level_std_V=loop.diagnosis.level_std_V,
        test_ratio=loop.diagnosis.test_ratio,
        test_limit=loop.diagnosis.test_limit,
        probe_V=probe_V,
        shown=loop.request.shown,
    )
