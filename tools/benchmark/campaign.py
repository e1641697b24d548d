"""The cost of a campaign's run, and the time that a thousand of them take."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import Any

from hil.bench.campaign_case import run_case
from hil.campaigns.cases import Case
from hil.edge.config.settings_file import merged, read_toml
from tools.benchmark import ROOT, SCENARIO
from tools.benchmark.tables import Section, as_time, as_verdict
from tools.benchmark.timing import Effort

RUNS, RUN_S, CORES = 1000, 500.0, 2
TARGET_MIN = 30.0


def campaign_step(effort: Effort) -> list[Section]:
    """Unrecorded runs with and without the diagnosis, in turns; the first round is for warm-up and is not counted."""
    scenario_data = read_toml(SCENARIO)
    variants: dict[str, dict[str, Any]] = {
        "glr": {"diagnosis": {"method": "glr"}},
        "none": {"diagnosis": {"method": "none"}},
    }
    took: dict[str, list[float]] = {method: [] for method in variants}
    period_s = 0.1
    for index in range(effort.runs + 1):
        for method, changes in variants.items():
            us = _run(Case(method, method, SCENARIO.stem, index, merged(scenario_data, changes)), ROOT / "config")
            if index:
                took[method].append(us)
    rows = []
    for method, found in took.items():
        minutes = RUNS * RUN_S / period_s * median(found) * 1e-6 / CORES / 60.0
        rows.append(
            (
                method,
                as_time(median(found)),
                as_time(min(found)),
                f"{minutes:.0f} min",
                as_verdict(minutes <= TARGET_MIN),
            )
        )
    note = (
        f"{SCENARIO.name} as a campaign runs it, not recorded: wall time of a whole run per control step, with "
        f"emulator, one process. A thousand: {RUNS} runs of {RUN_S:g} s on {CORES} cores; target: {TARGET_MIN:g} min."
    )
    return [Section("A campaign", note, ("diagnosis", "median, a step", "best", "a thousand runs", "verdict"), rows)]


def _run(case: Case, config_dir: Path) -> float:
    """Microseconds a control step."""
    row = run_case(case, config_dir, lambda _: None)
    if row.status != "complete":
        raise RuntimeError(f"the run ended {row.status}: {row.reason}")
    return 1e6 * row.wall_s / row.steps
