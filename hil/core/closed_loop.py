"""The control loop without the supervisor: estimate, diagnose, and ask the control law.

The decisions behind time 0 are docs/decisions/0004-time-zero.md and 0026-start-phase.md.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any

from hil.core import estimator, start_phase
from hil.core.active_isolation import IDLE, ProbeState
from hil.core.alarm_units import in_bench_units
from hil.core.control_law import Authority, ControlLaw, LawInputs, LawRequest
from hil.core.estimator import Estimate
from hil.core.feedback_levels import feedback_levels_cm, trusted_readings
from hil.core.following import Followed, follow
from hil.core.law_check import checked
from hil.core.law_copies import inputs_of_law
from hil.core.loop_events import events_of_step
from hil.core.loop_state import LastCommand, LoopConfig, LoopState
from hil.core.pumps import PumpPath, UnderWay
from hil.core.reference_path import TIME_TOLERANCE_S, RunReferences
from hil.core.sensors import levels_shown
from hil.core.types import Diagnosis, Event, Inputs, Mode, Pair
from hil.core.worst_target import worst_target

MAX_PREDICTED_PERIODS = 5.0
"""After a stall the estimate is predicted over at most this many control periods."""


def begin(config: LoopConfig, inputs: Inputs, now_ns: int) -> LoopState:
    """State at the first step in control, which begins the start phase if the levels found need one."""
    model, reference = config.level_filter.model, config.references[0][1]
    level_cm = levels_shown(inputs.measurement.level_V, model.level_gain_V_cm)
    start = start_phase.plan(config.start, model, level_cm, reference, config.period_s)
    references = RunReferences(config.references, start, config.moves)
    drive_V = config.pumps.drive(inputs.pumps.applied_V)
    estimate = estimator.start(config.level_filter, inputs.measurement, drive_V)
    last = LastCommand(given_V=drive_V)
    t_s = 0.0 if start is None else -start.length_s
    known = LawInputs(
        t_s=t_s,
        period_s=0.0,
        level_cm=level_cm,
        estimate=estimate,
        diagnosis=Diagnosis(),
        followed=Followed(),
        reference_V=reference,
        requested_V=reference,
        references=references,
        wanted_V=drive_V,
        given_V=drive_V,
        excess_V=last.excess_V,
        authority=last.authority,
    )
    return LoopState(
        started_ns=now_ns + (0 if start is None else start.length_ns),
        stepped_ns=now_ns,
        reference_V=reference,
        start=start,
        request=LawRequest(drive_V, reference),
        law_memory=config.law.start(inputs_of_law(known, references)),
        inputs=known,
        last=last,
        estimate=estimate,
        memory=config.detector.start(),
        diagnosis=Diagnosis(),
        iae_Vs=(0.0, 0.0),
        drive_V=(0.0, 0.0),
        raw_V=(0.0, 0.0),
        under_way=UnderWay() if config.pumps.is_direct else UnderWay(((now_ns - 1, now_ns, drive_V),)),
    )


def step(
    config: LoopConfig, state: LoopState, inputs: Inputs, now_ns: int, probe: ProbeState = IDLE
) -> tuple[LoopState, tuple[Event, ...]]:
    """One step up to the voltages that the law asks for (`raw_V`), the offset of a probe included."""
    t_s = (now_ns - state.started_ns) * 1e-9
    period_s = (now_ns - state.stepped_ns) * 1e-9
    arrived_V, under_way = _arrived(config, state, inputs, now_ns)
    estimate, memory, diagnosis = _observe(config, state, inputs, t_s, period_s, arrived_V)
    followed = follow(state.followed, diagnosis, t_s) if config.reconfigure else state.followed
    last, references = state.last, RunReferences(config.references, state.start, config.moves)
    requested = references.requested(t_s)
    reference_V = requested if state.start is None else state.start.toward(t_s, requested)
    asked_V, why = _asked(config, requested, diagnosis, t_s)
    known = LawInputs(
        t_s=t_s,
        period_s=period_s,
        level_cm=feedback_levels_cm(config.level_filter.model, inputs.measurement, diagnosis, estimate, probe),
        estimate=estimate,
        diagnosis=diagnosis,
        followed=followed,
        reference_V=asked_V if why else reference_V,
        requested_V=asked_V,
        references=references,
        wanted_V=state.request.drive_V,
        given_V=last.given_V,
        excess_V=last.excess_V,
        authority=last.authority,
    )
    told = known if config.is_own_law else inputs_of_law(known, references)
    law_memory, request = _ask_law(config.law, state.law_memory, told, why)
    (v1, v2), (o1, o2) = request.drive_V, probe.offset_V
    drive = (v1 + o1, v2 + o2)
    new = LoopState(
        started_ns=state.started_ns,
        stepped_ns=now_ns,
        reference_V=reference_V,
        start=state.start,
        request=request,
        law_memory=law_memory,
        inputs=known,
        last=last,
        estimate=estimate,
        memory=memory,
        diagnosis=diagnosis,
        iae_Vs=_iae(state, estimate, period_s) if t_s > TIME_TOLERANCE_S else state.iae_Vs,
        drive_V=drive,
        raw_V=config.pumps.voltage(drive),
        under_way=under_way,
        followed=followed,
        unstable_since_s=min(state.unstable_since_s, t_s) if request.problem else inf,
    )
    return new, events_of_step(references, state, new)


def _asked(config: LoopConfig, requested_V: Pair, diagnosis: Diagnosis, t_s: float) -> tuple[Pair, str]:
    """The outputs that the law is asked for, and why these are not what is requested; "" if they are."""
    if diagnosis.possible and config.reconfigure and t_s > config.period_s:  # not where a start phase is judged
        return worst_target(config.level_filter.model, config.pumps, requested_V, diagnosis.possible)
    return requested_V, ""


def _ask_law(law: ControlLaw, law_memory: Any, told: LawInputs, why: str) -> tuple[Any, LawRequest]:
    """One step of the law. why : the reason of its request, where it gives none of its own."""
    law_memory, answer = law.step(law_memory, told)
    request = checked(answer)
    return law_memory, replace(request, reason=why) if why and not request.reason else request


def conclude(config: LoopConfig, state: LoopState, inputs: Inputs, command_V: Pair, mode: Mode) -> LoopState:
    """The state with what the supervisor made of this step's drives, for the law's next step.

    After a trip, in DISARMED, the law starts again.
    """
    given = config.pumps.drive(command_V)
    if mode.is_controlling:
        excess = _excess(config.pumps, state.drive_V, inputs, given)
        (d1, d2), (w1, w2), (g1, g2) = state.drive_V, state.request.drive_V, given
        given = (g1 - (d1 - w1), g2 - (d2 - w2)) if d1 != w1 or d2 != w2 else given  # less the probe
        return state._replace(last=LastCommand(given, excess, Authority.LAW))
    last = LastCommand(given, authority=Authority.OPERATOR if mode is Mode.MANUAL else Authority.NOBODY)
    if mode not in (Mode.DISARMED, Mode.READY):
        return state._replace(last=last)
    references = RunReferences(config.references, state.start, config.moves)
    known = replace(state.inputs, wanted_V=given, given_V=given, excess_V=last.excess_V, authority=last.authority)
    return state._replace(last=last, law_memory=config.law.start(inputs_of_law(known, references)))


def _excess(pumps: PumpPath, drive_V: Pair, inputs: Inputs, given_V: Pair) -> Pair:
    """(2,) drives that were requested minus those that were given."""
    short1, short2 = inputs.pumps.shortfall_V
    (d1, d2), (given1, given2) = drive_V, given_V
    if not pumps.is_straight:
        applied1, applied2 = inputs.pumps.applied_V
        echoed_V, applied_V = pumps.drive((applied1 + short1, applied2 + short2)), pumps.drive((applied1, applied2))
        short1, short2 = echoed_V[0] - applied_V[0], echoed_V[1] - applied_V[1]
    return d1 - given1 + short1, d2 - given2 + short2


def _arrived(config: LoopConfig, state: LoopState, inputs: Inputs, now_ns: int) -> tuple[Pair, UnderWay]:
    """(2,) the drives that arrived at the tanks since the last step, and those that are still under way."""
    pumps, drive_V = config.pumps, config.pumps.drive(inputs.pumps.applied_V)
    if pumps.is_direct or now_ns <= state.stepped_ns:
        return drive_V, state.under_way
    under_way = state.under_way.with_drive(pumps, state.stepped_ns, now_ns, drive_V)
    return under_way.arrived(pumps, state.stepped_ns, now_ns), under_way


def _observe(
    config: LoopConfig, state: LoopState, inputs: Inputs, t_s: float, period_s: float, arrived_V: Pair
) -> tuple[Estimate, Any, Diagnosis]:
    """Estimate and diagnosis; the levels of a detector that estimates them itself replace those of the level filter.

    arrived_V : (2,) drives since the last step.
    """
    estimate = state.estimate
    if period_s > 0.0:
        estimate = estimator.step(
            config.level_filter,
            estimate,
            arrived_V,
            state.diagnosis.effectiveness,
            trusted_readings(inputs.measurement, state.diagnosis.trusted),
            min(period_s, MAX_PREDICTED_PERIODS * config.period_s),
        )
    memory, diagnosis = config.detector.step(state.memory, t_s, inputs.measurement, estimate, arrived_V)
    alarms = in_bench_units(diagnosis.new_alarms, config.sensors, config.pumps)
    if alarms is not diagnosis.new_alarms:
        diagnosis = replace(diagnosis, new_alarms=alarms)
    if diagnosis.level_V is not None:
        estimate = Estimate(
            level_cm=levels_shown(diagnosis.level_V, config.level_filter.model.level_gain_V_cm),
            level_V=diagnosis.level_V,
            pump_V=estimate.pump_V,
            innovation_V=estimate.innovation_V,
        )
    return estimate, memory, diagnosis


def _iae(state: LoopState, estimate: Estimate, period_s: float) -> Pair:
    """Running integral of |r - y| in V s, y from the estimate."""
    (r1, r2), y, (i1, i2) = state.reference_V, estimate.level_V, state.iae_Vs
    return i1 + abs(r1 - y[0]) * period_s, i2 + abs(r2 - y[1]) * period_s
