"""Runs from start to report: in lockstep with the emulator, or live on a bus."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

from firmware_sim import settings as emulator_settings
from firmware_sim.ports import BusPort as EmulatorPort
from firmware_sim.rig import Rig as Emulator
from hil import lockstep, runtime
from hil.cli.build import Bench, controller_config, run_plan
from hil.cli.record import TimelineSettings, open_record
from hil.core.controller import ControllerConfig, Output
from hil.core.types import Event, Inputs, Mode, Quad, Severity
from hil.edge import realtime
from hil.edge.bus import BusAddress, BusPort
from hil.edge.clock import MonotonicClock, StopSignal
from hil.edge.pair_bus import pair
from hil.edge.realtime import RealTime
from hil.edge.recorder import Recorder
from hil.edge.recorder_process import ProcessRecorder
from hil.edge.run_folder import RunFolder
from hil.loop import ControlLoop, Outcome
from hil.review import kpi

Watcher = Callable[[Inputs, Output, Mode], None]


@dataclass(frozen=True)
class Options:
    """How to run, whatever the scenario says.

    seed : of the emulator's noise. rerun : whether to write run.rrd. realtime : what to ask of the system, live.
    """

    out: Path
    seed: int = 1
    duration_s: float | None = None
    rerun: bool = True
    clear_trip: bool = False
    realtime: RealTime | None = None


def default_folder(name: str, now: datetime) -> Path:
    """runs/<time>_<name>, below the current directory."""
    return Path("runs") / f"{now:%Y%m%d-%H%M%S}_{name}"


def simulate(bench: Bench, options: Options, on_progress: Callable[[int], None] | None = None) -> kpi.Kpi:
    """One run in lockstep, recorded; raises SettingsError (of either twin) and RunFolderError."""
    config = controller_config(bench, options.duration_s)
    truth, faults = emulator_settings.load(bench.emulator_path, bench.scenario_path)
    emulator = Emulator(truth, faults, options.seed, emulator_settings.load_fingerprint(bench.dbc_path))
    folder = RunFolder.create(options.out, run_plan(bench, is_live=False, seed=options.seed))
    with ExitStack() as stack:
        ours, theirs = (stack.enter_context(end) for end in pair())
        timeline = _timeline(bench, config, options, with_truth=True)
        port = BusPort(ours)
        record = stack.enter_context(_Record(open_record(folder, timeline), port))
        loop = _loop(bench, config, options, port, record.recorder, true_level_cm=lambda: emulator.levels_cm)
        record.outcome = lockstep.run(loop, port, EmulatorPort(emulator, theirs), config.loop.period_s, on_progress)
    return kpi.compute(folder)


def run_live(
    bench: Bench, options: Options, address: BusAddress, on_tick: Watcher | None = None
) -> tuple[kpi.Kpi, Outcome]:
    """One run in real time; raises SettingsError, RunFolderError, BusError before anything moves."""
    config = controller_config(bench, options.duration_s)
    clock = MonotonicClock()
    with ExitStack() as stack:
        recorder = stack.enter_context(ProcessRecorder())
        port = BusPort(address.open(bench.contract.ids))
        stack.callback(port.close)
        folder = RunFolder.create(options.out, run_plan(bench, is_live=True, seed=None))
        timeline = _timeline(bench, config, options, with_truth=False)
        recorder.open(folder, partial(open_record, folder, timeline, options.realtime is not None))
        record = stack.enter_context(_Record(recorder, port))
        loop = _loop(bench, config, options, port, recorder, on_tick=on_tick, clock_ns=clock.now_ns)
        stop = stack.enter_context(StopSignal())
        asked = [] if options.realtime is None else [_real_time(stack, options.realtime, recorder)]
        record.outcome = runtime.run(
            loop, port, clock, config.loop.period_s, lambda: stop.received.name if stop.received else "", *asked
        )
    return kpi.compute(folder), record.outcome


class _Record:
    """Closes a recorder whatever happens, with how the run ended and what became of its commands as the last event."""

    def __init__(self, recorder: Recorder | ProcessRecorder, port: BusPort) -> None:
        self.recorder = recorder
        self._port = port
        self.outcome: Outcome | None = None
        self._started = time.perf_counter()

    def __enter__(self) -> _Record:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        wall_s = time.perf_counter() - self._started
        if kind is KeyboardInterrupt:
            self.recorder.close("stopped", "interrupted")
            return
        if self.outcome is None:
            self.recorder.close("failed", f"{kind.__name__}: {error}" if kind else "ended without an outcome")
            return
        outcome = self.outcome
        severity = Severity.INFO if outcome.status in ("complete", "stopped") else Severity.ERROR
        counts: dict[str, object] = {
            "commands_sent": outcome.commands_sent,
            "commands_lost": outcome.commands_lost,
            "frames_lost": outcome.frames_lost,
            **{f"line_{name}": number for name, number in self._port.line_counts.items()},
        }
        if self._port.bus_errors:
            counts["bus_errors"] = dict(self._port.bus_errors)
        self.recorder.event(outcome.t_s, Event(severity, "end", f"{outcome.status}: {outcome.reason}", counts))
        self.recorder.close(outcome.status, outcome.reason, speed_x=outcome.t_s / wall_s)


def _loop(
    bench: Bench,
    config: ControllerConfig,
    options: Options,
    port: BusPort,
    recorder: Recorder | ProcessRecorder,
    *,
    true_level_cm: Callable[[], Quad] | None = None,
    on_tick: Watcher | None = None,
    clock_ns: Callable[[], int] | None = None,
) -> ControlLoop:
    return ControlLoop(
        config,
        bench.contract,
        bench.rig.sensors.range_V,
        port,
        recorder,
        arm_timeout_s=bench.rig.safety.arm_timeout_s,
        clear_trip=options.clear_trip,
        true_level_cm=true_level_cm,
        on_tick=on_tick,
        clock_ns=clock_ns,
    )


def _timeline(bench: Bench, config: ControllerConfig, options: Options, *, with_truth: bool) -> TimelineSettings | None:
    """What run.rrd needs, if it is wanted."""
    return TimelineSettings(bench.rig.sensors.gain_V_cm, config.duration_s, with_truth) if options.rerun else None


def _real_time(stack: ExitStack, wanted: RealTime, recorder: ProcessRecorder) -> Callable[[], None]:
    """What the system grants of it, for this thread; what it doesn't is in the record and on the terminal."""
    granted = stack.enter_context(realtime.granted(wanted))
    for refusal in granted.refusals:
        sys.stderr.write(f"hil: {refusal}\n")
        recorder.event(0.0, Event(Severity.WARNING, "realtime", refusal))
    return granted.housekeeping
