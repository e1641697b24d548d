"""An experiment told once: as the files that the controller and the emulator read, and as numbers for the reference."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench import assembly, lockstep_run, run_options
from hil.edge.record.run_folder import RunFolder
from hil.review import ticks
from hil.review.kpi import Kpi
from hil.review.ticks import LoggedEvent

CONFIG = Path(__file__).resolve().parents[2] / "config"
SCENARIOS = CONFIG / "scenarios"

Pair = tuple[float, float]


@dataclass(frozen=True)
class Step:
    """A new reference at at_s: change_V, levels_V or levels_cm."""

    at_s: float
    kind: str
    values: Pair


@dataclass(frozen=True)
class Loss:
    """Pump target keeps the share `value` of its gain."""

    at_s: float
    target: int
    value: float
    until_s: float | None = None


@dataclass(frozen=True)
class Experiment:
    """What a scenario file says. rig, emulator : dotted keys to values, laid over the config files.

    is_ideal : no lag, noise, converters or rate limit, level frames at every control step, and no feedforward: the
    independent reference has none.
    """

    name: str
    duration_s: float
    steps: tuple[Step, ...] = ()
    losses: tuple[Loss, ...] = ()
    windows: tuple[tuple[str, float, float], ...] = ()
    design: str = "rig"
    delay_s: float = 1.0
    reconfigure: bool = True
    period_s: float = 0.01
    is_ideal: bool = True
    rig: dict[str, Any] = field(default_factory=dict)
    emulator: dict[str, Any] = field(default_factory=dict)

    def toml(self) -> str:
        """The scenario file."""
        lines = [
            "[scenario]",
            f'name = "{re.sub("[^A-Za-z0-9]+", "-", self.name)[:60]}"',
            f"duration_s = {self.duration_s}",
        ]
        for step in self.steps:
            lines += ["[[reference]]", f"at_s = {step.at_s}", f"{step.kind} = {list(step.values)}"]
        for loss in self.losses:
            lines += ["[[fault]]", f"at_s = {loss.at_s}", 'kind = "pump_effectiveness"']
            lines += [f"target = {loss.target}", f"value = {loss.value}"]
            lines += [] if loss.until_s is None else [f"until_s = {loss.until_s}"]
        lines += ["[diagnosis]", 'method = "ideal"', f"delay_s = {self.delay_s}"]
        lines += ["[control]", f"reconfigure = {json.dumps(self.reconfigure)}", f'design = "{self.design}"']
        lines += ["feedforward = false"] if self.is_ideal else []
        for name, from_s, to_s in self.windows:
            lines += ["[[window]]", f'name = "{name}"', f"from_s = {from_s}", f"to_s = {to_s}"]
        rig: dict[str, Any] = {"control.period_s": self.period_s}
        emulator: dict[str, Any] = {}
        if self.is_ideal:
            rig |= {"pumps.lag_s": 0.0, "pumps.rate_V_s": 10000.0, "sensors.noise_V": 0.0}
            emulator |= {"pumps.lag_s": 0.0, "pumps.dac_bits": 0, "sensors.noise_V": 0.0, "sensors.adc_bits": 0}
            emulator |= {"nodes.levels_period_s": self.period_s}
        for table, values in (("rig", rig | self.rig), ("emulator", emulator | self.emulator)):
            lines += [f"[{table}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
        return "\n".join(lines) + "\n"


PAPER_STEP_V = 0.314639362845011
PAPER = Experiment(
    name="paper_ideal",
    duration_s=500.0,
    steps=(Step(100.0, "change_V", (PAPER_STEP_V,) * 2), Step(350.0, "change_V", (PAPER_STEP_V,) * 2)),
    losses=(Loss(200.0, 1, 0.4), Loss(200.0, 2, 0.4)),
    windows=(("gain_fall", 200.0, 350.0), ("reference_step", 350.0, 500.0)),
    design="calibrated",
)
"""The paper's experiment; the shipped scenario files say the same."""


@dataclass(frozen=True, eq=False)
class Run:
    """What a run left behind. columns : ticks.csv by column name."""

    kpi: Kpi
    columns: dict[str, Any]
    events: tuple[LoggedEvent, ...]

    def levels_cm(self) -> Any:
        """(n, 4) true levels."""
        return np.column_stack([self.columns[f"true_h{tank}_cm"] for tank in (1, 2, 3, 4)])

    def pair(self, pattern: str) -> Any:
        """(n, 2) the columns of both outputs or pumps: pair("r{}_V")."""
        return np.column_stack([self.columns[pattern.format(i)] for i in (1, 2)])


def simulate(scenario: str, folder: Path, seed: int = 1) -> Run:
    """One run in lockstep. scenario : the file's text. folder : a new one, gone afterwards."""
    folder.mkdir(parents=True)
    path = folder / "scenario.toml"
    path.write_text(scenario, encoding="utf-8")
    kpi = lockstep_run.simulate(
        assembly.load(path, CONFIG), run_options.RunOptions(out=folder / "run", seed=seed, rerun=False)
    )
    table, events = ticks.read(RunFolder(folder / "run"))
    run = Run(kpi, {name: np.array(values) for name, values in table.columns.items()}, events)
    shutil.rmtree(folder)
    return run


def shipped(name: str, *, reconfigure: bool = True) -> str:
    """Text of a shipped scenario, with gains kept if so wanted."""
    text = (SCENARIOS / f"{name}.toml").read_text(encoding="utf-8")
    assert text.count("reconfigure = true") == 1
    return text if reconfigure else text.replace("reconfigure = true", "reconfigure = false")


def kept(experiment: Experiment) -> Experiment:
    """The same with gains that do not follow the diagnosis."""
    return replace(experiment, reconfigure=False, name=f"{experiment.name}_kept")
