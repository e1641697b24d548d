"""What `hil export` does: it writes, and names what it wrote."""

from __future__ import annotations

from pathlib import Path

import typer

from hil.cli.complaint import interruptible
from hil.edge.record.record_errors import RunFolderError
from hil.export.formats import CANDUMP, compress_logs, export_run


def export_folder(folder: Path, to: str, out: Path | None, compress: str | None, *, in_place: bool) -> None:
    """Write the export, or compress the folder's logs, and print the paths. Raises RunFolderError."""
    if in_place and (to != CANDUMP or out is not None):
        raise RunFolderError(f"--in-place is for --to {CANDUMP} without --out: it replaces the logs of the run folder")
    with interruptible():
        written = compress_logs(folder, compress) if in_place else [export_run(folder, to, out, compress)]
    for path in written:
        typer.echo(path)
