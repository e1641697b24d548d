"""One control step's share of what an operator asks for: taken or refused now, answered when the step is done.

requests -> take -> references and the scenario's clock (`hil.core.live_plan`), notes and marks: answered at once
-> requests of the supervisor -> next mode -> settle: answered by what became of them
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from hil.core import live_plan
from hil.core.alarm_list import AlarmList
from hil.core.control_law import ChecksReferences
from hil.core.interlocks import Limits
from hil.core.live_plan import LivePlan
from hil.core.live_request import (
    SUPERVISED,
    LiveAction,
    LiveAnswer,
    LiveRequest,
    MaybePair,
    RefusedError,
    accepted,
    merged,
    refused,
)
from hil.core.loop_state import LoopConfig, LoopState
from hil.core.reachable import nearest_reachable
from hil.core.reference_path import RunReferences
from hil.core.supervisor import Supervision
from hil.core.tanks import equilibrium
from hil.core.types import Action, Event, Mode, Pair, Request

MOVING = (Mode.RUNNING, Mode.DEGRADED, Mode.MANUAL)
"""Modes in which a reference can be changed."""

FAILURES = (ArithmeticError, ValueError, np.linalg.LinAlgError)

Replies = tuple[tuple[LiveAnswer, Event], ...]


@dataclass(frozen=True, slots=True)
class Operation:
    """What the operator has changed of a run: nothing at first.

    plan : references and clock. loop : the loop's configuration with these references.
    """

    plan: LivePlan | None = None
    loop: LoopConfig | None = None

    @property
    def is_held(self) -> bool:
        """Whether the scenario's clock stands."""
        return self.plan is not None and self.plan.is_held

    def scenario_s(self, t_s: float) -> float:
        """The scenario's time at run time t_s."""
        return t_s if self.plan is None else self.plan.scenario_s(t_s)

    def run_s(self, scenario_s: float) -> float:
        """Run time of a scenario's time to come; inf while the clock stands."""
        if self.plan is None:
            return scenario_s
        return inf if self.plan.is_held else scenario_s + self.plan.held_s


UNTOUCHED = Operation()


@dataclass(frozen=True, slots=True)
class LiveState:
    """What requests act on, and what decides whether they may. loop : None before the first step in control."""

    operation: Operation
    alarms: AlarmList
    loop: LoopState | None
    supervision: Supervision

    @property
    def t_s(self) -> float:
        """Run time of the last step."""
        return 0.0 if self.loop is None else self.loop.t_s


@dataclass(frozen=True, slots=True)
class Taken:
    """What came of a step's requests so far. pending : those that the supervisor decides on, `requests` for it."""

    operation: Operation
    alarms: AlarmList
    requests: tuple[Request, ...] = ()
    pending: tuple[LiveRequest, ...] = ()
    replies: Replies = ()


def take(config: LoopConfig, limits: Limits, state: LiveState, asked: Sequence[LiveRequest], now_ns: int) -> Taken:
    """Take or refuse what can be decided before the step; config : with the scenario's references."""
    requests: list[Request] = []
    pending: list[LiveRequest] = []
    replies: list[tuple[LiveAnswer, Event]] = []
    for request in asked:
        try:
            _check_phase(request, state.loop)
            if request.action in SUPERVISED:
                requests.append(_for_supervisor(request, state.supervision))
                pending.append(request)
                continue
            state, text = _taken(config, limits, state, request, now_ns)
            replies.append(accepted(request, text))
        except RefusedError as error:
            replies.append(refused(request, error.reason, str(error)))
        except Exception as error:  # noqa: BLE001 - a law of a user's own may raise anything; no request trips the rig
            replies.append(refused(request, "failed", f"{type(error).__name__}: {error}"))
    return Taken(state.operation, state.alarms, tuple(requests), tuple(pending), tuple(replies))


