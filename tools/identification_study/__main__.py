"""`python -m tools.identification_study --kind basic|rich|rigs --seeds N --first-seed S`.

basic: the default rig, k, gamma, a within 20 %, lags within 50 %. rich: beyond that curves, dead zones, datums, sensors
with gains and offsets of their own, and waves of 2 mV; six readings by a ruler near the top. rigs: those of
config/rigs, with a ruler. Always started from the default file, with the cross-sections and heights of the rig's own
tanks. Prints for each parameter the errors, how often the 95 % interval covered and the RMS of error over standard
deviation; and how often the structure was right.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from firmware_sim.setting_types import parts
from hil.core.identification.identify import identify
from hil.core.identification.parameters import RigModel
from hil.core.identification.result import Identification
from hil.core.tanks import TankModel
from tools.identification_study.truth import (
    Truth,
    basic_truth,
    experiment_plan,
    held_out_plan,
    rich_truth,
    rig_truth,
    ruler_plan,
    ruler_times,
    run_experiment,
)
from tools.identification_study.wire import wire_records

RIGS = ("johansson_minus", "johansson_plus", "decenter2021")
HELD_OUT_SEED = 100_000
STRUCTURES = {"basic": (), "rich": ("dead_zone", "curve", "datum", "sensor_gain", "sensor_offset")}


@dataclass(frozen=True)
class Case:
    """One rig and what was found."""

    name: str
    truth: Truth
    found: Identification
    duration_s: float
    expected: tuple[str, ...] | None


def run_case(
    kind: str, seed: int, *, turbulence: float = 0.0, wave_V: float = 0.0, rig: str = "", is_wire: bool = False
) -> Case:
    """Draw a rig, do the experiment and a held-out one, and identify it. is_wire : by `hil identify`'s own plan."""
    with_ruler = bool(rig) or kind == "rich"
    if rig:
        truth = rig_truth(rig)
    elif kind == "rich":
        truth = rich_truth(seed)
    else:
        truth = basic_truth(seed, turbulence=turbulence, wave_V=wave_V)
    if is_wire:
        records, held_out = wire_records(truth, seed, is_full=kind == "rich", with_ruler=with_ruler)
    else:
        plan = [*experiment_plan(truth, seed), *(ruler_plan(truth) if with_ruler else [])]
        records = [run_experiment(truth, plan, seed, ruler=ruler_times(plan) if with_ruler else ())]
        held_out = [run_experiment(truth, held_out_plan(truth, seed), seed + HELD_OUT_SEED, name="held out")]
    began_s = time.monotonic()
    found = identify(records, file_of(truth), held_out=held_out)
    return Case(rig or f"seed {seed}", truth, found, time.monotonic() - began_s, STRUCTURES.get(kind))


def file_of(truth: Truth) -> RigModel:
    """The default file, with the cross-sections and heights of the rig's tanks: those anybody can measure."""
    tanks = truth.settings.tanks
    h1, h2, h3, h4 = parts(tanks.height_cm, 4)
    return RigModel(tanks=TankModel(area_cm2=tanks.area_cm2, height_cm=(h1, h2, h3, h4)))


def parameter_table(cases: Sequence[Case]) -> Table:
    """One row for each parameter that was free in any case."""
    table = Table(title=f"{len(cases)} rigs")
    for head in ("parameter", "rigs", "median error", "95 % error", "largest error", "covered", "RMS error / sd"):
        table.add_column(head, justify="left" if head == "parameter" else "right")
    names = dict.fromkeys(one.name for case in cases for one in case.found.parameters if one.status == "identified")
    for name in names:
        found = [
            (case.found[name], case.truth.value(name)) for case in cases if case.found[name].status == "identified"
        ]
        errors = np.array([abs(one.value - true) for one, true in found])
        is_relative = all(abs(true) > 1e-9 for _, true in found)
        shown = (
            np.array([100.0 * e / abs(t) for e, (_, t) in zip(errors, found, strict=True)]) if is_relative else errors
        )
        unit = "%" if is_relative else found[0][0].unit
        covered = np.mean([one.low <= true <= one.high for one, true in found])
        ratio = np.sqrt(np.mean([((one.value - true) / max(one.sd, 1e-12)) ** 2 for one, true in found]))
        numbers = (np.median(shown), np.quantile(shown, 0.95), np.max(shown))
        table.add_row(
            name,
            str(len(found)),
            *(f"{value:.3g} {unit}" for value in numbers),
            f"{100.0 * covered:.0f} %",
            f"{ratio:.2f}",
        )
    return table


