"""The control loop without the supervisor: estimate, diagnose, reconfigure, feed back, integrate.

The decisions behind time 0 are docs/decisions/0004-time-zero.md and 0026-start-phase.md.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from math import inf
from typing import Any

from hil.core import estimator, start_phase, state_feedback
from hil.core.active_isolation import IDLE, ProbeState
from hil.core.alarm_units import in_bench_units
from hil.core.diagnosis.detector import FaultDetector
from hil.core.estimator import Estimate, LevelFilter
from hil.core.following import HEALTHY, Followed, follow
from hil.core.pumps import STRAIGHT, PumpPath, UnderWay
from hil.core.reconfiguration import Reconfiguration
from hil.core.sensors import PLAIN, LevelSensors
from hil.core.start_phase import StartConfig, StartPhase
from hil.core.state_feedback import StateFeedback
from hil.core.types import (
    UNKNOWN,
    UNRESOLVED,
    Alarm,
    Diagnosis,
    Event,
    Inputs,
    Measurement,
    Pair,
    Quad,
    Severity,
    Waterways,
)

TIME_TOLERANCE_S = 1e-6
"""Tolerance for comparing times, against rounding of floats."""

MAX_PREDICTED_PERIODS = 5.0
"""After a stall the estimate is predicted over at most this many control periods."""

ALL = (True, True, True, True)

UNSTABLE_S = 5.0
"""A split is refined after it was found: no stable law for this time is a reason to stop. Instability grows slowly."""


@dataclass(frozen=True)
class LoopConfig:
    """Configuration of the control loop.

    references : (at_s, (r1, r2) in V), ascending in time, the first at 0. reconfigure : whether the law follows the
    diagnosis; otherwise the gains stay as they are. anti_windup_s : see `state_feedback.advance_integral`. pumps,
    sensors : what lies between the law's drives and the commands, and between readings and level signals. start : of
    the start phase.
    """

    reconfiguration: Reconfiguration
    detector: FaultDetector
    level_filter: LevelFilter
    references: tuple[tuple[float, Pair], ...]
    reconfigure: bool
    period_s: float
    anti_windup_s: float
    pumps: PumpPath = STRAIGHT
    sensors: LevelSensors = PLAIN
    start: StartConfig = field(default_factory=StartConfig)


@dataclass(frozen=True, slots=True)
class LoopState:
    """State of the control loop between two steps.

    started_ns : time 0 of the run, still to come in a start phase. reference_V : (2,) outputs requested, on their
    way in a start phase. start : the start phase that the run began with, or None. law : in force. base : the same, at
    the end of a start phase.
    law_for : the reference, effectiveness, valve splits and waterways that the law was computed for. followed : what of
    the diagnosis the law follows. level_cm : (4,) the levels fed back, less a probe's movement. drive_V, raw_V : (2,)
    what law and probe ask for at this step, as drives and as voltages. unstable_since_s : since when no law is stable,
    inf if one is. under_way : drives that have not arrived, for pumps with a delay.
    """

    started_ns: int
    stepped_ns: int
    reference_V: Pair
    law: StateFeedback
    law_for: tuple[Pair, Pair, Pair | None, Waterways | None]
    integral_Vs: Pair
    estimate: Estimate
    memory: Any
    diagnosis: Diagnosis
    iae_Vs: Pair
    drive_V: Pair
    raw_V: Pair
    level_cm: Quad
    under_way: UnderWay
    base: StateFeedback
    start: StartPhase | None = None
    followed: Followed = field(default_factory=Followed)
    unstable_since_s: float = inf

    @property
    def t_s(self) -> float:
        """Run time of the last step, s; negative in a start phase."""
        return (self.stepped_ns - self.started_ns) * 1e-9

    @property
    def is_starting(self) -> bool:
        """Whether the last step was in a start phase, which ends with the step nearest to time 0."""
        return self.start is not None and self.t_s < -0.5 * self.start.period_s

    @property
    def problem(self) -> str:
        """Why the outputs can't be held; "" if they can, or if it is not known for UNSTABLE_S yet."""
        return self.law.problem if self.t_s - self.unstable_since_s >= UNSTABLE_S else ""


