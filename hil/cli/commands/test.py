"""`hil test`: scenarios in lockstep, and whether they keep their limits."""

# ruff: noqa: PT028 - the function is a command, not a test of pytest

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.complaint import interruptible
from hil.cli.options import Bitrate, ConfigDir, EmulatedRigFile, RerunChoice
from hil.edge.can import adapters

EXAMPLE = "hil test my-scenarios --junit out.xml"

TestInterface = Annotated[
    Optional[str],
    typer.Option("-i", "--interface", help=f"Run on this CAN interface: {adapters.known()}; or another of python-can."),
]
TestChannel = Annotated[
    Optional[str],
    typer.Option("-c", "--channel", help=f"Run on this channel: {adapters.channels()}."),
]

ScenarioPaths = Annotated[
    Optional[list[Path]],
    typer.Argument(
        metavar="[DIR|FILE...]",
        help="Scenarios: folders, files, or shipped names. Default: all shipped ones, or those of --config.",
    ),
]
RunFolders = Annotated[
    Optional[Path],
    typer.Option("--out", metavar="DIR", help="Where the run folders go. Default: runs/<time>_test."),
]
JunitFile = Annotated[
    Optional[Path], typer.Option("--junit", metavar="FILE", help="Write the verdicts as a JUnit file, too.")
]
VerdictPage = Annotated[
    Optional[Path],
    typer.Option("--html", metavar="FILE", help="Write the verdicts as a page, with a report of each run."),
]
Processes = Annotated[Optional[int], typer.Option(min=1, help="Runs beside each other. Default: one for each core.")]
EmulatorSeed = Annotated[
    Optional[int], typer.Option(min=0, help="Seed of the emulator's noise and parameter spread. Default: 1.")
]
ClearTripEachRun = Annotated[
    bool, typer.Option("--clear-trip", help="On a bus: before each run clear a trip that the pump node still has.")
]


def test(
    paths: ScenarioPaths = None,
    out: RunFolders = None,
    junit: JunitFile = None,
    html: VerdictPage = None,
    processes: Processes = None,
    seed: EmulatorSeed = None,
    interface: TestInterface = None,
    channel: TestChannel = None,
    bitrate: Bitrate = None,
    clear_trip: ClearTripEachRun = False,
    rig: EmulatedRigFile = None,
    config: ConfigDir = None,
    rerun: RerunChoice = False,
) -> None:
    """Run scenarios in lockstep with the emulator, or on a bus with -i and -c, and check their limits (accept tables).

    Exit code 6 if a limit is not kept. A scenario without limits is left out of a folder, and refused as a file.
    On a bus (moves pumps) the scenarios run one after the other as `hil run` does it; a run that does not end as its
    limits expect ends the test, with the exit code of `hil run`.
    """
    from hil.bench import run_options
    from hil.cli import test_command

    folder = out or run_options.default_folder("test", datetime.now())
    options = test_command.LimitOptions(
        tuple(paths or ()),
        folder,
        junit,
        html,
        seed,
        rig,
        config,
        rerun,
        processes,
        interface,
        channel,
        bitrate,
        clear_trip,
    )
    with interruptible():
        raise typer.Exit(test_command.run(Console(), options))
