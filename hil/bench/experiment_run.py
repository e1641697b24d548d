"""An identification experiment: its phases one after the other, each recorded as a run of its own.

Live or in lockstep with the emulator; the loop, the supervisor and the record are those of a run. Whatever ends a
phase, the pumps are at 0 V and its record is closed before the next one begins.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from firmware_sim.ports import BusPort as EmulatorPort
from firmware_sim.rig import Rig as Emulator
from hil import lockstep, runtime
from hil.bench.core_settings import safety_limits
from hil.bench.experiment_folder import ExperimentFolder
from hil.bench.open_record import TimelineSettings, open_record
from hil.bench.ruler import Ruler, RulerWatch
from hil.bench.run_options import timeline_of
from hil.bench.run_record import RunRecord, figures_of, removed_if_not_opened
from hil.core.controller import Output
from hil.core.experiment import Phase
from hil.core.experiment_plan import BASIC_S, FULL_S, PlanSpec, envelope, plan
from hil.core.experiment_steps import FAILED, ExperimentConfig, ExperimentSteps
from hil.core.types import Inputs, Mode
from hil.edge.can.bus import BusAddress, BusPort
from hil.edge.can.pair_bus import pair
from hil.edge.config.rig_file import Rig
from hil.edge.config.settings_file import read_text
from hil.edge.host.clock import MonotonicClock, StopSignal
from hil.edge.record.manifest import RunPlan
from hil.edge.record.process_recorder import ProcessRecorder
from hil.edge.record.run_folder import RunFolder
from hil.loop import ControlLoop, Outcome
from hil.review.ticks import read_events
from hil.wire.contract import Contract

PAUSE_NS = 500_000_000
"""Between two phases in lockstep: longer than the pump node's watchdog, so that it takes any counter."""

Watcher = Callable[[Inputs, Output, Mode], None]


@dataclass(frozen=True)
class ExperimentBench:
    """The rig of an experiment and the files that it came from, all checked."""

    rig: Rig
    contract: Contract
    rig_path: Path
    files: tuple[Path, ...]


@dataclass(frozen=True)
class ExperimentOptions:
    """How to experiment. readings : how often levels are read by a ruler; 0: without one.

    minutes : longest time without emptying and ruler; None: that of the plan.
    """

    is_full: bool = False
    readings: int = 0
    minutes: float | None = None
    rerun: bool = True
    clear_trip: bool = False

    def spec(self, rig: Rig) -> PlanSpec:
        """What the plan is made for."""
        longest_s = FULL_S if self.is_full else BASIC_S
        return PlanSpec(
            model=rig.tank_model,
            pumps=rig.pump_path,
            operating_drives=rig.operating_drives,
            level_max_cm=rig.safety.level_max_cm,
            rim_margin_cm=rig.safety.rim_margin_cm,
            is_full=self.is_full,
            readings=self.readings,
            time_scale=1.0 if self.minutes is None else self.minutes * 60.0 / longest_s,
        )

    @property
    def choices(self) -> dict[str, Any]:
        """What another call must choose alike to go on with the same experiment."""
        structure = "full" if self.is_full else "basic"
        return {"structure": structure, "ruler": self.readings > 0, "readings": self.readings, "minutes": self.minutes}


class Stage(Protocol):
    """Where phases run: the rig on a bus, or the emulator."""

    mode: Any
    seed: int | None

    def run(self, bench: ExperimentBench, phase: Phase, path: Path, options: ExperimentOptions) -> Outcome:
        """Run and record one phase."""
        ...


class Aborted(Exception):  # noqa: N818 - the end of an experiment, not an error
    """The experiment ended before its last phase. phase : in which. outcome : of that phase. path : its run folder."""

    def __init__(self, phase: Phase, outcome: Outcome, path: Path) -> None:
        self.phase, self.outcome, self.path = phase, outcome, path
        super().__init__(f"phase {phase.name}: {self.why}")

    @property
    def has_stopped_itself(self) -> bool:
        """Whether the phase found something wrong."""
        return self.outcome.reason.partition(";")[0] == FAILED

    @property
    def why(self) -> str:
        """How the phase ended, in the words of the event that ended it."""
        code = "experiment" if self.has_stopped_itself else "trip"
        texts = [event.text for event in read_events(self.path / "events.jsonl") if event.code == code]
        return texts[-1] if texts else f"{self.outcome.status}, {self.outcome.reason}"


def phases_of(bench: ExperimentBench, options: ExperimentOptions) -> tuple[Phase, ...]:
    """The phases of the plan."""
    return plan(options.spec(bench.rig))


def run_experiment(
    bench: ExperimentBench,
    options: ExperimentOptions,
    stage: Stage,
    out: Path,
    confirm: Callable[[int, tuple[Phase, ...], Path | None], bool],
) -> ExperimentFolder | None:
    """All phases that are not recorded yet, in their order.

    confirm : called before each phase with its index, all phases and, if it is recorded already, its folder; returns
    whether to go on. None is returned when it refused. Raises Aborted when a phase did not go to its end;
    SettingsError, RunFolderError, BusError before anything moves.
    """
    phases = phases_of(bench, options)
    folder = ExperimentFolder.open(out, phases, options.choices)
    for index, phase in enumerate(phases):
        recorded = folder.recorded(phase.name)
        if not confirm(index, phases, recorded):
            return None
        if recorded is not None:
            continue
        path = folder.new_path(phase.name)
        outcome = stage.run(bench, phase, path, options)
        if outcome.status != "complete" or folder.recorded(phase.name) is None:
            raise Aborted(phase, outcome, path)
    return folder


