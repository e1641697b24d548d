"""One run in lockstep with the emulator, recorded."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

from firmware_sim import settings as emulator_settings
from firmware_sim.ports import BusPort as EmulatorPort
from firmware_sim.rig import Rig as Emulator
from hil import lockstep
from hil.bench.assembly import Bench, controller_config, make_loop, run_plan
from hil.bench.open_record import open_record
from hil.bench.run_options import RunOptions, RunRecord, timeline_settings
from hil.edge.can.bus import BusPort
from hil.edge.can.pair_bus import pair
from hil.edge.record.run_folder import RunFolder
from hil.review import kpi


def simulate(bench: Bench, options: RunOptions, on_progress: Callable[[int], None] | None = None) -> kpi.Kpi:
    """One run in lockstep, recorded; raises SettingsError (of either twin) and RunFolderError."""
    config = controller_config(bench, options.duration_s)
    truth, faults = emulator_settings.load(bench.emulator_path, bench.scenario_path)
    emulator = Emulator(truth, faults, options.seed, emulator_settings.load_fingerprint(bench.dbc_path))
    folder = RunFolder.create(options.out, run_plan(bench, is_live=False, seed=options.seed))
    with ExitStack() as stack:
        ours, theirs = (stack.enter_context(end) for end in pair())
        timeline = timeline_settings(bench, config, options)
        port = BusPort(ours)
        record = stack.enter_context(RunRecord(open_record(folder, timeline), port))
        loop = make_loop(
            bench,
            config,
            port,
            record.recorder,
            clear_trip=options.clear_trip,
            true_level_cm=lambda: emulator.levels_cm,
        )
        record.outcome = lockstep.run(loop, port, EmulatorPort(emulator, theirs), config.loop.period_s, on_progress)
    return kpi.compute(folder)
