"""`hil export`: a run in the files of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

EXAMPLE = "hil export runs/first --to mat"


def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A run folder.")],
    to: Annotated[
        str,
        typer.Option("--to", metavar="FORMAT", help="parquet, csv, mf4, mcap, mat or candump."),
    ],
    out: Annotated[
        Optional[Path],
        typer.Option(
            "--out", metavar="PATH", help="File, or folder of parquet and csv. Default: beside DIR, with its name."
        ),
    ] = None,
    compress: Annotated[
        Optional[str], typer.Option("--compress", metavar="zst|gz", help="Compress the frames of candump.")
    ] = None,
    in_place: Annotated[
        bool,
        typer.Option(
            "--in-place", help="Replace DIR's logs of frames by compressed ones; with candump and --compress."
        ),
    ] = False,
) -> None:
    """Write control steps, events, frames and signals of a run, with units, in a format that other tools read.

    Nothing is overwritten. A run that was killed is exported, too.
    """
    from hil.cli.export_command import export_folder

    export_folder(folder, to, out, compress, in_place=in_place)
