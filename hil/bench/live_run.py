"""One run in real time on a CAN bus, recorded by a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from math import isfinite

from hil import runtime
from hil.bench import live_picture
from hil.bench.assembly import Bench, Watcher, controller_config, make_loop
from hil.bench.control_settings import open_channel
from hil.bench.live_warnings import live_warnings
from hil.bench.open_record import open_record
from hil.bench.run_options import RunOptions, timeline_settings
from hil.bench.run_plan import run_plan
from hil.bench.run_record import RunRecord, figures_of, removed_if_not_opened
from hil.core.types import Event, Severity
from hil.edge.can.bus import BusAddress, BusPort
from hil.edge.control.control_channel import ControlChannel
from hil.edge.host import realtime
from hil.edge.host.clock import MonotonicClock, StopSignal
from hil.edge.host.realtime import RealTime
from hil.edge.record.process_recorder import ProcessRecorder
from hil.edge.record.run_folder import RunFolder
from hil.loop import Outcome
from hil.review.kpi import Kpi


def run_live(
    bench: Bench, options: RunOptions, address: BusAddress, on_tick: Watcher | None = None
) -> tuple[Kpi, Outcome]:
    """One run in real time.

    Raises SettingsError, RunFolderError, BusError before any pump moves; IncompleteRecordError when the run has ended
    but has no key figures.
    """
    config = controller_config(bench, options.duration_s)
    config = replace(
        config,
        limits=replace(config.limits, attended_s=options.attended_s),
        waits_for_clearing=not isfinite(config.duration_s),
    )
    clock = MonotonicClock()
    with ExitStack() as stack:
        recorder = stack.enter_context(ProcessRecorder())
        channel = stack.enter_context(ControlChannel())
        port = BusPort(address.open(bench.contract.ids))
        stack.callback(port.close)
        plan = run_plan(bench, is_live=True, seed=None, config=config, clear_trip=options.clear_trip)
        folder = RunFolder.create(options.out, plan)
        timeline = live_picture.with_port(timeline_settings(bench, config, options), options.live)
        with removed_if_not_opened(folder):
            no_channel = open_channel(channel, bench, config, folder, options)
            recorder.open(folder, partial(open_record, folder, timeline, options.realtime is not None))
        stack.enter_context(live_picture.shown(timeline, options.live))
        record = stack.enter_context(RunRecord(recorder, port))
        for warning in (*live_warnings(bench), *no_channel):
            _warn(warning, recorder)
        loop = make_loop(
            bench,
            config,
            port,
            recorder,
            clear_trip=options.clear_trip,
            on_tick=on_tick,
            clock_ns=clock.now_ns,
            operator=channel,
            troubles=recorder.troubles,
        )
        stop = stack.enter_context(StopSignal())
        asked = [] if options.realtime is None else [_real_time(stack, options.realtime, recorder)]
        record.outcome = runtime.run(
            loop, port, clock, config.loop.period_s, lambda: stop.received.name if stop.received else "", *asked
        )
        channel.close(record.outcome.t_s, f"{record.outcome.status}: {record.outcome.reason}")
    return figures_of(folder, recorder, record.outcome), record.outcome


def _real_time(stack: ExitStack, wanted: RealTime, recorder: ProcessRecorder) -> Callable[[], None]:
    """Apply what the system allows, for this thread; refusals are in the record and on the terminal."""
    applied = stack.enter_context(realtime.applied(wanted))
    for refusal in applied.refusals:
        _warn(Event(Severity.WARNING, "realtime", refusal), recorder)
    return applied.housekeeping


def _warn(event: Event, recorder: ProcessRecorder) -> None:
    """Show and record it. Standard error that can't be written to is no reason to end the run."""
    live_picture.say(event.text)
    recorder.event(0.0, event)