def settle(taken: Taken, after: Supervision, events: tuple[Event, ...]) -> tuple[Replies, tuple[Event, ...]]:
    """The answers of the step, and the supervisor's events without its refusals of these requests."""
    if not taken.pending:
        return taken.replies, events
    replies = list(taken.replies)
    for request in taken.pending:
        said = next((e for e in events if e.code == "refused" and e.data.get("number") == request.number), None)
        if said is not None:
            text = said.text.partition(": ")[2]
            replies.append(refused(request, str(said.data["reason"]), text))
        elif _is_done(request, after):
            replies.append(accepted(request, _done(request, after, events)))
        else:
            replies.append(refused(request, "overruled", f"something else has set the mode to {after.mode.name}"))
    return tuple(replies), tuple(e for e in events if "number" not in e.data)


def _check_phase(request: LiveRequest, loop: LoopState | None) -> None:
    """In a start phase the references lead to the first one of the scenario, and its clock has not begun."""
    waits = (LiveAction.REFERENCE, LiveAction.MANUAL, LiveAction.HOLD, LiveAction.RESUME)
    if loop is not None and loop.is_starting and request.action in waits:
        raise RefusedError("not_while", f"not in the start phase, which ends in {-loop.t_s:.0f} s")


def _for_supervisor(request: LiveRequest, supervision: Supervision) -> Request:
    voltage_V = None
    if request.voltage_V is not None:
        is_manual = supervision.mode is Mode.MANUAL
        voltage_V = merged(request.voltage_V, supervision.manual_V if is_manual else supervision.command_V)
    action = Action(request.action.value)
    return Request(action, voltage_V, request.interlock, request.for_s, number=request.number)


def _is_done(request: LiveRequest, after: Supervision) -> bool:
    match request.action:
        case LiveAction.MANUAL:
            return after.mode is Mode.MANUAL
        case LiveAction.AUTO:
            return after.mode.is_controlling
        case LiveAction.CLEAR:
            return after.mode is not Mode.TRIPPED
        case LiveAction.STOP:
            return bool(after.stopped_by) or after.mode is Mode.STOPPING
    return True


def _done(request: LiveRequest, after: Supervision, events: tuple[Event, ...]) -> str:
    match request.action:
        case LiveAction.MANUAL:
            return f"pumps by hand at {after.manual_V[0]:.4g}, {after.manual_V[1]:.4g} V"
        case LiveAction.AUTO:
            return "pumps back to the control law"
        case LiveAction.CLEAR:
            return "trip cleared"
        case LiveAction.STOP:
            pumps = "the pumps ramp down" if after.mode is Mode.STOPPING else "the pumps are off"
            return f"stop: {pumps} and the run ends"
    said = (e.text for e in events if e.code == "bypass" and e.data["interlock"] == str(request.interlock))
    return next(said, f"{request.interlock} bypassed")  # for as long as safety.bypass_max_s allows


def _taken(
    config: LoopConfig,
    limits: Limits,
    state: LiveState,
    request: LiveRequest,
    now_ns: int,
) -> tuple[LiveState, str]:
    """The state with the request, and what was done. Raises RefusedError."""
    match request.action:
        case LiveAction.NOTE:
            return state, f"note: {request.text}"
        case LiveAction.MARK:
            return state, f"mark {request.text}"
        case LiveAction.HERE:
            return state, "somebody is at the bench"
        case LiveAction.ACK | LiveAction.SHELVE:
            alarms, text = _with_alarms(state, request)
            return replace(state, alarms=alarms), text
    loop = state.loop
    if loop is None:
        raise RefusedError("not_while", "not before the run's time has begun")
    t_s = (now_ns - loop.started_ns) * 1e-9
    mode, plan = (
        state.supervision.mode,
        state.operation.plan or live_plan.planned(RunReferences(config.references, loop.start, config.moves)),
    )
    if request.action is LiveAction.REFERENCE:
        plan, text = _with_reference(config, limits, plan, mode, request, t_s)
    else:
        plan, text = _with_clock(plan, mode, request.action, t_s)
    operation = Operation(plan, replace(config, references=plan.schedule, moves=plan.moves))
    return replace(state, operation=operation), text