def begin(config: LoopConfig, inputs: Inputs, now_ns: int) -> LoopState:
    """State at the first step in control, which begins the start phase if the levels found need one.

    From pumps at rest the integrals start at zero: the command begins with v0 plus the feedback on x, within the rate
    limit. Pumps that already run are taken over bumplessly, at the voltages they have.
    """
    reference, level_cm = config.references[0][1], measured_level_cm(config, inputs)
    start = start_phase.plan(config.start, config.level_filter.model, level_cm, reference, config.period_s)
    base = config.reconfiguration.law(reference, HEALTHY)
    law = base if start is None else start.moved(config.level_filter.model, base, -start.length_s)
    drive_V = config.pumps.drive(inputs.pumps.applied_V)
    integral = (0.0, 0.0)
    if inputs.pumps.applied_V != (0.0, 0.0):
        integral = state_feedback.bumpless_integral(law, level_cm, drive_V)
    return LoopState(
        started_ns=now_ns + (0 if start is None else start.length_ns),
        stepped_ns=now_ns,
        reference_V=reference,
        law=law,
        law_for=(reference, HEALTHY, None, None),
        integral_Vs=integral,
        estimate=estimator.start(config.level_filter, inputs.measurement, drive_V),
        memory=config.detector.start(),
        diagnosis=Diagnosis(),
        iae_Vs=(0.0, 0.0),
        drive_V=(0.0, 0.0),
        raw_V=(0.0, 0.0),
        level_cm=level_cm,
        base=base,
        start=start,
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
    reference = _reference_at(config, t_s)
    base, law_for, integral = state.base, state.law_for, state.integral_Vs
    level_cm = _feedback_level_cm(config, inputs.measurement, diagnosis, estimate, probe)
    followed = follow(state.followed, diagnosis, t_s) if config.reconfigure else state.followed
    requested = (reference, followed.effectiveness, followed.valve_split, followed.waterways)
    if requested != law_for:
        base, law_for = config.reconfiguration.law(*requested), requested
    law = base if state.start is None else state.start.moved(config.level_filter.model, base, t_s)
    if base is not state.base:
        effective = state_feedback.effective_voltage(state.law, integral, level_cm)
        integral = state_feedback.bumpless_integral(law, level_cm, effective)
        ways = _newly_identified(config, state.followed, followed)
        if ways is not None and not law.problem:
            integral = config.reconfiguration.settling_integral(law, ways, level_cm)
    v1, v2 = state_feedback.pump_voltage(law, state_feedback.effective_voltage(law, integral, level_cm))
    drive = (v1 + probe.offset_V[0], v2 + probe.offset_V[1])
    new = LoopState(
        started_ns=state.started_ns,
        stepped_ns=now_ns,
        reference_V=reference if state.start is None else state.start.toward(t_s, reference),
        law=law,
        law_for=law_for,
        integral_Vs=integral,
        estimate=estimate,
        memory=memory,
        diagnosis=diagnosis,
        iae_Vs=_iae(state, estimate, period_s) if t_s > TIME_TOLERANCE_S else state.iae_Vs,
        drive_V=drive,
        raw_V=config.pumps.voltage(drive),
        level_cm=level_cm,
        under_way=under_way,
        base=base,
        start=state.start,
        followed=followed,
        unstable_since_s=min(state.unstable_since_s, t_s) if law.problem else inf,
    )
    return new, _events(state, new)


def integrate(config: LoopConfig, state: LoopState, inputs: Inputs, command_V: Pair) -> Pair:
    """Integrals for the next step, from the command that the supervisor allowed and what the pump node applied."""
    k, (h1, h2, _, _) = config.level_filter.model.level_gain_V_cm, state.level_cm
    error = (state.law.target_V[0] - k * h1, state.law.target_V[1] - k * h2)
    excess = _excess(config.pumps, state.drive_V, inputs, command_V)
    if state.law.standby_V != (None, None):
        effective = state_feedback.effective_voltage(state.law, state.integral_Vs, state.level_cm)
        excess = state_feedback.undelivered(state.law, effective, excess)
    return state_feedback.advance_integral(
        state.law, state.integral_Vs, error, excess, config.period_s, config.anti_windup_s
    )


def _excess(pumps: PumpPath, drive_V: Pair, inputs: Inputs, command_V: Pair) -> Pair:
    """(2,) drives that were requested minus those that were given."""
    short1, short2 = inputs.pumps.shortfall_V
    (d1, d2), (given1, given2) = drive_V, pumps.drive(command_V)
    if not pumps.is_straight:
        applied1, applied2 = inputs.pumps.applied_V
        echoed_V, applied_V = pumps.drive((applied1 + short1, applied2 + short2)), pumps.drive((applied1, applied2))
        short1, short2 = echoed_V[0] - applied_V[0], echoed_V[1] - applied_V[1]
    return d1 - given1 + short1, d2 - given2 + short2


def measured_level_cm(config: LoopConfig, inputs: Inputs) -> Quad:
    """Readings in cm, shape (4,)."""
    k = config.level_filter.model.level_gain_V_cm
    y1, y2, y3, y4 = inputs.measurement.level_V
    return (y1 / k, y2 / k, y3 / k, y4 / k)


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
            _trusted(inputs.measurement, state.diagnosis.trusted),
            min(period_s, MAX_PREDICTED_PERIODS * config.period_s),
        )
    memory, diagnosis = config.detector.step(state.memory, t_s, inputs.measurement, estimate, arrived_V)
    alarms = in_bench_units(diagnosis.new_alarms, config.sensors, config.pumps)
    if alarms is not diagnosis.new_alarms:
        diagnosis = replace(diagnosis, new_alarms=alarms)
    if diagnosis.level_V is not None:
        k, (y1, y2, y3, y4) = config.level_filter.model.level_gain_V_cm, diagnosis.level_V
        level_cm = (y1 / k, y2 / k, y3 / k, y4 / k)
        estimate = Estimate(
            level_cm=level_cm,
            level_V=diagnosis.level_V,
            pump_V=estimate.pump_V,
            innovation_V=estimate.innovation_V,
        )
    return estimate, memory, diagnosis


