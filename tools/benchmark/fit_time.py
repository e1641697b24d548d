"""How long `hil identify` computes on recorded phases: `python -m tools.benchmark.fit_time [--write]`.

What is timed is `identify`, all of it: fit, choice of the structure by a held-out record, intervals, null directions.
Rows are means of five readings, as `hil identify` takes them from a run.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import sqrt
from statistics import median

import numpy as np
from rich.console import Console

from hil.core.identification.__main__ import compile_ahead
from hil.core.identification.identify import identify
from hil.core.identification.parameters import RigModel, values_of, with_values
from hil.core.identification.records import LevelRecord, RulerReading
from hil.core.identification.result import Identification
from hil.core.identification.simulation import simulate
from tools.benchmark.tables import DOCUMENT, Section, as_rich, as_verdict, write
from tools.benchmark.timing import Effort

DURATION_S, HELD_OUT_S = 720.0, 160.0
PERIOD_S, MEAN_OF = 0.1, 5
TARGET_S = 20.0
EMPTY = (0.0, 0.0, 0.0, 0.0)
RICH = ("curve", "datum", "dead_zone", "delay", "sensor_gain", "sensor_offset")
STRUCTURES: Mapping[str, Sequence[str]] = {"basic": (), "all but overflow": RICH}
"""What the rigs have."""


def truth(seed: int, is_rich: bool) -> RigModel:
    """A rig up to 20 % off the shipped file; a rich one has all that a rig file can say."""
    random = np.random.default_rng(seed)
    values = values_of(RigModel())
    for name in values:
        if name.startswith(("k", "a", "lag")):
            values[name] *= random.uniform(0.8, 1.2)
        if name.startswith("gamma"):
            values[name] *= random.uniform(0.8, 1.1)
    rich = {"dead_zone1": 0.4, "dead_zone2": 0.7, "curve1": -0.01, "curve2": 0.01, "delay1": 0.2, "delay2": 0.3}
    rich |= {"datum1": 2.0, "datum2": 3.0, "datum3": 0.5, "datum4": 0.4}
    rich |= {"sensor_gain1": 0.52, "sensor_gain2": 0.49, "sensor_gain3": 0.48, "sensor_gain4": 0.51}
    rich |= {"sensor_offset1": 0.1, "sensor_offset2": 0.08, "sensor_offset3": 0.2, "sensor_offset4": 0.15}
    return with_values(RigModel(), values | (rich if is_rich else {}))


def record(rig: RigModel, seed: int, duration_s: float, *, with_ruler: bool, name: str = "12 min") -> LevelRecord:
    """From empty tanks: steps, then a binary sequence; with a ruler four levels are read, two of them twice."""
    random = np.random.default_rng(seed)
    voltage_V = np.zeros((round(duration_s / PERIOD_S), 2))
    at_s, steps = 5.0, [(5.0, 5.0), (4.0, 4.0), (5.0, 3.5), (3.5, 5.0), (6.0, 3.0), (3.0, 6.0)]
    while at_s < duration_s:
        hold_s = 50.0 if steps else float(random.choice([5.0, 10.0, 20.0, 30.0]))
        pair = steps.pop(0) if steps else tuple(random.choice([3.0, 5.0], 2))
        voltage_V[round(at_s / PERIOD_S) : round((at_s + hold_s) / PERIOD_S)] = pair
        at_s += hold_s
    n = len(voltage_V)
    blank = LevelRecord(name, np.arange(n, dtype=float) * PERIOD_S, voltage_V, np.zeros((n, 4)), initial_cm=EMPTY)
    predicted = simulate(rig, blank, EMPTY)
    noise_V = 0.005 / sqrt(MEAN_OF) * random.standard_normal((n, 4))
    rows = [(round(100.0 / PERIOD_S), tank) for tank in range(4)] + [(round(300.0 / PERIOD_S), tank) for tank in (0, 1)]
    ruler = tuple(
        RulerReading(float(blank.time_s[row]), tank, float(predicted.level_cm[row, tank]) + 0.1 * random.normal())
        for row, tank in rows
        if with_ruler
    )
    return replace(
        blank,
        reading_V=np.clip(predicted.predicted_V + noise_V, 0.0, 10.2375),
        samples=np.full((n, 4), float(MEAN_OF)),
        saturation_V=(0.0, 10.24),
        ruler=ruler,
    )


def worst_sd(found: Identification, rig: RigModel) -> float:
    """By how many standard deviations the worst parameter is off."""
    true = values_of(rig)
    return max(abs(one.value - true[one.name]) / one.sd for one in found.parameters if one.status == "identified")


def fit_time(seeds: Sequence[int]) -> Section:
    """Time and error of an identification from the shipped rig file, by what the rig has."""
    compile_ahead()
    rows = []
    for name, structure in STRUCTURES.items():
        took, worked, errors, right = [], [], [], 0
        for seed in seeds:
            rig = truth(seed, bool(structure))
            made = record(rig, seed, DURATION_S, with_ruler=bool(structure))
            judge = record(rig, seed + 1000, HELD_OUT_S, with_ruler=False, name="held out")
            started, at_work = time.perf_counter(), time.process_time()
            found = identify([made], RigModel(), held_out=judge)
            took.append(time.perf_counter() - started)
            worked.append(time.process_time() - at_work)
            errors.append(worst_sd(found, rig))
            right += set(found.structure) == set(structure)
        times = (f"{median(took):.1f} s", f"{max(took):.1f} s", f"{median(worked):.1f} s")
        rows.append(
            (name, *times, f"{right} of {len(seeds)}", f"{max(errors):.1f}", as_verdict(max(worked) < TARGET_S))
        )
    note = (
        f"What `hil identify` computes: fit, structure, intervals. A record of 12 minutes of a rig up to 20 % off the "
        f"file and {HELD_OUT_S:.0f} s held out, four levels with 5 mV of noise, from the shipped file; {len(seeds)} "
        f"drawn rigs each. Worst error: of any parameter of any rig, in standard deviations. Target: "
        f"{TARGET_S:.0f} s of processor time."
    )
    columns = ("rig", "median", "longest", "CPU time", "right structure", "worst error", "verdict")
    return Section("Time of an identification", note, columns, rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser("python -m tools.benchmark.fit_time", description=__doc__)
    parser.add_argument("--write", action="store_true", help="put the figures into docs/reference/benchmarks.md")
    parser.add_argument("--rigs", type=int, default=5, help="number of drawn rigs")
    options = parser.parse_args(arguments)
    section = fit_time(range(1, options.rigs + 1))
    console = Console(width=120)
    console.print(as_rich(section), section.note, "")
    if options.write:
        write([section], Effort(runs=options.rigs, rounds=1), "identification")
        console.print(f"written to {DOCUMENT.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
