"""The co-simulation unit beside the emulator: other people's FMI reader drives it, the levels are the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from firmware_sim.faults import Fault
from firmware_sim.settings import EmulatorSettings, equilibrium_cm
from tests.firmware_sim.fault_bench import fault
from tests.firmware_sim.fmu_bench import LEVELS, VOLUMES, Change, UnitFile, run_rig, run_unit
from tests.firmware_sim.sim_bench import SECOND, shipped

Voltages = Callable[[float], tuple[float, float]]
NAMES = (*LEVELS, *VOLUMES)


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> UnitFile:
    """The unit of emulator.toml; other rigs are made of it by its parameters."""
    return UnitFile.made(shipped(), tmp_path_factory.mktemp("unit"))


def rig_values(settings: EmulatorSettings) -> dict[str, float]:
    """The parameters and inputs of a unit that make it another rig."""
    from firmware_sim.fmu.variables import variables

    return {one.name: one.start for one in variables(settings) if one.start is not None}


def moved(t_s: float) -> tuple[float, float]:
    """Voltages that change at every step, through the whole range."""
    return 5.0 + 4.0 * np.sin(0.9 * t_s), (3.0, 0.4, 9.5)[int(t_s / 4.0) % 3]


def largest_difference(
    unit: UnitFile,
    settings: EmulatorSettings,
    voltages: Voltages,
    end_s: float,
    faults: list[tuple[Fault, list[Change]]] | None = None,
) -> Any:
    """Largest difference of every level and volume, (8,), between emulator and unit."""
    pairs = faults or []
    truth = run_rig(settings, [one for one, _ in pairs], voltages, end_s)
    changes = [*truth.changes, *(change for _, changes in pairs for change in changes)]
    with unit.instance() as instance:
        instance.start(**rig_values(settings))
        values = run_unit(instance, changes, truth.samples_ns, NAMES)
    return np.abs(values - truth.values).max(axis=0)


def test_an_fmi_checker_finds_nothing_wrong(unit: UnitFile) -> None:
    assert validate_fmu(str(unit.file)) == []


def test_the_unit_starts_where_the_emulator_does(unit: UnitFile) -> None:
    with unit.instance() as instance:
        assert instance.start().get(*LEVELS) == pytest.approx(equilibrium_cm(shipped()), abs=1e-12)


def test_levels_and_volumes_are_those_of_the_emulator(unit: UnitFile) -> None:
    assert largest_difference(unit, shipped(), moved, 30.0).max() < 1e-6


def test_a_fault_input_acts_as_the_fault_of_the_emulator(unit: UnitFile) -> None:
    change = Change(2 * SECOND, {"effectiveness1": 0.4})
    healthy = run_rig(shipped(), [], moved, 10.0)
    faulty = [(fault("pump_effectiveness", 1, 0.4, at_s=2.0), [change])]
    assert largest_difference(unit, shipped(), moved, 10.0, faulty).max() < 1e-6
    with unit.instance() as instance:
        values = run_unit(instance.start(), [*healthy.changes, change], healthy.samples_ns, LEVELS)
    assert np.abs(values - healthy.values[:, :4]).max() > 1.0


def test_the_archive_is_the_same_whenever_it_is_made(unit: UnitFile, tmp_path: Path) -> None:
    assert UnitFile.made(shipped(), tmp_path).file.read_bytes() == unit.file.read_bytes()