def _trusted(measurement: Measurement, trusted: tuple[bool, bool, bool, bool]) -> Measurement:
    """The measurement, with sensors that are not trusted marked as not valid."""
    if trusted == ALL:
        return measurement
    v1, v2, v3, v4 = (ok and good for ok, good in zip(measurement.valid, trusted, strict=True))
    return replace(measurement, valid=(v1, v2, v3, v4))


def _feedback_level_cm(
    config: LoopConfig, measurement: Measurement, diagnosis: Diagnosis, estimate: Estimate, probe: ProbeState
) -> Quad:
    """Readings in cm, (4,), less the movement that a probe is expected to cause.

    The estimate where a sensor is not trusted or its reading not valid.
    """
    level_cm = _level_in_use_cm(config, measurement, diagnosis, estimate)
    if probe.linear is None:
        return level_cm
    h1, h2, h3, h4 = (h - moved for h, moved in zip(level_cm, probe.deviation_cm, strict=True))
    return h1, h2, h3, h4


def _level_in_use_cm(config: LoopConfig, measurement: Measurement, diagnosis: Diagnosis, estimate: Estimate) -> Quad:
    """Readings in cm, (4,); the estimate where a sensor is not trusted or its reading not valid."""
    k = config.level_filter.model.level_gain_V_cm
    y1, y2, y3, y4 = measurement.level_V
    if measurement.valid == ALL and diagnosis.trusted == ALL:
        return (y1 / k, y2 / k, y3 / k, y4 / k)
    valid = _trusted(measurement, diagnosis.trusted).valid
    h1, h2, h3, h4 = (
        y / k if ok else h for y, ok, h in zip(measurement.level_V, valid, estimate.level_cm, strict=True)
    )
    return (h1, h2, h3, h4)


def _newly_identified(config: LoopConfig, old: Followed, new: Followed) -> Waterways | None:
    """The waterways if the operating point has just become theirs: the integrals then have nothing to correct."""
    is_new = config.reconfiguration.design.follows_reference and new.waterways is not old.waterways
    return new.waterways if is_new else None


def _reference_at(config: LoopConfig, t_s: float) -> Pair:
    past = (values for at_s, values in reversed(config.references) if at_s <= t_s + TIME_TOLERANCE_S)
    return next(past, config.references[0][1])


def _iae(state: LoopState, estimate: Estimate, period_s: float) -> Pair:
    """Running integral of |r - y| in V s, y from the estimate."""
    (r1, r2), y, (i1, i2) = state.reference_V, estimate.level_V, state.iae_Vs
    return i1 + abs(r1 - y[0]) * period_s, i2 + abs(r2 - y[1]) * period_s


def _events(old: LoopState, new: LoopState) -> tuple[Event, ...]:
    events = [_alarm(alarm) for alarm in new.diagnosis.new_alarms]
    is_first_step = new.stepped_ns == new.started_ns - (0 if new.start is None else new.start.length_ns)
    if is_first_step and new.start is not None:
        events.append(start_phase.begins(new.start, new.law_for[0]))
    if new.reference_V != old.reference_V and not new.is_starting:
        r1, r2 = new.reference_V
        events.append(Event(Severity.INFO, "reference", f"reference {r1:.4f}, {r2:.4f} V", {"reference_V": [r1, r2]}))
    if new.base is not old.base or is_first_step:
        if new.law.effectiveness != old.law.effectiveness:
            e1, e2 = new.law.effectiveness
            text = f"gains recomputed for effectiveness {e1:.3f}, {e2:.3f}"
            events.append(Event(Severity.INFO, "reconfigured", text, {"effectiveness": [e1, e2]}))
        if new.law.reason:
            r1, r2 = new.base.target_V
            text = f"reference can't be reached ({new.law.reason}): aiming at {r1:.4f}, {r2:.4f} V"
            events.append(Event(Severity.WARNING, "target", text, {"target_V": [r1, r2], "reason": new.law.reason}))
    return tuple(events)


def _alarm(alarm: Alarm) -> Event:
    if alarm.is_recovery:
        text = (
            "what no known fault explained is over" if alarm.kind == UNKNOWN else f"{alarm.kind} {alarm.target} is over"
        )
    elif alarm.kind == UNRESOLVED:
        text = f"a fault: {' or '.join(alarm.candidates)}"
    elif alarm.kind == UNKNOWN:
        text = f"something that no known fault explains: {alarm.looks}"
    else:
        text = f"{alarm.kind} {alarm.target}: {alarm.size:.3f}"
    return Event(Severity.WARNING, "alarm", text, asdict(alarm))
