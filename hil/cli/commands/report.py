"""`hil report`: key figures and report of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

EXAMPLE = "hil report runs/first --compare runs/second"


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A run folder.")],
    compare: Annotated[
        Optional[Path],
        typer.Option("--compare", metavar="DIR", help="A second run, drawn into the same figures."),
    ] = None,
) -> None:
    """Compute a run's key figures and write report.html again, with a second run if wanted."""
    from hil.edge.record.record_errors import RunFolderError
    from hil.edge.record.run_folder import RunFolder
    from hil.review import kpi
    from hil.review.run_report import write_report

    first = RunFolder.open(folder)
    second = RunFolder.open(compare) if compare else None
    try:
        for one in (first, second):
            if one is not None:
                figures = kpi.compute(one)
                if figures.status == "interrupted":
                    typer.echo(f"{one.path}: unfinished: run.json does not say how the run ended")
        typer.echo(write_report(first, second))
    except (OSError, UnicodeDecodeError) as error:
        raise RunFolderError(f"no report of {folder} can be made: {error}") from None
