"""`hil view`: open a recording in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "hil view runs/first"


def view(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A run folder, or the folder of an identification.")],
) -> None:
    """Open the recording of a run or of an identification in the Rerun viewer."""
    from hil.edge.record.run_folder import RunFolder
    from hil.review.viewer import view as open_viewer
    from hil.review.viewer import view_recording

    identification = folder / "identification.rrd"
    if identification.is_file():
        view_recording(identification, f"the report is at {folder / 'report.html'}")
        return
    open_viewer(RunFolder.open(folder))
