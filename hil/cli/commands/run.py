"""`hil run`: one run in real time on a CAN bus."""

from __future__ import annotations

from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli import exit_codes
from hil.cli.beside_panel import BesidePanel
from hil.cli.complaint import interruptible
from hil.cli.live_command import LiveCommand
from hil.cli.options import (
    Bitrate,
    Channel,
    ClearTrip,
    ConfigDir,
    Duration,
    Interface,
    LawName,
    LiveChoice,
    LivePageChoice,
    OutDir,
    PanelEmulator,
    ReportChoice,
    RerunChoice,
    RigFile,
    shipped_scenarios,
)

HOLD = Path("hold")
"""The shipped scenario that holds the operating point until an operator stops the run."""

EXAMPLE = "hil run steps -i socketcan -c can0"

COMMAND = LiveCommand

ScenarioOrHold = Annotated[
    Optional[Path],
    typer.Argument(
        metavar="SCENARIO",
        help="A scenario file, or a shipped name. Default: hold.",
        autocompletion=shipped_scenarios,
    ),
]
RealtimeChoice = Annotated[
    bool,
    typer.Option(
        "--realtime", help="Ask for SCHED_FIFO and locked memory, without the live table; refusals are shown."
    ),
]
Priority = Annotated[Optional[int], typer.Option(metavar="1..99", help="Priority of SCHED_FIFO. Default: 80.")]
Processor = Annotated[Optional[int], typer.Option(metavar="N", help="Use this processor only. Default: any.")]
ControlSocket = Annotated[
    Optional[Path],
    typer.Option(metavar="PATH", help="Socket on which `hil ctl` reaches the run. Default: in the run folder."),
]
AttendedTime = Annotated[
    float,
    typer.Option(
        metavar="SECONDS",
        min=0.0,
        max=86400.0,
        help="Stop when no operator has sent a request for twice this time; an alarm comes after half of it.",
    ),
]
WithPanel = Annotated[bool, typer.Option("--panel", help="Show the operator's panel in this terminal.")]


def run(
    scenario: ScenarioOrHold = None,
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    out: OutDir = None,
    duration: Duration = None,
    clear_trip: ClearTrip = False,
    rig: RigFile = None,
    config: ConfigDir = None,
    law: LawName = None,
    rerun: RerunChoice = True,
    report: ReportChoice = True,
    realtime: RealtimeChoice = False,
    priority: Priority = None,
    live: LiveChoice = False,
    live_web: LivePageChoice = False,
    cpu: Processor = None,
    control: ControlSocket = None,
    attended: AttendedTime = 0.0,
    panel: WithPanel = False,
    emulator: PanelEmulator = None,
) -> None:
    """Run a scenario in real time on a CAN bus: the rig's, or the emulator's (firmware-sim). Moves pumps."""
    from hil.edge.host.realtime import parse_request

    if emulator is not None and not panel:
        raise typer.BadParameter(f"--emulator {emulator}: is for the panel; give --panel as well")
    wanted = parse_request(realtime, priority, cpu)  # before numpy is loaded: it starts threads
    from hil.bench import assembly, bus_choice, live_run, run_options
    from hil.cli import run_display
    from hil.cli.view_command import live_choice

    bench = assembly.load(scenario or HOLD, config, rig=rig, law=law)
    address = bus_choice.chosen_bus(bench.rig, interface, channel, bitrate)
    folder = out or run_options.default_folder(bench.scenario.scenario.name, datetime.now())
    shown = live_choice(live=live, is_page=live_web, is_recorded=rerun)
    options = run_options.RunOptions(
        folder,
        duration_s=duration,
        rerun=rerun,
        clear_trip=clear_trip,
        realtime=wanted,
        live=shown,
        control=control,
        attended_s=attended,
    )
    console = Console()
    beside = BesidePanel(folder, control, emulator) if panel else None
    with_table = not realtime and not panel
    with interruptible(), beside or nullcontext():
        with run_display.live_status(console, with_table=with_table) as watch:
            figures, outcome = live_run.run_live(bench, options, address, watch)
        run_display.finish(console, folder, figures, with_report=report)
        if beside is not None and exit_codes.is_by_signal(outcome.reason):
            beside.end()
    raise typer.Exit(exit_codes.of_run(outcome.status, outcome.reason))
