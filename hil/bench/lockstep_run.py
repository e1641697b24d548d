"""One run in lockstep with the emulator, recorded."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

from firmware_sim.ports import BusPort as EmulatorPort
from hil import lockstep
from hil.bench import live_picture
from hil.bench.assembly import Bench, controller_config, make_loop
from hil.bench.emulator_twin import emulator_of
from hil.bench.open_record import open_record
from hil.bench.run_options import RunOptions, check_length, timeline_settings
from hil.bench.run_plan import run_plan
from hil.bench.run_record import RunRecord, figures_of, removed_if_not_opened
from hil.edge.can.bus import BusPort
from hil.edge.can.pair_bus import pair
from hil.edge.record.run_folder import RunFolder
from hil.review.kpi import Kpi


def simulate(bench: Bench, options: RunOptions, on_progress: Callable[[int], None] | None = None) -> Kpi:
    """One run in lockstep, recorded.

    on_progress : called with the number of steps made. Raises SettingsError and RunFolderError before the first step;
    IncompleteRecordError when the run has ended but has no key figures.
    """
    check_length(bench, options.duration_s)
    config = controller_config(bench, options.duration_s)
    emulator = emulator_of(bench, options.seed)
    plan = run_plan(bench, is_live=False, seed=options.seed, config=config, clear_trip=options.clear_trip)
    folder = RunFolder.create(options.out, plan)
    with ExitStack() as stack:
        ours, theirs = (stack.enter_context(end) for end in pair())
        timeline = live_picture.with_port(timeline_settings(bench, config, options), options.live)
        port = BusPort(ours)
        with removed_if_not_opened(folder):
            recorder = open_record(folder, timeline)
        stack.enter_context(live_picture.shown(timeline, options.live))
        record = stack.enter_context(RunRecord(recorder, port))
        loop = make_loop(
            bench,
            config,
            port,
            recorder,
            clear_trip=options.clear_trip,
            true_level_cm=lambda: emulator.levels_cm,
        )
        record.outcome = lockstep.run(loop, port, EmulatorPort(emulator, theirs), config.loop.period_s, on_progress)
    return figures_of(folder, recorder, record.outcome)
