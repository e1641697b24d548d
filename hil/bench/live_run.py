"""One run in real time on a CAN bus, recorded by a process of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

from hil import runtime
from hil.bench.assembly import Bench, Watcher, controller_config, make_loop, run_plan
from hil.bench.live_warnings import live_warnings
from hil.bench.open_record import open_record
from hil.bench.run_options import RunOptions, RunRecord, timeline_settings
from hil.core.types import Event, Severity
from hil.edge.can.bus import BusAddress, BusPort
from hil.edge.host import realtime
from hil.edge.host.clock import MonotonicClock, StopSignal
from hil.edge.host.realtime import RealTime
from hil.edge.record.recorder_process import ProcessRecorder
from hil.edge.record.run_folder import RunFolder
from hil.loop import Outcome
from hil.review import kpi


def run_live(
    bench: Bench, options: RunOptions, address: BusAddress, on_tick: Watcher | None = None
) -> tuple[kpi.Kpi, Outcome]:
    """One run in real time; raises SettingsError, RunFolderError, BusError before anything moves."""
    config = controller_config(bench, options.duration_s)
    clock = MonotonicClock()
    with ExitStack() as stack:
        recorder = stack.enter_context(ProcessRecorder())
        port = BusPort(address.open(bench.contract.ids))
        stack.callback(port.close)
        folder = RunFolder.create(options.out, run_plan(bench, is_live=True, seed=None))
        timeline = timeline_settings(bench, config, options)
        recorder.open(folder, partial(open_record, folder, timeline, options.realtime is not None))
        record = stack.enter_context(RunRecord(recorder, port))
        for warning in live_warnings(bench):
            sys.stderr.write(f"hil: {warning.text}\n")
            recorder.event(0.0, warning)
        loop = make_loop(
            bench, config, port, recorder, clear_trip=options.clear_trip, on_tick=on_tick, clock_ns=clock.now_ns
        )
        stop = stack.enter_context(StopSignal())
        asked = [] if options.realtime is None else [_real_time(stack, options.realtime, recorder)]
        record.outcome = runtime.run(
            loop, port, clock, config.loop.period_s, lambda: stop.received.name if stop.received else "", *asked
        )
    return kpi.compute(folder), record.outcome


def _real_time(stack: ExitStack, wanted: RealTime, recorder: ProcessRecorder) -> Callable[[], None]:
    """What the system grants of it, for this thread; what it doesn't is in the record and on the terminal."""
    applied = stack.enter_context(realtime.applied(wanted))
    for refusal in applied.refusals:
        sys.stderr.write(f"hil: {refusal}\n")
        recorder.event(0.0, Event(Severity.WARNING, "realtime", refusal))
    return applied.housekeeping
