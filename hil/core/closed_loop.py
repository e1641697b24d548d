"""The control loop without the supervisor: estimate, diagnose, and ask the control law.

The decisions behind time 0 are docs/decisions/0004-time-zero.md and 0026-start-phase.md.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from math import inf
from typing import Any

from hil.core import estimator, start_phase
from hil.core.active_isolation import IDLE, ProbeState
from hil.core.alarm_units import in_bench_units
from hil.core.control_law import Authority, ControlLaw, LawInputs, LawRequest
from hil.core.diagnosis.detector import FaultDetector
from hil.core.estimator import Estimate, LevelFilter
from hil.core.following import Followed, follow
from hil.core.law_check import checked
from hil.core.law_copies import inputs_of_law, is_own
from hil.core.pumps import STRAIGHT, PumpPath, UnderWay
from hil.core.reference_path import TIME_TOLERANCE_S, ReferenceMove, RunReferences
from hil.core.sensors import PLAIN, LevelSensors
from hil.core.start_phase import StartConfig, StartPhase
from hil.core.types import (
    UNKNOWN,
    UNRESOLVED,
    Alarm,
    Diagnosis,
    Event,
    Inputs,
    Measurement,
    Mode,
    Pair,
    Quad,
    Severity,
)
from hil.core.worst_target import worst_target

MAX_PREDICTED_PERIODS = 5.0
"""After a stall the estimate is predicted over at most this many control periods."""

ALL = (True, True, True, True)

UNSTABLE_S = 5.0
"""A split is refined after it was found: no stable law for this time is a reason to stop. Instability grows slowly."""


@dataclass(frozen=True)
class LoopConfig:
    """Configuration of the control loop.

    references, moves : (at_s, (r1, r2) in V), ascending in time, the first at 0, and which of them are reached by a
    ramp or trajectory, see `RunReferences`. reconfigure : whether the law is told of the
    diagnosis by `LawInputs.followed`. pumps, sensors : what lies between the law's drives and the commands, and between
    readings and level signals. start : of the start phase.
    """

    law: ControlLaw
    detector: FaultDetector
    level_filter: LevelFilter
    references: tuple[tuple[float, Pair], ...]
    reconfigure: bool
    period_s: float
    pumps: PumpPath = STRAIGHT
    sensors: LevelSensors = PLAIN
    start: StartConfig = field(default_factory=StartConfig)
    moves: tuple[tuple[int, ReferenceMove], ...] = ()

    @cached_property
    def is_own_law(self) -> bool:
        """Whether the law is one of this project's, which needs no copies of what the loop goes on to use."""
        return is_own(self.law)


@dataclass(frozen=True, slots=True)
class LastCommand:
    """What became of the drives that the law asked for, see `LawInputs`. At first the pumps have what was found."""

    given_V: Pair
    excess_V: Pair = (0.0, 0.0)
    authority: Authority = Authority.NOBODY


@dataclass(frozen=True, slots=True)
class LoopState:
    """State of the control loop between two steps.

    started_ns : time 0 of the run, still to come in a start phase. reference_V : (2,) outputs to aim at; in a start
    phase on the way to those that are requested. start : the start phase that the run began with, or None. request : of
    the law at this step. law_memory, memory : of the law and of the detector. inputs : what the law knew. followed :
    what of the diagnosis the law follows. drive_V, raw_V : (2,) what law and probe ask for at this step, as drives and
    as voltages. unstable_since_s : since when the law can't hold the outputs, inf if it can. under_way :
    drives that have not arrived, for pumps with a delay.
    """

    started_ns: int
    stepped_ns: int
    reference_V: Pair
    start: StartPhase | None
    request: LawRequest
    law_memory: Any
    inputs: LawInputs
    last: LastCommand
    estimate: Estimate
    memory: Any
    diagnosis: Diagnosis
    iae_Vs: Pair
    drive_V: Pair
    raw_V: Pair
    under_way: UnderWay
    followed: Followed = field(default_factory=Followed)
    unstable_since_s: float = inf

    @property
    def t_s(self) -> float:
        """Run time of the last step, s; negative in a start phase."""
        return (self.stepped_ns - self.started_ns) * 1e-9

    @property
    def level_cm(self) -> Quad:
        """(4,) the levels fed back, less a probe's movement."""
        return self.inputs.level_cm

    @property
    def is_starting(self) -> bool:
        """Whether the last step was in a start phase, which ends with the step nearest to time 0."""
        return self.start is not None and self.t_s < -0.5 * self.start.period_s

    @property
    def problem(self) -> str:
        """Why the outputs can't be held; "" if they can, or if it is not known for UNSTABLE_S yet."""
        return self.request.problem if self.t_s - self.unstable_since_s >= UNSTABLE_S else ""

    def after(self, last: LastCommand) -> LoopState:
        """The state with this last command; at every step, a third of the time of `replace`."""
        return LoopState(
            started_ns=self.started_ns,
            stepped_ns=self.stepped_ns,
            reference_V=self.reference_V,
            start=self.start,
            request=self.request,
            law_memory=self.law_memory,
            inputs=self.inputs,
            last=last,
            estimate=self.estimate,
            memory=self.memory,
            diagnosis=self.diagnosis,
            iae_Vs=self.iae_Vs,
            drive_V=self.drive_V,
            raw_V=self.raw_V,
            under_way=self.under_way,
            followed=self.followed,
            unstable_since_s=self.unstable_since_s,
        )


