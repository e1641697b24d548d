"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from hil.edge.can import adapters

Interface = Annotated[
    Optional[str],
    typer.Option(
        "-i",
        "--interface",
        help=f"CAN interface: {adapters.known()}; or another of python-can. Default: the rig file's.",
    ),
]
Channel = Annotated[
    Optional[str],
    typer.Option("-c", "--channel", help=f"For {adapters.channels()}. Default: the rig file's."),
]
Bitrate = Annotated[
    Optional[int],
    typer.Option("-b", "--bitrate", min=10_000, max=1_000_000, help="bit/s. Default: the rig file's."),
]
ClearTrip = Annotated[
    bool, typer.Option("--clear-trip", help="First clear a trip that the pump node still has from an earlier run.")
]
WithPumps = Annotated[bool, typer.Option("--with-pumps", help="Also move the pumps a little. Stay beside the rig.")]


def shipped_scenarios(incomplete: str) -> list[str]:
    """Names of shipped scenarios that begin so, for the completion of the shell."""
    from hil.edge.config.shipped import shipped_names

    return [name for name in shipped_names("scenarios") if name.startswith(incomplete)]


ScenarioFile = Annotated[
    Path,
    typer.Argument(
        metavar="SCENARIO",
        help="A scenario file, or the name of a shipped one, such as paper.",
        autocompletion=shipped_scenarios,
    ),
]
ConfigDir = Annotated[
    Optional[Path],
    typer.Option("--config", metavar="DIR", help="Folder with rig.toml, emulator.toml and bench.dbc."),
]
LawName = Annotated[
    Optional[str],
    typer.Option("--law", metavar="NAME", help="A control law with its defaults, in place of the scenario's."),
]
PanelEmulator = Annotated[
    Optional[str],
    typer.Option(
        "--emulator", metavar="PATH|PORT", help="For the panel's page of faults: where firmware-sim --control listens."
    ),
]
RigFile = Annotated[
    Optional[str],
    typer.Option(
        "--rig",
        metavar="RIG",
        help="A rig file, or the name of a shipped one, such as decenter2021. Default: rig.toml of --config.",
    ),
]
EmulatedRigFile = Annotated[
    Optional[str],
    typer.Option(
        "--rig",
        metavar="RIG",
        help="A rig file, or the name of a shipped one, for controller and emulator. "
        "Default: rig.toml and emulator.toml of --config.",
    ),
]
OutDir = Annotated[
    Optional[Path],
    typer.Option("--out", metavar="DIR", help="The run folder to write; must not exist. Default: runs/<time>_<name>."),
]
Duration = Annotated[
    Optional[float],
    typer.Option("--duration", metavar="S", min=0.0, max=1e7, help="Length of the run. Default: the scenario's."),
]
LiveChoice = Annotated[
    bool,
    typer.Option("--live", help="Show the run in the Rerun viewer while it goes on; as a page without a screen."),
]
LivePageChoice = Annotated[
    bool, typer.Option("--live-web", help="The same as a page, screen or not. --live web is another form.")
]
RerunChoice = Annotated[bool, typer.Option("--rerun/--no-rerun", help="Whether to write run.rrd.")]
ReportChoice = Annotated[bool, typer.Option("--report/--no-report", help="Whether to write report.html.")]
ManyProcesses = Annotated[
    Optional[int], typer.Option(min=1, help="Runs beside each other. Default: one for each core; 1 needs no Dask.")
]
SchedulerAddress = Annotated[
    Optional[str], typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster: tcp://host:8786.")
]
