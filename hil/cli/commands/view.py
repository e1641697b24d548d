"""`hil view`: open a recording in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

EXAMPLE = "hil view runs/first --at alarm:1"


def view(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A run folder, or the folder of an identification.")],
    at: Annotated[
        Optional[str],
        typer.Option(
            "--at",
            metavar="MOMENT",
            help="Open there: a time in s, or an event: trip, alarm:2 (its number), CODE:N (the N-th of that code).",
        ),
    ] = None,
    web: Annotated[
        Optional[bool],
        typer.Option(
            "--web/--window", help="A page on 127.0.0.1, or a window. Default: a window if there is a screen."
        ),
    ] = None,
) -> None:
    """Open the recording of a run or of an identification in the Rerun viewer.

    Without a screen it is served as a page for a browser on this machine until Ctrl-C.
    """
    from hil.cli.view_command import open_view

    open_view(folder, at, is_page=web)