def summary(cases: Sequence[Case]) -> list[str]:
    """Structure, coverage and held-out error over all cases, in sentences."""
    told = [case for case in cases if not case.found.refusal]
    lines = [f"identified: {len(told)} of {len(cases)}"]
    lines += [f"{case.name}: refused: {case.found.refusal}" for case in cases if case.found.refusal]
    judged = [case for case in told if case.expected is not None]
    if judged:
        right = [case for case in judged if set(case.found.structure) == set(case.expected or ())]
        lines.append(f"right structure: {len(right)} of {len(judged)}")
        lines += [f"{case.name}: {', '.join(case.found.structure)}" for case in judged if case not in right]
    if told:
        covered = [
            one.low <= case.truth.value(one.name) <= one.high
            for case in told
            for one in case.found.parameters
            if one.status == "identified"
        ]
        lines.append(f"intervals that cover: {100.0 * np.mean(covered):.1f} % of {len(covered)}")
        share = [
            abs(one.value / case.truth.value(one.name) - 1.0)
            for case in told
            for one in case.found.parameters
            if one.name[:-1] in ("k", "gamma", "a") and one.status == "identified"
        ]
        lines.append(f"k, gamma, a: largest error {100.0 * max(share):.3g} %, within 0.5 %: {_within(told, 0.005)}")
        worst_V = max(max(case.found.holdout_rmse_V) for case in told)
        lines.append(f"largest held-out RMSE: {1000.0 * worst_V:.2f} mV")
        lines.append(f"time for one: {np.median([case.duration_s for case in told]):.1f} s (median)")
    return lines


def _within(cases: Sequence[Case], limit: float) -> str:
    """Of how many rigs all of k, gamma and a are within this share of the truth."""
    names = [f"{group}{i}" for group, count in (("k", 2), ("gamma", 2), ("a", 4)) for i in range(1, count + 1)]
    right = [
        case for case in cases if all(abs(case.found[n].value / case.truth.value(n) - 1.0) <= limit for n in names)
    ]
    return f"{len(right)} of {len(cases)} rigs"


def main() -> None:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(prog="python -m tools.identification_study", description=__doc__)
    parser.add_argument("--kind", choices=("basic", "rich", "rigs"), default="basic")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--wire", action="store_true", help="the experiment of hil identify --emulator; not for rigs")
    parser.add_argument("--turbulence", type=float, default=0.0, help="cm3/sqrt(s), of basic rigs")
    parser.add_argument("--wave", type=float, default=0.0, help="V, of basic rigs")
    options = parser.parse_args()
    console, cases = Console(width=110), []
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for seed in seeds:
        for rig in RIGS if options.kind == "rigs" else ("",):
            is_wire = options.wire and not rig
            case = run_case(
                options.kind, seed, turbulence=options.turbulence, wave_V=options.wave, rig=rig, is_wire=is_wire
            )
            cases.append(case)
            structure = ", ".join(case.found.structure) or "basic"
            print(f"{case.name}: {case.found.refusal or structure} ({case.duration_s:.1f} s)", flush=True)
    console.print(parameter_table(cases))
    for line in summary(cases):
        console.print(line)
    if options.kind == "rigs":
        for case in cases[: len(RIGS)]:
            console.print(f"{case.name}: structure {', '.join(case.found.structure) or 'basic'}")
            console.print(parameter_table([case]))


if __name__ == "__main__":
    main()