def _with_alarms(state: LiveState, request: LiveRequest) -> tuple[AlarmList, str]:
    key = request.text
    if request.action is LiveAction.ACK:
        alarms, problem = state.alarms.acknowledge(key)
        text = f"acknowledged: {key}"
    else:
        alarms, problem = state.alarms.shelve(key, request.for_s, state.t_s)
        text = f"shelved for {request.for_s:g} s: {key}" if request.for_s > 0.0 else f"not shelved any more: {key}"
    if problem:
        raise RefusedError("not_possible" if state.alarms.find(key) else "unknown_alarm", problem)
    return alarms, text


def _with_clock(plan: LivePlan, mode: Mode, action: LiveAction, t_s: float) -> tuple[LivePlan, str]:
    if mode is Mode.STOPPING:
        raise RefusedError("not_while", f"not while {mode.name}")
    if (action is LiveAction.HOLD) is plan.is_held:
        raise RefusedError("no_change", f"the scenario's clock {'stands already' if plan.is_held else 'goes'}")
    if action is LiveAction.HOLD:
        return live_plan.hold(plan, t_s), f"hold: the scenario's clock is held at {plan.scenario_s(t_s):.1f} s"
    held_s = t_s - (plan.held_at_s or 0.0)
    return live_plan.resume(plan, t_s), f"resume: the scenario's clock goes on, {held_s:.1f} s later"


def _with_reference(
    config: LoopConfig, limits: Limits, plan: LivePlan, mode: Mode, request: LiveRequest, t_s: float
) -> tuple[LivePlan, str]:
    if mode not in MOVING:
        raise RefusedError("not_while", f"not while {mode.name}")
    target = _target(request, plan.in_force(t_s).levels_V, limits.level_gain_V_cm)
    plan = live_plan.with_reference(plan, t_s, target, request.ramp_s)
    levels_V = plan.in_force(t_s).levels_V
    check_reference(config, limits, levels_V)
    how = f" within {request.ramp_s:g} s" if request.ramp_s > 0.0 else ""
    k = limits.level_gain_V_cm
    return plan, (
        f"references to {levels_V[0]:.4g}, {levels_V[1]:.4g} V ({levels_V[0] / k:.4g}, {levels_V[1] / k:.4g} cm){how}"
    )


def _target(request: LiveRequest, before_V: Pair, gain_V_cm: float) -> MaybePair:
    """(2,) in V; None keeps an output on its way."""
    if request.levels_V is not None:
        return request.levels_V
    if request.levels_cm is not None:
        first, second = request.levels_cm
        return None if first is None else gain_V_cm * first, None if second is None else gain_V_cm * second
    first, second = request.change_V or (None, None)
    return None if first is None else before_V[0] + first, None if second is None else before_V[1] + second


def check_reference(config: LoopConfig, limits: Limits, levels_V: Pair) -> None:
    """Raises RefusedError unless a healthy rig can hold these outputs (2,) in V, every level below the trip level."""
    k, highest_cm = limits.level_gain_V_cm, limits.level_max_cm
    said = f"{levels_V[0]:.4g}, {levels_V[1]:.4g} V"
    if not all(0.0 <= level <= k * highest_cm for level in levels_V):
        raise RefusedError(
            "out_of_range", f"{said} lie outside 0..{k * highest_cm:g} V (safety.level_max_cm {highest_cm:g})"
        )
    lower_cm = (levels_V[0] / k, levels_V[1] / k)
    try:
        reached = nearest_reachable(limits.model, lower_cm, config.pumps.max_drives, config.pumps)
        if reached.reason:
            nearest_V = f"{k * reached.lower_cm[0]:.4g}, {k * reached.lower_cm[1]:.4g} V"
            raise RefusedError("unreachable", f"{said} can't be held: {reached.reason}; the nearest are {nearest_V}")
        upper_cm = equilibrium(limits.model, reached.holding_V)[2:]
        for tank, level_cm in zip((3, 4), upper_cm, strict=True):
            if level_cm >= highest_cm:
                text = f"{said} need {level_cm:.1f} cm in tank {tank}, safety.level_max_cm is {highest_cm:g}"
                raise RefusedError("unreachable", text)
        if isinstance(config.law, ChecksReferences):
            config.law.check(levels_V)
    except FAILURES as error:
        raise RefusedError("unreachable", f"no control law for {said}: {error}") from None
