"""`hil replay`: a record through today's controller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.complaint import interruptible
from hil.cli.options import ConfigDir

EXAMPLE = "hil replay runs/first"


def replay(
    record: Annotated[Path, typer.Argument(metavar="RUN|LOG", help="A run folder, or a log of a bus.")],
    rig: Annotated[
        Optional[str], typer.Option("--rig", metavar="FILE", help="What if: another rig. Of a log: its rig.")
    ] = None,
    detector: Annotated[
        Optional[str], typer.Option("--detector", metavar="NAME", help="What if: another fault detector.")
    ] = None,
    law: Annotated[Optional[str], typer.Option("--law", metavar="NAME", help="What if: another control law.")] = None,
    scenario: Annotated[
        Optional[str],
        typer.Option("--scenario", metavar="FILE", help="Of a log: what ran. A run folder has its own."),
    ] = None,
    duration: Annotated[
        Optional[float], typer.Option("--duration", min=0.0, metavar="S", help="Of a log: length that the run had.")
    ] = None,
    tolerance: Annotated[
        Optional[float],
        typer.Option(
            "--tolerance", min=0.0, metavar="V", help="Of a command. Default: one count on the wire; of a log 0.05 V."
        ),
    ] = None,
    config: ConfigDir = None,
    update: Annotated[
        bool, typer.Option("--update", help="Make today's commands and alarms the record's reference.")
    ] = False,
    figure: Annotated[
        Optional[Path], typer.Option("--figure", metavar="FILE", help="Write both commands as a page (HTML).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Drive today's controller with recorded frames, and compare its commands with the recorded ones.

    Exit code 6 if they differ. With --rig, --detector or --law there is no verdict: the alarms stand beside the
    recorded ones.
    """
    from hil.cli import replay_command
    from hil.replay.recorded_bench import WhatIf
    from hil.replay.replay_run import ReplayOptions

    options = ReplayOptions(WhatIf(rig, detector, law), tolerance, scenario, config, duration, update)
    with interruptible():
        raise typer.Exit(replay_command.run(Console(), record, options, as_json=as_json, figure=figure))
