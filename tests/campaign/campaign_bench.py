"""Helpers of the campaign tests: short scenarios, campaign files, made-up rows."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.bench.campaign_case import rig_numbers
from hil.campaigns import outcome
from hil.campaigns.cases import Case, expand, with_overlay
from hil.campaigns.observer import COLUMNS, Observations
from hil.campaigns.outcome import Rest, RigFigures, crash
from hil.campaigns.row import Elapsed, Row
from hil.campaigns.spec import Spec, load_spec
from hil.edge.config.settings_file import read_toml
from hil.loop import Outcome as Ending

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"

SHORT = """[scenario]
name = "short"
duration_s = 12.0

[[fault]]
at_s = 4.05
kind = "pump_effectiveness"
target = 1
value = 0.4

[diagnosis]
method = "ideal"
delay_s = 1.0

[[window]]
name = "loss"
from_s = 4.0
to_s = 10.0
"""

GRID = """[campaign]
name = "grid"
scenarios = ["short.toml"]
first_seed = 5
seeds = 3

[emulator]
parameter_spread = 0.03

[diagnosis]
delay_s = 0.5

[[fault]]
kind = "pump_effectiveness"
targets = [1, 2, [1, 2]]
values = [0.4, 0.8]
onset_s = [3.0, 4.0]
lasts_s = 5.0
"""

PAIRS = """
[pairs]
onset_s = [3.0, 6.0]

[[pairs.pool]]
kind = "pump_effectiveness"
targets = [1, 2]
value_range = [0.1, 0.9]

[[pairs.pool]]
kind = "sensor_bias"
targets = [1, 2, 3, 4]
value_range = [-0.5, 0.5]

[[pairs.pool]]
kind = "sensor_stuck"
targets = [1, 2, 3, 4]
"""

RIG = RigFigures(
    windows=(), period_s=0.1, rate_V_s=20.0, height_cm=(20.0,) * 4, level_gain_V_cm=0.5, valve_split=(0.7, 0.6)
)
REST = Rest(spilled_cm3=0.0, applied_V=(0.0, 0.0))
COMPLETE = Ending("complete", "", 10.0, 100, 0, 0)
FAULTY = Case("k", "leak 1 = 0.2", "s", 1, {"fault": [{"kind": "leak", "target": 1, "value": 0.2, "at_s": 4.0}]})


def campaign_file(folder: Path, text: str = GRID) -> Path:
    """A campaign file with its scenario beside it."""
    (folder / "short.toml").write_text(SHORT)
    file = folder / "grid.toml"
    file.write_text(text)
    return file


def cases_of(file: Path, digest: str = "") -> tuple[Case, ...]:
    spec, files = load_spec(file)
    scenarios = [read_toml(path) for path in files]
    rigs = [] if spec.draw is None else [rig_numbers(undrawn(spec, data), CONFIG, str(file)) for data in scenarios]
    return expand(spec, scenarios, digest, rigs)


def undrawn(spec: Spec, scenario_data: dict[str, Any]) -> Case:
    """A case of the spec without what it draws."""
    return Case("", "", "", 0, with_overlay(spec, scenario_data))


def first_case(file: Path) -> Case:
    return cases_of(file)[0]


def row(**changes: Any) -> Row:
    """A healthy run without a fault, but for the changes."""
    plain = crash(Case("key", "no fault", "short", 1, {}), RuntimeError(), Elapsed(2.0, 1.0))
    plain = replace(plain, crashed=False, broken="", status="complete", reason="", hours=0.5, healthy_h=0.5, steps=1000)
    return replace(plain, **changes)


def without_times(rows: list[Row]) -> list[dict[str, Any]]:
    """Rows by key, without what no two runs have in common."""
    plain = [{**asdict(one), "wall_s": None, "cpu_s": None} for one in rows]
    return sorted(plain, key=lambda one: str(one["key"]))


def seen(steps: int = 100, **columns: float | npt.NDArray[Any]) -> Observations:
    """A run at rest at 3 V and 10 cm, but for the columns given."""
    healthy: dict[str, float | npt.NDArray[Any]] = {
        "t_s": np.arange(steps) * 0.1,
        "r1_V": 5.0,
        "r2_V": 5.0,
        "v1_V": 3.0,
        "v2_V": 3.0,
    }
    healthy |= {f"h{tank}_cm": 10.0 for tank in (1, 2, 3, 4)} | {"accepted": np.arange(steps), "e1": 1.0, "e2": 1.0}
    healthy |= {"true_e1": 1.0, "true_e2": 1.0}
    table = np.empty((steps, len(COLUMNS)))
    for name, values in {**healthy, **columns}.items():
        table[:, COLUMNS.index(name)] = values
    return Observations(table, (), "", "")


def judged(
    observations: Observations,
    case: Case = FAULTY,
    rest: Rest = REST,
    bench: RigFigures = RIG,
    ending: Ending = COMPLETE,
) -> Row:
    """The run's row."""
    return outcome.evaluate(case, bench, observations, ending, rest, elapsed=Elapsed(1.0, 1.0))
