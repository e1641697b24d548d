"""`hil design`: all designs on a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.options import ConfigDir, RigFile

EXAMPLE = "hil design --out figures"


def design(
    rig: RigFile = None,
    config: ConfigDir = None,
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="DIR", help="Folder for the figures step.svg and sigma.svg."),
    ] = None,
) -> None:
    """Show every design on the rig: gains, poles, zeros, RGA, noise gain, and poles after the loss of a pump."""
    from hil.cli import design_command as designs

    designs.run(Console(), config, out, rig)
