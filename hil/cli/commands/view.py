"""`hil view`: open a recording in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "hil view runs/first"


def view(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A run folder.")]) -> None:
    """Open a run's recording in the Rerun viewer."""
    from hil.edge.record.run_folder import RunFolder
    from hil.review.viewer import view as open_viewer

    open_viewer(RunFolder.open(folder))
