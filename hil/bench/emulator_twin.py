"""The emulator for a bench. Its settings errors become `hil`'s own, so that a caller catches one class."""

from __future__ import annotations

from firmware_sim import settings as emulator_settings
from firmware_sim.rig import Rig as Emulator
from hil.bench.assembly import Bench
from hil.edge.config.settings_file import SettingsError


def emulator_of(bench: Bench, seed: int) -> Emulator:
    """The emulator that plays the scenario's faults; `seed` is of its noise. Raises SettingsError."""
    try:
        truth, faults = emulator_settings.load(bench.emulator_path, bench.scenario_path, bench.rig_file)
        return Emulator(truth, faults, seed, emulator_settings.load_fingerprint(bench.dbc_path))
    except emulator_settings.SettingsError as error:
        raise SettingsError(str(error)) from None
