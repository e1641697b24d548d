"""What `hil identify` works with: the rig it starts from, the emulator's truth, and the records of run folders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from firmware_sim import settings as emulator_settings
from firmware_sim.rig import Rig as Emulator
from hil.bench.assembly import load_contract
from hil.bench.experiment_folder import recorded_runs
from hil.bench.experiment_run import ExperimentBench
from hil.bench.ruler import read_readings
from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.tanks import TankModel
from hil.core.types import Quad
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.settings_file import SettingsError, default_config_dir, of_all, read_toml
from hil.edge.config.shipped import find_rig, find_scenario, rig_file_in_use
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.level_records import record_of_folder

EMPTY_CM: Quad = (0.0, 0.0, 0.0, 0.0)


def load_bench(rig: str | None, config_dir: Path | None) -> ExperimentBench:
    """The rig of an experiment. Raises SettingsError."""
    config = config_dir or default_config_dir()
    path, dbc = rig_file_in_use(rig, config_dir), config / "bench.dbc"
    return ExperimentBench(load_rig(path), load_contract(dbc), path, (path, dbc))


def emulator(truth: str | None, rig: str | None, config_dir: Path | None, seed: int) -> Emulator:
    """The emulator with empty tanks.

    truth : a rig file, an emulator file, or a scenario whose [emulator] table says how the true rig differs, by path or
    shipped name; None: the rig, as `hil simulate` has it. A scenario's faults are not played. Raises SettingsError.
    """
    config = config_dir or default_config_dir()
    emulator_file, scenario, rig_file = config / "emulator.toml", None, None
    if rig is not None:
        rig_file = find_rig(rig, config_dir)
    if truth is not None:
        kind, path = _truth_file(truth, config_dir)
        if kind == "rig":
            rig_file = path
        elif kind == "emulator":
            emulator_file, rig_file = path, None
        else:
            scenario = path
    try:
        settings, _ = emulator_settings.load(emulator_file, scenario, rig_file, is_empty=True)
        return Emulator(settings, (), seed, emulator_settings.load_fingerprint(config / "bench.dbc"))
    except emulator_settings.SettingsError as error:
        raise SettingsError(str(error)) from None


def _truth_file(truth: str, config_dir: Path | None) -> tuple[str, Path]:
    try:
        path = find_rig(truth, config_dir)
    except SettingsError:
        path = find_scenario(truth, config_dir)
    tables = read_toml(path)
    for table, kind in (("scenario", "scenario"), ("nodes", "emulator"), ("safety", "rig")):
        if table in tables:
            return kind, path
    raise SettingsError(f"{path}: is no rig file, no emulator file and no scenario")


def rig_model(rig: Rig) -> RigModel:
    """A rig file's numbers as the model that an identification starts from."""
    model: TankModel = rig.tank_model
    return RigModel(
        tanks=model,
        pumps=rig.pump_path,
        sensors=rig.level_sensors,
        lag_s=rig.lags_s,
        noise_V=of_all(rig.sensors.noise_V),
    )


def records_of(paths: tuple[Path, ...]) -> tuple[tuple[LevelRecord, ...], tuple[LevelRecord, ...]]:
    """The records of run folders: those to fit, and those that an experiment has held out.

    paths : of runs, and of experiments, which stand for their recorded phases. Raises RunFolderError when a folder
    can't be used.
    """
    fitted: list[LevelRecord] = []
    held_out: list[LevelRecord] = []
    found = [run for path in paths for run in recorded_runs(path)]
    runs = list({run.resolve(): run for run in found}.values())
    names = [run.name for run in runs]
    for path in runs:
        record = record_of_folder(path, read_readings(path))
        if names.count(path.name) > 1:  # of two experiments, for example
            record = replace(record, name=str(path))
        experiment = RunFolder.open(path).manifest().plan.settings.get("experiment", {})
        (held_out if experiment.get("is_held_out") else fitted).append(record)
    if not fitted:
        raise RunFolderError("no run to identify from: all of them are held out to judge the result")
    return tuple(fitted), tuple(held_out)
