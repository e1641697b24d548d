"""`hil test`: scenarios in lockstep, and whether they keep their limits."""

# ruff: noqa: PT028 - the function is a command, not a test of pytest

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.complaint import interruptible
from hil.cli.options import ConfigDir, EmulatedRigFile, RerunChoice

EXAMPLE = "hil test my-scenarios --junit out.xml"


def test(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="DIR|FILE...", help="Scenarios: folders, files, or names of shipped ones."),
    ],
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="DIR", help="Where the run folders go. Default: runs/<time>_test."),
    ] = None,
    junit: Annotated[
        Optional[Path], typer.Option("--junit", metavar="FILE", help="Write the verdicts as a JUnit file, too.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the emulator's noise and parameter spread.")] = 1,
    rig: EmulatedRigFile = None,
    config: ConfigDir = None,
    rerun: RerunChoice = False,
) -> None:
    """Run scenarios in lockstep with the emulator, and check the limits of their accept tables.

    Exit code 6 if a limit is not kept. A scenario without limits is left out of a folder, and refused as a file.
    """
    from hil.bench import run_options
    from hil.cli import test_command

    folder = out or run_options.default_folder("test", datetime.now())
    options = test_command.LimitOptions(tuple(paths), folder, junit, seed, rig, config, rerun)
    with interruptible():
        raise typer.Exit(test_command.run(Console(), options))
