"""`hil replay`: a record through today's controller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.complaint import interruptible

EXAMPLE = "hil replay runs/first"


def replay(
    record: Annotated[Path, typer.Argument(metavar="RUN|LOG", help="A run folder, or a log of a bus.")],
    rig: Annotated[
        Optional[str], typer.Option("--rig", metavar="FILE", help="What if: another rig, by path or shipped name.")
    ] = None,
    detector: Annotated[
        Optional[str], typer.Option("--detector", metavar="NAME", help="What if: another fault detector.")
    ] = None,
    law: Annotated[Optional[str], typer.Option("--law", metavar="NAME", help="What if: another control law.")] = None,
    tolerance: Annotated[
        Optional[float],
        typer.Option("--tolerance", min=0.0, metavar="V", help="Of a command. Default: one count on the wire."),
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

    options = ReplayOptions(WhatIf(rig, detector, law), tolerance)
    with interruptible():
        raise typer.Exit(replay_command.run(Console(), record, options, as_json=as_json))
