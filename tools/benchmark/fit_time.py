"""How long a fit takes: `python -m tools.benchmark.fit_time [--write]`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median

import numpy as np
from rich.console import Console

from hil.core.identification.fit import Fit, fit
from hil.core.identification.parameters import Choice, RigModel, values_of, with_values
from hil.core.identification.records import LevelRecord, RulerReading
from hil.core.identification.simulation import simulate
from tools.benchmark.tables import DOCUMENT, Section, as_rich, as_verdict, write
from tools.benchmark.timing import Effort

DURATION_S = 720.0
TARGET_S = 20.0
EMPTY = (0.0, 0.0, 0.0, 0.0)
FREE = Choice("free")
STRUCTURES: Mapping[str, Mapping[str, Choice]] = {
    "basic": {},
    "all but overflow": dict.fromkeys(("dead_zone", "curve", "delay", "datum", "sensor_gain", "sensor_offset"), FREE),
}


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


def record(rig: RigModel, seed: int, period_s: float) -> LevelRecord:
    """12 minutes from empty: steps, then a binary sequence; four levels are read by a ruler."""
    random = np.random.default_rng(seed)
    voltage_V = np.zeros((round(DURATION_S / period_s), 2))
    at_s, steps = 5.0, [(5.0, 5.0), (4.0, 4.0), (5.0, 3.5), (3.5, 5.0), (6.0, 3.0), (3.0, 6.0)]
    while at_s < DURATION_S:
        hold_s = 50.0 if steps else float(random.choice([5.0, 10.0, 20.0, 30.0]))
        pair = steps.pop(0) if steps else tuple(random.choice([3.0, 5.0], 2))
        voltage_V[round(at_s / period_s) : round((at_s + hold_s) / period_s)] = pair
        at_s += hold_s
    n = len(voltage_V)
    blank = LevelRecord("12 min", np.arange(n, dtype=float) * period_s, voltage_V, np.zeros((n, 4)), initial_cm=EMPTY)
    predicted = simulate(rig, blank, EMPTY)
    noise_V = 0.005 * random.standard_normal((n, 4))
    reading_V = np.clip(np.round((predicted.predicted_V + noise_V) / 0.0025) * 0.0025, 0.0, 10.2375)
    rows = [(round(100.0 / period_s), tank) for tank in range(4)] + [(round(300.0 / period_s), tank) for tank in (0, 1)]
    ruler = tuple(
        RulerReading(float(blank.time_s[row]), tank, float(predicted.level_cm[row, tank]) + 0.1 * random.normal())
        for row, tank in rows
    )
    return replace(blank, reading_V=reading_V, saturation_V=(0.0, 10.24), ruler=ruler)


def worst_sd(found: Fit, rig: RigModel) -> float:
    """By how many standard deviations the worst parameter is off."""
    true, sd = values_of(rig), np.sqrt(np.diag(found.covariance()))
    return max(float(abs(found[name] - true[name]) / sd[found.names.index(name)]) for name in found.parameters)


def fit_time(seeds: Sequence[int]) -> Section:
    """Time, simulations and error of a fit from the shipped rig file, by structure and rows."""
    fit([record(truth(0, False), 0, 1.0)], RigModel())  # compiles what is not compiled yet
    rows = []
    for name, choices in STRUCTURES.items():
        for period_s in (0.1, 0.02):
            took, worked, counts, errors = [], [], [], []
            for seed in seeds:
                rig = truth(seed, name != "basic")
                made = record(rig, seed, period_s)
                started, at_work = time.perf_counter(), time.process_time()
                found = fit([made], RigModel(), choices)
                took.append(time.perf_counter() - started)
                worked.append(time.process_time() - at_work)
                counts.append(found.evaluations)
                errors.append(worst_sd(found, rig))
            what = f"{name}, {1.0 / period_s:.0f} Hz"
            times = (f"{median(took):.1f} s", f"{max(took):.1f} s", f"{median(worked):.1f} s")
            numbers = (f"{median(counts):.0f}", f"{max(errors):.1f}")
            rows.append((what, str(len(found.names)), *times, *numbers, as_verdict(max(took) < TARGET_S)))
    note = (
        f"A record of 12 minutes of a rig up to 20 % off the file, four levels with 5 mV of noise, from the shipped "
        f"file; {len(seeds)} drawn rigs each. Simulations: how often the record was simulated with its derivatives. "
        f"Worst error: of any parameter of any rig, in standard deviations. Target: {TARGET_S:.0f} s."
    )
    columns = ("structure, rows", "unknowns", "median", "longest", "CPU time", "simulations", "worst error", "verdict")
    return Section("Fit of a rig's parameters", note, columns, rows)


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
