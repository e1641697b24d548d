"""Speed of a whole lockstep run, and where its time is spent."""

from __future__ import annotations

import cProfile
import pstats
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from statistics import median
from typing import Any

from hil.bench import assembly, lockstep_run, run_options
from tools.benchmark import ROOT, SCENARIO
from tools.benchmark.tables import Section, as_share, as_verdict
from tools.benchmark.timing import Effort

PAPER = ROOT / "config/scenarios/paper.toml"
SPEED_TARGET = 150.0
PROFILE_ROWS = 25

Function = tuple[str, int, str]


def lockstep_speed(effort: Effort) -> list[Section]:
    """Scenario seconds per second, in turns; the first round is for warm-up and is not counted."""
    variants = {
        "paper_glr.toml, recorded, with Rerun": (SCENARIO, True, SPEED_TARGET),
        "paper_glr.toml, recorded, without Rerun": (SCENARIO, False, None),
        "paper.toml (ideal diagnosis), with Rerun": (PAPER, True, None),
    }
    speeds: dict[str, list[float]] = {name: [] for name in variants}
    with tempfile.TemporaryDirectory() as folder:
        for index in range(effort.runs + 1):
            for number, (name, (scenario, rerun, _)) in enumerate(variants.items()):
                speed = _simulate(assembly.load(scenario), Path(folder) / f"{index}_{number}", rerun=rerun)
                if index:
                    speeds[name].append(speed)
    rows = []
    for name, (_, _, target) in variants.items():
        found = speeds[name]
        wanted = ("", "") if target is None else (f"{target:.0f} ×", as_verdict(median(found) >= target))
        rows.append((name, f"{median(found):.0f} ×", f"{max(found):.0f} ×", *wanted))
    note = (
        "Times real time: 500 s of scenario over the wall time of the whole run, from opening the folder to kpi.json. "
        "0.1 s control period, 20 ms level frames, every frame encoded, sent on a bus, checked and decoded."
    )
    return [Section("Lockstep speed", note, ("run", "median", "best", "target", "verdict"), rows)]


def lockstep_profile(effort: Effort) -> list[Section]:
    """Where a run's time is spent: own time by function, and by module. Always one run."""
    del effort
    bench = assembly.load(SCENARIO)
    profile = cProfile.Profile()
    with tempfile.TemporaryDirectory() as folder:
        profile.enable()
        _simulate(bench, Path(folder) / "run", rerun=True)
        profile.disable()
    own = _own_times(profile)
    total = sum(own.values())
    groups: defaultdict[str, float] = defaultdict(float)
    for function, seconds in own.items():
        groups[_group(function[0])] += seconds
    modules = [
        (name, as_share(seconds, total))
        for name, seconds in sorted(groups.items(), key=lambda group: -group[1])
        if seconds > 0.001 * total
    ]
    functions = [
        (_group(file), f"{name} ({Path(file).name})", as_share(seconds, total))
        for (file, _, name), seconds in sorted(own.items(), key=lambda function: -function[1])[:PROFILE_ROWS]
    ]
    by_module = (
        f"Own time in cProfile of one run of {SCENARIO.name} with Rerun; built-in and compiled functions count for "
        "their caller."
    )
    by_function = f"The {PROFILE_ROWS} functions with the most. A profiler overestimates small functions."
    return [
        Section("Where a lockstep run's time goes, by module", by_module, ("module", "share"), modules),
        Section("The same by function", by_function, ("module", "function", "share"), functions),
    ]


def _simulate(bench: assembly.Bench, out: Path, *, rerun: bool) -> float:
    """Scenario seconds per wall second of a whole run."""
    started = time.perf_counter()
    kpi = lockstep_run.simulate(bench, run_options.RunOptions(out=out, rerun=rerun))
    wall_s = time.perf_counter() - started
    if kpi.status != "complete":
        raise RuntimeError(f"the run ended {kpi.status}: {kpi.reason}")
    return kpi.duration_s / wall_s


def _own_times(profile: cProfile.Profile) -> dict[Function, float]:
    """Own time in s by function; that of built-in functions goes to their callers."""
    own: defaultdict[Function, float] = defaultdict(float)
    stats: dict[Function, tuple[int, int, float, float, dict[Function, Any]]] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    for function, (_, _, seconds, _, callers) in stats.items():
        if function[0] != "~" or not callers:
            own[function] += seconds
            continue
        for caller, (_, _, part, _) in callers.items():
            own[caller] += part
    return own


def _group(file: str) -> str:
    """Which of the modules of interest a source file belongs to."""
    path = Path(file)
    parts = path.parts
    if "site-packages" in parts:
        package = parts[parts.index("site-packages") + 1].removesuffix(".py")
        return {"can": "python-can", "rerun_sdk": "rerun", "rerun_bindings": "rerun"}.get(package, package)
    if path.is_relative_to(ROOT):
        inside = path.relative_to(ROOT).parts
        return f"hil.{inside[1].removesuffix('.py')}" if inside[0] == "hil" else inside[0]
    return "built in" if file == "~" else "standard library"
