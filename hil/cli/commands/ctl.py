"""`hil ctl`: ask a run that goes on for something, or look at it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

EXAMPLE = "hil ctl reference 6.4 6.7 --ramp 20"

CONTEXT = {"ignore_unknown_options": True}
"""A negative number is a value, not an option."""


ACTIONS = (
    "status",
    "watch",
    "reference",
    "manual",
    "auto",
    "bypass",
    "clear",
    "stop",
    "hold",
    "resume",
    "note",
    "mark",
    "ack",
    "shelve",
    "here",
)


def begin_with(incomplete: str) -> list[str]:
    """The actions that begin so, for the completion of the shell."""
    return [action for action in ACTIONS if action.startswith(incomplete)]


def ctl(
    action: Annotated[str, typer.Argument(metavar="ACTION", help=", ".join(ACTIONS) + ".", autocompletion=begin_with)],
    values: Annotated[Optional[list[str]], typer.Argument(metavar="VALUES", help="What the action needs.")] = None,
    cm: Annotated[bool, typer.Option("--cm", help="Of reference: the values are levels in cm, not V.")] = False,
    change: Annotated[bool, typer.Option("--change", help="Of reference: the values are changes in V.")] = False,
    ramp: Annotated[
        float, typer.Option(metavar="S", min=0.0, max=86400.0, help="Of reference: time of the way there.")
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Of status, watch: as JSON.")] = False,
    run: Annotated[Optional[Path], typer.Option(metavar="FOLDER", help="Which run. Default: the only one.")] = None,
    socket: Annotated[Optional[Path], typer.Option(metavar="PATH", help="Which run, by its socket.")] = None,
) -> None:
    """Change a run that goes on, or look at it, over its control channel. Whatever moves water is in its record.

    Values: reference A B (V; - keeps one); manual 1=3.0 2=2.5 (V; none: as they are); bypass INTERLOCK SECONDS;
    note TEXT; mark NAME; ack KEY or all; shelve KEY SECONDS. The other actions need none.

    Exit codes: 0 done; 2 bad input; 4 refused, no run, or several and none was named.
    """
    from hil.cli import ctl_command

    if action not in ACTIONS:
        raise typer.BadParameter(f"ACTION {action}: must be one of {', '.join(ACTIONS)}")
    options = ctl_command.CtlOptions(action, tuple(values or ()), cm, change, ramp, as_json, run, socket)
    raise typer.Exit(ctl_command.run(options))
