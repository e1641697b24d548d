"""What the run folder of a scenario keeps of the configuration: settings, windows, and copies of the files."""

from __future__ import annotations

from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

from hil.bench.assembly import Bench
from hil.core.controller import ControllerConfig
from hil.edge.config.settings_file import read_text
from hil.edge.record.manifest import RunPlan, Window


def run_plan(
    bench: Bench, *, is_live: bool, seed: int | None, config: ControllerConfig | None = None, clear_trip: bool = False
) -> RunPlan:
    """What the run folder keeps of the configuration. config, clear_trip : with them, a replay knows the options."""
    files = [bench.rig_path, bench.scenario_path, bench.dbc_path]
    if not is_live:
        files.append(bench.emulator_path)
    settings: dict[str, Any] = {
        "rig": bench.rig.model_dump(mode="json"),
        "rig_file": bench.rig_path.name,
        "scenario": bench.scenario.model_dump(mode="json"),
    }
    if config is not None:
        settings["options"] = {
            "duration_s": config.duration_s if isfinite(config.duration_s) else None,
            "clear_trip": clear_trip,
            "attended_s": config.limits.attended_s,
        }
    if is_live:  # in lockstep the same seed gives the same bytes
        written = datetime.fromtimestamp(bench.rig_path.stat().st_mtime, UTC)
        settings["rig_file_utc"] = written.isoformat(timespec="seconds")
    return RunPlan(
        scenario=bench.scenario.scenario.name,
        mode="live" if is_live else "lockstep",
        seed=seed,
        period_s=bench.rig.control.period_s,
        windows=tuple(Window(w.name, w.from_s, w.to_s) for w in bench.scenario.window),
        reconfigure=bench.scenario.control.reconfigure,
        settings=settings,
        copies={_copy_name(bench, file): read_text(file) for file in files} | _trajectories(bench),
        shown=bench.shown,
    )


def _copy_name(bench: Bench, file: Path) -> str:
    """File name of a copy. A scenario may have any name, even rig.toml, so it has a folder of its own."""
    if file == bench.scenario_path:
        return f"scenarios/{file.name}"
    return "rig.toml" if file == bench.rig_path else file.name


def _trajectories(bench: Bench) -> dict[str, str]:
    """Copies of the references' CSV files, by names relative to which the scenario's copy finds them."""
    named = [reference.file for reference in bench.scenario.reference if reference.file is not None]
    return {f"scenarios/{name}": read_text(bench.scenario_path.parent / name) for name in named}