def begin(config: LoopConfig, inputs: Inputs, now_ns: int) -> LoopState:
    """State at the first step in control, which begins the start phase if the levels found need one."""
    reference, level_cm = config.references[0][1], measured_level_cm(config, inputs)
    start = start_phase.plan(config.start, config.level_filter.model, level_cm, reference, config.period_s)
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
    asked, why = (reference_V, requested), ""
    if diagnosis.possible and config.reconfigure and t_s > config.period_s:  # not where a start phase is judged
        worst_V, why = worst_target(config.level_filter.model, config.pumps, requested, diagnosis.possible)
        asked = (worst_V, worst_V) if why else asked
    known = LawInputs(
        t_s=t_s,
        period_s=period_s,
        level_cm=_feedback_level_cm(config, inputs.measurement, diagnosis, estimate, probe),
        estimate=estimate,
        diagnosis=diagnosis,
        followed=followed,
        reference_V=asked[0],
        requested_V=asked[1],
        references=references,
        wanted_V=state.request.drive_V,
        given_V=last.given_V,
        excess_V=last.excess_V,
        authority=last.authority,
    )
    told = known if config.is_own_law else inputs_of_law(known, references)
    law_memory, answer = config.law.step(state.law_memory, told)
    request = checked(answer)
    if why and not request.reason:
        request = replace(request, reason=why)
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
    return new, _events(references, state, new)


def conclude(config: LoopConfig, state: LoopState, inputs: Inputs, command_V: Pair, mode: Mode) -> LoopState:
    """The state with what the supervisor made of this step's drives, for the law's next step.

    After a trip, in DISARMED, the law starts again.
    """
    given = config.pumps.drive(command_V)
    if mode.is_controlling:
        excess = _excess(config.pumps, state.drive_V, inputs, given)
        (d1, d2), (w1, w2), (g1, g2) = state.drive_V, state.request.drive_V, given
        given = (g1 - (d1 - w1), g2 - (d2 - w2)) if d1 != w1 or d2 != w2 else given  # less the probe
        return state.after(LastCommand(given, excess, Authority.LAW))
    last = LastCommand(given, authority=Authority.OPERATOR if mode is Mode.MANUAL else Authority.NOBODY)
    if mode not in (Mode.DISARMED, Mode.READY):
        return state.after(last)
    references = RunReferences(config.references, state.start, config.moves)
    known = replace(state.inputs, wanted_V=given, given_V=given, excess_V=last.excess_V, authority=last.authority)
    return replace(state, last=last, law_memory=config.law.start(inputs_of_law(known, references)))


def _excess(pumps: PumpPath, drive_V: Pair, inputs: Inputs, given_V: Pair) -> Pair:
    """(2,) drives that were requested minus those that were given."""
    short1, short2 = inputs.pumps.shortfall_V
    (d1, d2), (given1, given2) = drive_V, given_V
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


def _iae(state: LoopState, estimate: Estimate, period_s: float) -> Pair:
    """Running integral of |r - y| in V s, y from the estimate."""
    (r1, r2), y, (i1, i2) = state.reference_V, estimate.level_V, state.iae_Vs
    return i1 + abs(r1 - y[0]) * period_s, i2 + abs(r2 - y[1]) * period_s


def _events(references: RunReferences, old: LoopState, new: LoopState) -> tuple[Event, ...]:
    events = [_alarm(alarm) for alarm in new.diagnosis.new_alarms]
    if new.start is not None and new.stepped_ns == new.started_ns - new.start.length_ns:
        events.append(start_phase.begins(new.start, new.inputs.requested_V))
    events += _reference_events(references, old, new)
    is_told = new.followed.effectiveness == old.followed.effectiveness or new.followed.told_s > old.followed.told_s
    events += [event for event in new.request.events if is_told or event.code != "reconfigured"]
    if new.request.reason not in ("", old.request.reason) and all(e.code != "target" for e in new.request.events):
        (r1, r2), reason = new.request.target_V, new.request.reason
        text = f"not at the reference ({reason}): aiming at {r1:.4f}, {r2:.4f} V"
        events.append(Event(Severity.WARNING, "target", text, {"target_V": [r1, r2], "reason": reason}))
    return tuple(events)


def _reference_events(references: RunReferences, old: LoopState, new: LoopState) -> list[Event]:
    """An event for a step, and one at the beginning of a ramp or trajectory."""
    if new.is_starting:
        return []
    number = references.entry(new.t_s)
    move = references.move(number)
    if move is None:
        if new.reference_V == old.reference_V:
            return []
        r1, r2 = new.reference_V
        return [Event(Severity.INFO, "reference", f"reference {r1:.4f}, {r2:.4f} V", {"reference_V": [r1, r2]})]
    if references.entry(old.t_s) == number and new.stepped_ns > new.started_ns:
        return []
    (r1, r2), time_s = references.schedule[number][1], move.end_s - move.times_s[0]
    text = f"reference moves to {r1:.4f}, {r2:.4f} V in {time_s:g} s"
    return [Event(Severity.INFO, "reference", text, {"reference_V": [r1, r2], "move_s": time_s})]


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
