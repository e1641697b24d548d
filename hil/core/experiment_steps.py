"""One control step of an experiment: the phase gives the voltages, the supervisor decides what is sent.

The supervisor and the interlocks are those of a run, and so are modes, trips and stops. There is no control law and no
diagnosis, and what they need of a model is left out: the file may be wrong, that is why the experiment is made. What
remains of the file is the predicted peak of the levels, which asks for a stop early rather than late.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import exp, isfinite, nan
from sys import maxsize

from hil.core import experiment, supervisor
from hil.core.controller import Output
from hil.core.dry_watch import DryWatch, watch_dry
from hil.core.experiment import Envelope, Phase, PhaseState, Until
from hil.core.interlocks import Belief, Limits
from hil.core.live_request import LiveRequest
from hil.core.sensors import LevelSensors, levels_shown
from hil.core.supervisor import Supervision
from hil.core.types import ALL_SENSORS, Event, Inputs, Mode, Pair, Quad, Severity, TickRecord, TripCause

FAILED = "experiment_failed"
"""The reason of a phase that has stopped itself; the event `experiment` says why."""

READ_SHARE = 0.4
"""Levels below this share of the highest one are read once: a millimetre is too much of them."""

NO_PAIR: Pair = (nan, nan)
NO_GAIN = (0.0,) * 12


@dataclass(frozen=True)
class ExperimentConfig:
    """A phase and the rig that it is for. lag_s : (2,) of the pumps."""

    phase: Phase
    envelope: Envelope
    limits: Limits
    sensors: LevelSensors
    lag_s: Pair
    period_s: float


@dataclass(frozen=True, slots=True)
class ExperimentState:
    """State between two steps. progress : None before the first step that moves. drive_V : (2,) after the lag."""

    supervision: Supervision = field(default_factory=Supervision)
    progress: PhaseState | None = None
    started_ns: int = 0
    stepped_ns: int = 0
    drive_V: Pair = (0.0, 0.0)
    dry: DryWatch = field(default_factory=DryWatch)


class ExperimentSteps:
    """What the loop calls, see `hil.core.steps`. answered : how often the levels have been read in this phase."""

    def __init__(self, config: ExperimentConfig, answered: Callable[[], int] = lambda: maxsize) -> None:
        self.config = config
        self.limits = config.limits
        self.sensors = config.sensors
        self._answered = answered

    def start(self) -> ExperimentState:
        """The state before the first step."""
        return ExperimentState()

    def step(
        self, state: ExperimentState, inputs: Inputs, now_ns: int, _asked: tuple[LiveRequest, ...] = ()
    ) -> tuple[ExperimentState, Output]:
        """One step at now_ns. The caller answers an exception with `fail`."""
        return step(self.config, state, inputs, now_ns, answered=self._answered())

    def fail(self, state: ExperimentState, cause: TripCause, text: str) -> tuple[ExperimentState, Output]:
        """State and output for a step that raised an exception: trip, 0 V in the same step."""
        supervision, events = supervisor.trip(state.supervision, cause, text)
        return replace(state, supervision=supervision), Output(command=supervisor.OFF, events=events, record=None)

    def will_be_cleared(self, state: ExperimentState, can_be_asked: bool) -> bool:
        """No trip is cleared by itself."""
        del state, can_be_asked
        return False

    def is_over(self, state: ExperimentState) -> bool:
        """Whether the phase has ended by itself."""
        return state.progress is not None and state.progress.is_over


def step(
    config: ExperimentConfig, state: ExperimentState, inputs: Inputs, now_ns: int, *, answered: int = 0
) -> tuple[ExperimentState, Output]:
    """One step at now_ns (monotonic). The command is always safe."""
    if state.progress is None:
        supervision, events = supervisor.next_mode(config.limits, state.supervision, inputs, now_ns)
        if not supervision.mode.is_controlling:
            return ExperimentState(supervision), Output(command=supervisor.OFF, events=events, record=None)
        state = replace(state, supervision=supervision, progress=PhaseState(), started_ns=now_ns, stepped_ns=now_ns)
        begins = Event(Severity.INFO, "experiment", f"{config.phase.name}: {config.phase.text}", {"phase": "begin"})
        events += (begins,)
    else:
        events = ()
    before, level_cm = state.progress or PhaseState(), _levels_cm(config, inputs)
    progress = before
    if state.supervision.mode.is_controlling and all(map(isfinite, level_cm)):
        t_s = (now_ns - state.started_ns) * 1e-9
        progress = experiment.advance(config.phase, config.envelope, before, t_s, level_cm, answered=answered)
        events += _events(config.phase, before, progress, level_cm)
    state = _observed(config, state, inputs, level_cm, now_ns)
    if progress.is_over or progress.problem:
        inputs = replace(inputs, stop_requested=True)
    supervision, more = supervisor.next_mode(config.limits, state.supervision, inputs, now_ns, _belief(state, level_cm))
    if progress.problem and supervision.mode is Mode.STOPPING and not supervision.stopped_by:
        supervision = supervision._replace(stopped_by=FAILED)
    supervision, command = supervisor.safe_command(config.limits, supervision, progress.voltage_V, config.period_s)
    state = replace(state, supervision=supervision, progress=progress)
    events += more
    record = _record(state, inputs, progress.voltage_V, command.voltage_V, events)
    return state, Output(command=command, events=events, record=record)


def _levels_cm(config: ExperimentConfig, inputs: Inputs) -> Quad:
    return levels_shown(inputs.measurement.level_V, config.limits.level_gain_V_cm)


def _observed(
    config: ExperimentConfig, state: ExperimentState, inputs: Inputs, level_cm: Quad, now_ns: int
) -> ExperimentState:
    """The state with what the pumps still deliver, and the watch of dry pumps."""
    period_s = (now_ns - state.stepped_ns) * 1e-9
    applied = config.limits.pumps.drive(inputs.pumps.applied_V)
    first, second = (
        was + (now - was) * (1.0 - exp(-period_s / lag_s) if lag_s > 0.0 else 1.0)
        for was, now, lag_s in zip(state.drive_V, applied, config.lag_s, strict=True)
    )
    dry = state.dry
    if inputs.measurement.valid == ALL_SENSORS:
        dry = watch_dry(config.limits.model, dry, level_cm, (first, second), ALL_SENSORS, now_ns)
    return replace(state, stepped_ns=now_ns, drive_V=(first, second), dry=dry)


def _belief(state: ExperimentState, level_cm: Quad) -> Belief:
    """What the interlocks assume: readings, and the drives that may still arrive."""
    return Belief(level_cm=level_cm, pump_V=state.drive_V, is_dry=state.dry.is_dry)


def _events(phase: Phase, before: PhaseState, now: PhaseState, level_cm: Quad) -> tuple[Event, ...]:
    if now.problem:
        return (Event(Severity.ERROR, "experiment", f"the phase stops: {now.problem}", {"phase": "failed"}),)
    if now.is_over:
        return (Event(Severity.INFO, "experiment", f"{phase.name} is complete", {"phase": "end"}),)
    events: tuple[Event, ...] = ()
    for pump in (0, 1):
        if now.held[pump] and not before.held[pump]:
            text = f"pump {pump + 1} waits at 0 V: a tank that it feeds is full enough"
            events += (Event(Severity.INFO, "experiment_held", text, {"pump": pump + 1}),)
    if now.segment != before.segment and phase.segments[now.segment].until is Until.ANSWERED:
        events += (_reading_asked(phase, now.segment, level_cm),)
    return events


def _reading_asked(phase: Phase, segment: int, level_cm: Quad) -> Event:
    """The event at which somebody reads the levels. tanks : from 1 on, in its data."""
    full_enough = [i for i in range(4) if level_cm[i] >= READ_SHARE * max(level_cm)]
    tanks = [tank + 1 for tank in phase.segments[segment].tanks or full_enough]
    number, count = phase.readings_until(segment), phase.readings_until(len(phase.segments))
    names = " and ".join(f"tank {tank}" for tank in tanks)
    text = f"read by a ruler now, reading {number} of {count}: {names}"
    return Event(Severity.INFO, "ruler", text, {"tanks": tanks, "number": number, "count": count})


def _record(
    state: ExperimentState, inputs: Inputs, wanted_V: Pair, command_V: Pair, events: tuple[Event, ...]
) -> TickRecord:
    return TickRecord(
        t_s=(state.stepped_ns - state.started_ns) * 1e-9,
        mode=state.supervision.mode,
        measured_V=inputs.measurement.level_V,
        estimated_V=inputs.measurement.level_V,
        reference_V=NO_PAIR,
        target_V=NO_PAIR,
        operating_V=NO_PAIR,
        raw_V=wanted_V,
        command_V=command_V,
        applied_V=inputs.pumps.applied_V,
        effectiveness=(1.0, 1.0),
        integral_Vs=(0.0, 0.0),
        gain=NO_GAIN,
        iae_Vs=(0.0, 0.0),
        levels_age_s=inputs.measurement.age_s,
        status_age_s=inputs.pumps.age_s,
        lateness_s=inputs.timing.lateness_s,
        skipped=inputs.timing.skipped,
        accepted=inputs.bus.accepted,
        rejected=inputs.bus.rejected,
        events=events,
        monotonic_ns=state.stepped_ns,
    )