def experiment_config(bench: ExperimentBench, phase: Phase, options: ExperimentOptions) -> ExperimentConfig:
    """The steps of a phase on this rig."""
    rig = bench.rig
    return ExperimentConfig(
        phase=phase,
        envelope=envelope(options.spec(rig)),
        limits=safety_limits(rig),
        sensors=rig.level_sensors,
        lag_s=rig.lags_s,
        period_s=rig.control.period_s,
    )


def phase_plan(bench: ExperimentBench, phase: Phase, stage: Stage) -> RunPlan:
    """What the run folder of a phase keeps of the configuration."""
    settings = {
        "rig": bench.rig.model_dump(mode="json"),
        "experiment": {"phase": phase.name, "is_held_out": phase.is_held_out, "begins_empty": phase.empties},
    }
    names = ["rig.toml" if file == bench.rig_path else file.name for file in bench.files]
    return RunPlan(
        scenario=f"identify_{phase.name}",
        mode=stage.mode,
        seed=stage.seed,
        period_s=bench.rig.control.period_s,
        settings=settings,
        copies={name: read_text(file) for name, file in zip(names, bench.files, strict=True)},
    )


def _timeline(bench: ExperimentBench, phase: Phase, options: ExperimentOptions) -> TimelineSettings | None:
    return timeline_of(bench.rig, phase.max_s) if options.rerun else None


class EmulatedStage:
    """The emulator, in lockstep; its tanks go on from phase to phase.

    on_progress : called with the time of the experiment, s. with_lines : whether events are shown.
    """

    mode = "lockstep"

    def __init__(
        self,
        emulator: Emulator,
        seed: int,
        ruler: Ruler | None = None,
        *,
        on_progress: Callable[[float], None] | None = None,
        with_lines: bool = False,
    ) -> None:
        self.seed: int | None = seed
        self._emulator, self._ruler = emulator, ruler
        self._on_progress, self._with_lines = on_progress, with_lines
        self._start_ns = 0

    def run(self, bench: ExperimentBench, phase: Phase, path: Path, options: ExperimentOptions) -> Outcome:
        """Run and record one phase."""
        emulator, start_ns, period_s = self._emulator, self._start_ns, bench.rig.control.period_s
        watch = RulerWatch(self._ruler)
        folder = RunFolder.create(path, phase_plan(bench, phase, self))
        with ExitStack() as stack:
            ours, theirs = (stack.enter_context(end) for end in pair())
            port = BusPort(ours)
            with removed_if_not_opened(folder):
                recorder = open_record(folder, _timeline(bench, phase, options), self._with_lines)
            record = stack.enter_context(RunRecord(recorder, port))
            steps = ExperimentSteps(experiment_config(bench, phase, options), watch.answered)
            loop = _loop(bench, steps, port, recorder, options, watch.see, true_level_cm=lambda: emulator.levels_cm)
            stop = stack.enter_context(StopSignal())
            record.outcome = lockstep.run(
                loop,
                port,
                EmulatorPort(emulator, theirs),
                period_s,
                self._progress(start_ns, period_s),
                start_ns=start_ns,
                stop_reason=lambda: stop.received.name if stop.received else "",
            )
        self._start_ns = emulator.now_ns + PAUSE_NS
        figures_of(folder, recorder, record.outcome)
        watch.write(path)
        return record.outcome

    def _progress(self, start_ns: int, period_s: float) -> Callable[[int], None] | None:
        on_progress = self._on_progress
        return None if on_progress is None else lambda steps: on_progress(start_ns * 1e-9 + steps * period_s)


class LiveStage:
    """The rig on a CAN bus, in real time."""

    mode = "live"
    seed: int | None = None

    def __init__(self, address: BusAddress, ruler: Ruler | None = None, *, with_lines: bool = True) -> None:
        self._address, self._ruler, self._with_lines = address, ruler, with_lines

    def run(self, bench: ExperimentBench, phase: Phase, path: Path, options: ExperimentOptions) -> Outcome:
        """Run and record one phase. Raises what `hil.bench.live_run.run_live` raises."""
        watch, clock = RulerWatch(self._ruler), MonotonicClock()
        with ExitStack() as stack:
            recorder = stack.enter_context(ProcessRecorder())
            port = BusPort(self._address.open(bench.contract.ids))
            stack.callback(port.close)
            folder = RunFolder.create(path, phase_plan(bench, phase, self))
            with removed_if_not_opened(folder):
                recorder.open(folder, partial(open_record, folder, _timeline(bench, phase, options), self._with_lines))
            record = stack.enter_context(RunRecord(recorder, port))
            steps = ExperimentSteps(experiment_config(bench, phase, options), watch.answered)
            loop = _loop(bench, steps, port, recorder, options, watch.see, clock_ns=clock.now_ns)
            stop = stack.enter_context(StopSignal())
            record.outcome = runtime.run(
                loop,
                port,
                clock,
                bench.rig.control.period_s,
                lambda: stop.received.name if stop.received else "",
            )
        figures_of(folder, recorder, record.outcome)
        watch.write(path)
        return record.outcome


def _loop(
    bench: ExperimentBench,
    steps: ExperimentSteps,
    port: BusPort,
    recorder: Any,
    options: ExperimentOptions,
    on_tick: Watcher,
    **more: Any,
) -> ControlLoop:
    rig = bench.rig
    return ControlLoop(
        steps,
        bench.contract,
        rig.sensors.range_V,
        port,
        recorder,
        arm_timeout_s=rig.safety.arm_timeout_s,
        clear_trip=options.clear_trip,
        on_tick=on_tick,
        **more,
    )
