"""`hil simulate`: one run in lockstep with the emulator."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

import typer
from rich.console import Console

from hil.cli import exit_codes
from hil.cli.complaint import interruptible, warn
from hil.cli.live_command import LiveCommand
from hil.cli.options import (
    ConfigDir,
    Duration,
    EmulatedRigFile,
    LawName,
    LiveChoice,
    LivePageChoice,
    OutDir,
    ReportChoice,
    RerunChoice,
    ScenarioFile,
)

EXAMPLE = "hil simulate paper --seed 3 --out runs/first"

COMMAND = LiveCommand


def simulate(
    scenario: ScenarioFile,
    out: OutDir = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the emulator's noise and parameter spread.")] = 1,
    duration: Duration = None,
    rig: EmulatedRigFile = None,
    config: ConfigDir = None,
    law: LawName = None,
    rerun: RerunChoice = True,
    report: ReportChoice = True,
    live: LiveChoice = False,
    live_web: LivePageChoice = False,
) -> None:
    """Run a scenario in lockstep with the emulator, every frame on a virtual CAN bus, much faster than real time."""
    from hil.bench import assembly, late_faults, lockstep_run, run_options
    from hil.cli import run_display
    from hil.cli.view_command import live_choice

    bench = assembly.load(scenario, config, rig=rig, law=law)
    run_options.check_length(bench, duration)
    warn(late_faults.late_faults(bench.scenario, duration))
    folder = out or run_options.default_folder(bench.scenario.scenario.name, datetime.now())
    shown = live_choice(live=live, is_page=live_web, is_recorded=rerun)
    options = run_options.RunOptions(folder, seed, duration, rerun, live=shown)
    console = Console()
    with interruptible(), run_display.progress(console, bench, duration) as advance:
        figures = lockstep_run.simulate(bench, options, advance)
    run_display.finish(console, folder, figures, with_report=report)
    raise typer.Exit(exit_codes.of_run(figures.status, figures.reason))
