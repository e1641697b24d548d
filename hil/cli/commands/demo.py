"""`hil demo`: the paper's experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from hil.cli.options import ConfigDir

EXAMPLE = "hil demo --out runs"


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the runs.")] = Path("runs"),
    config: ConfigDir = None,
) -> None:
    """Run the paper's experiment: its table 3 beside the paper's, then the same fault with each fault detector."""
    from hil.cli import demo_command as demonstration

    demonstration.run(Console(), out, config)
