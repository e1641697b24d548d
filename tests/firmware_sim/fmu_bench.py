"""Helpers of the unit's tests: a unit made once for a rig, driven beside the emulator, and their differences."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt
from fmpy import fmi2

from firmware_sim import pump_node
from firmware_sim.faults import Fault
from firmware_sim.fmu.archive import archive
from firmware_sim.fmu.variables import variables
from firmware_sim.rig import Rig
from firmware_sim.settings import EmulatorSettings
from firmware_sim.tanks import Tanks
from tests.firmware_sim.fault_bench import START
from tests.firmware_sim.sim_bench import SECOND, command

STEP_NS = 100_000_000
Voltages = Callable[[float], tuple[float, float]]
LEVELS = tuple(f"true_h{n}_cm" for n in (1, 2, 3, 4))
VOLUMES = ("pumped_cm3", "drained_cm3", "spilled_cm3", "caught_cm3")
NAMES = (*LEVELS, *VOLUMES)
Floats = npt.NDArray[np.float64]


@dataclass
class UnitFile:
    """A unit on disk, unpacked. instances : counter for names."""

    file: Path
    folder: Path
    description: Any = None
    instances: Iterator[int] = field(default_factory=lambda: itertools.count(1))

    @classmethod
    def made(cls, settings: EmulatorSettings, folder: Path) -> UnitFile:
        file = folder / "rig.fmu"
        file.write_bytes(archive(settings))
        fmpy.extract(str(file), str(folder / "unpacked"))
        return cls(file, folder / "unpacked", fmpy.read_model_description(str(file)))

    def number(self, name: str) -> int:
        return next(int(one.valueReference) for one in self.description.modelVariables if one.name == name)

    @contextmanager
    def instance(self) -> Iterator[Instance]:
        """An instance that is set up but not initialized; freed at the end."""
        slave = fmi2.FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(self.folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=f"unit {next(self.instances)}",
        )
        messages: list[str] = []
        slave.instantiate(callbacks=_callbacks(messages))
        slave.setupExperiment(startTime=0.0)
        try:
            yield Instance(self, slave, messages)
        finally:
            slave.freeInstance()


def _callbacks(messages: list[str]) -> Any:
    def keep(_environment: Any, _name: bytes, _status: int, _category: bytes, message: bytes) -> None:
        messages.append(message.decode())

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(keep)
    callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
    callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
    return callbacks


@dataclass
class Instance:
    """An instance, by names of variables. messages : what it has refused."""

    unit: UnitFile
    slave: Any
    messages: list[str]

    def set(self, **values: float) -> None:
        self.slave.setReal([self.unit.number(name) for name in values], list(values.values()))

    def get(self, *names: str) -> list[float]:
        values: list[float] = self.slave.getReal([self.unit.number(name) for name in names])
        return values

    def start(self, **values: float) -> Instance:
        """Initialize with these values."""
        self.slave.enterInitializationMode()
        self.set(**values)
        self.slave.exitInitializationMode()
        return self

    def step(self, from_ns: int, to_ns: int) -> None:
        self.slave.doStep(currentCommunicationPoint=from_ns / SECOND, communicationStepSize=(to_ns - from_ns) / SECOND)


@dataclass(frozen=True)
class Change:
    """Inputs that change at a moment of the scenario, in ns."""

    at_ns: int
    values: dict[str, float]


def run_unit(instance: Instance, changes: Sequence[Change], samples_ns: Sequence[int], names: Sequence[str]) -> Floats:
    """The values of these outputs at the samples, (samples, names); inputs change at their moments."""
    moments = sorted({*samples_ns, *(change.at_ns for change in changes if change.at_ns <= samples_ns[-1])})
    rows, now_ns = [], 0
    for moment_ns in moments:
        if moment_ns > now_ns:
            instance.step(now_ns, moment_ns)
            now_ns = moment_ns
        if moment_ns in samples_ns:
            rows.append(instance.get(*names))
        for change in changes:
            if change.at_ns == moment_ns:
                instance.set(**change.values)
    return np.array(rows)


@dataclass(frozen=True)
class Truths:
    """A run of the emulator: levels and volumes, (samples, 8), and what its pump node put out, from scenario time 0."""

    samples_ns: list[int]
    values: Floats
    changes: list[Change]


def run_rig(
    settings: EmulatorSettings,
    faults: Sequence[Fault],
    voltages: Voltages,
    end_s: float,
) -> Truths:
    """Drive the emulator by commands every 0.1 s."""
    changes: list[Change] = []

    def note(change: pump_node.Change) -> None:
        if change.node == "pump" and change.applied_V and change.t_ns >= START:
            v1, v2 = change.applied_V
            changes.append(Change(change.t_ns - START, {"v1_applied_V": v1, "v2_applied_V": v2}))

    rig = Rig(settings, tuple(faults), 1, 0xDEADBEEF, note)
    rows, samples = [], []
    for number in range(round(end_s * SECOND) // STEP_NS + 1):
        now_ns = number * STEP_NS
        rig.advance(START + now_ns)
        rows.append(values_of(rig._tanks_now()))
        samples.append(now_ns)
        rig.receive(command(*voltages(now_ns / SECOND), counter=number % 16), START + now_ns)
    assert rig.start_ns == START
    return Truths(samples, np.array(rows), changes)


def values_of(tanks: Tanks) -> list[float]:
    return [*tanks.levels_cm, tanks.pumped_cm3, tanks.drained_cm3, tanks.spilled_cm3, tanks.caught_cm3]


def rig_values(settings: EmulatorSettings) -> dict[str, float]:
    """The parameters and inputs of a unit that make it another rig."""
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


def at_2_s(**inputs: float) -> list[Change]:
    return [Change(2 * SECOND, inputs)]
