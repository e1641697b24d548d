"""Figures of the control loop at reference steps and at a loss: `python -m tools.control_table [--seeds 8]`.

The default rig, 3 % drawn parameters, pump lag 0.2 s, 5 mV noise, 12 bit, 0.1 s. One line for each variant of the
control choices; each figure is the median over the seeds, outputs 1 and 2. IAE is that of the reference asked for and
the true level, over 100 s after a step and 150 s after the loss.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import hil
from hil.campaigns.toml_text import toml_text
from hil.review.step_response import SETTLED_V

Floats = NDArray[np.float64]

STEP_V = 0.3146394
"""The paper's step of both references."""

AT_S = 60.0
STEP_S, LOSS_S = 100.0, 150.0
REST_S = (20.0, AT_S)
FIRST_SEED = 50_001
GAIN_V_CM = 0.5

VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "rig design": {},
    "no feedforward": {"feedforward": False},
    "gains kept": {"reconfigure": False},
}


@dataclass(frozen=True)
class Change:
    """What happens at at_s, and for how long it is judged. step_V : of both references, 0 for a fault."""

    name: str
    at_s: float
    length_s: float
    step_V: float = 0.0


@dataclass(frozen=True, eq=False)
class Figures:
    """Of one change: (2,) IAE in V s, overshoot in % of the step, time until within 20 mV in s."""

    iae_Vs: Floats
    overshoot: Floats
    settled_s: Floats


BOTH = [{"at_s": AT_S + STEP_S, "kind": "pump_effectiveness", "target": pump, "value": 0.4} for pump in (1, 2)]
SCENARIOS: tuple[tuple[tuple[Change, ...], list[dict[str, Any]]], ...] = (
    (
        (
            Change("0.315 V step", AT_S, STEP_S, STEP_V),
            Change("both -60 %", AT_S + STEP_S, LOSS_S),
            Change("next step", AT_S + STEP_S + LOSS_S, STEP_S, STEP_V),
        ),
        BOTH,
    ),
    ((Change("+1 V", AT_S, STEP_S, 1.0),), []),
    ((Change("-1 V", AT_S, STEP_S, -1.0),), []),
    ((Change("pump 1 -60 %", AT_S, LOSS_S),), [{**BOTH[0], "at_s": AT_S}]),
)


def scenario(changes: Sequence[Change], faults: Sequence[dict[str, Any]], control: Mapping[str, Any]) -> dict[str, Any]:
    """A scenario file as a dict."""
    steps = [change for change in changes if change.step_V]
    return {
        "scenario": {"name": "control_table", "duration_s": changes[-1].at_s + changes[-1].length_s},
        "reference": [{"at_s": step.at_s, "change_V": [step.step_V, step.step_V]} for step in steps],
        "fault": list(faults),
        "control": dict(control),
        "window": [
            {"name": f"w{index}", "from_s": change.at_s, "to_s": change.at_s + change.length_s}
            for index, change in enumerate(changes)
        ],
        "emulator": {"parameter_spread": 0.03},
    }


def figures(result: hil.RunResult, change: Change, index: int) -> Figures:
    """Of one change in a run; infinite for one that the run did not reach."""
    t_s = result.series["t_s"]
    error = np.stack([GAIN_V_CM * result.series[f"true_h{i}_cm"] - result.series[f"r{i}_V"] for i in (1, 2)], axis=1)
    during = (t_s >= change.at_s) & (t_s < change.at_s + change.length_s)
    if result.status != "complete" or not during.any():
        return Figures(np.full(2, np.inf), np.full(2, np.inf), np.full(2, np.inf))
    at_rest = (t_s >= change.at_s - 20.0) & (t_s < change.at_s)
    jitter = np.abs(error[at_rest]).max(axis=0)
    overshoot = np.full(2, np.nan)
    if change.step_V:
        beyond = (np.sign(change.step_V) * error[during]).max(axis=0) - jitter
        overshoot = 100.0 * np.maximum(beyond, 0.0) / abs(change.step_V)
    settled = []
    for output in (0, 1):
        away = np.flatnonzero(np.abs(error[during, output]) > SETTLED_V)
        settled.append(t_s[during][away[-1]] - change.at_s if away.size else 0.0)
    return Figures(np.array(result.iae_Vs[f"w{index}"]), overshoot, np.array(settled))


def command_noise(result: hil.RunResult) -> Floats:
    """(2,) standard deviation of the commands at rest, from their differences over a second, V."""
    t_s = result.series["t_s"]
    at_rest = (t_s >= REST_S[0]) & (t_s < REST_S[1])
    commands = np.stack([result.series["v1_V"], result.series["v2_V"]], axis=1)[at_rest]
    lines = np.stack([np.ones(len(commands)), np.arange(len(commands))], axis=1)
    fitted = lines @ np.linalg.lstsq(lines, commands, rcond=None)[0]
    return np.asarray((commands - fitted).std(axis=0))


def measure(control: Mapping[str, Any], seeds: Sequence[int]) -> tuple[dict[str, list[Figures]], list[Floats]]:
    """Figures of every change by name, one for each seed, and the noise of the commands."""
    found: dict[str, list[Figures]] = {}
    noise = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (changes, faults) in enumerate(SCENARIOS):
            path = Path(folder) / f"scenario{number}.toml"
            path.write_text(toml_text(scenario(changes, faults, control)), encoding="utf-8")
            bench = hil.load(path)
            for seed in seeds:
                result = hil.simulate(bench, seed=seed)
                noise.append(command_noise(result))
                for index, change in enumerate(changes):
                    found.setdefault(change.name, []).append(figures(result, change, index))
    return found, noise


def _pair(values: Sequence[Floats], digits: int = 2, *, worst: bool = False) -> str:
    table = np.array(values)
    first, second = table.max(axis=0) if worst else np.median(table, axis=0)
    return f"{first:.{digits}f}/{second:.{digits}f}"


def row(found: Mapping[str, list[Figures]], noise: Sequence[Floats]) -> list[str]:
    """The cells of a variant."""
    cells = [_pair([f.iae_Vs for f in each]) for each in found.values()]
    steps = [f for each in found.values() for f in each if not np.isnan(f.overshoot).any()]
    settled = [f.settled_s for f in found["0.315 V step"]]
    overshoot = np.array([f.overshoot for f in steps])
    return [
        *cells,
        f"{np.median(overshoot.max(axis=1)):.1f} / {overshoot.max():.1f}",
        _pair(settled, 1, worst=True),
        f"{1000.0 * np.median(np.array(noise).max(axis=1)):.1f}",
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser("python -m tools.control_table", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=8, help="how many rigs are drawn")
    parser.add_argument("variants", nargs="*", help=f"of {', '.join(VARIANTS)}; none: all")
    options = parser.parse_args(arguments)
    names = [change.name for changes, _ in SCENARIOS for change in changes]
    table = Table(title=f"IAE y1/y2 in V s, median of {options.seeds} drawn rigs", title_justify="left")
    for column in ("", *names, "overshoot, % (median / worst)", "within 20 mV, s (worst)", "command noise, mV"):
        table.add_column(column)
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    for name in options.variants or VARIANTS:
        table.add_row(name, *row(*measure(VARIANTS[name], seeds)))
    Console(width=170).print(table)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
