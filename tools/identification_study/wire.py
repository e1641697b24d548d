"""The experiment of `hil identify --emulator` on a drawn rig: over the wire, with its own plan, into run folders."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from firmware_sim.rig import Rig
from firmware_sim.settings import load_fingerprint
from hil.bench import identify_inputs
from hil.bench.experiment_run import EmulatedStage, ExperimentOptions, run_experiment
from hil.bench.ruler import EmulatedRuler
from hil.core.experiment import Phase
from hil.core.experiment_plan import RULER_READINGS
from hil.core.identification.records import LevelRecord
from tools.identification_study.truth import CONFIG, Truth


def wire_records(
    truth: Truth, seed: int, *, is_full: bool, with_ruler: bool
) -> tuple[list[LevelRecord], list[LevelRecord]]:
    """Records to fit, and held-out ones. is_full : 24 minutes in place of 12."""
    bench = identify_inputs.load_bench(None, None)
    emulator = Rig(truth.settings, (), seed, load_fingerprint(CONFIG / "bench.dbc"))
    ruler = EmulatedRuler(lambda: emulator.levels_cm, seed) if with_ruler else None
    options = ExperimentOptions(is_full, RULER_READINGS if with_ruler else 0, None, False, False)
    with TemporaryDirectory() as folder:
        done = run_experiment(bench, options, EmulatedStage(emulator, seed, ruler), Path(folder) / "out", _yes)
        if done is None:
            raise RuntimeError("the experiment did not come to its end")
        fitted, held_out = identify_inputs.records_of(done.runs())
    return list(fitted), list(held_out)


def _yes(index: int, phases: tuple[Phase, ...], recorded: Path | None) -> bool:
    del index, phases, recorded
    return True
