"""`hil compare`: runs beside each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

EXAMPLE = "hil compare runs/first runs/second --align alarm:1"


def compare(
    paths: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Run folders, or folders with run folders in them.")
    ],
    align: Annotated[
        str,
        typer.Option(
            "--align",
            metavar="MOMENT",
            help="Time 0 of all runs: start, a time in s, or an event: trip, alarm:1 (its number), CODE:N.",
        ),
    ] = "start",
    out: Annotated[
        Optional[Path],
        typer.Option(
            "--out", metavar="DIR", help="Where report.html and compare.json go. Default: runs/<time>_compare."
        ),
    ] = None,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Whether to write them.")] = True,
    rerun: Annotated[
        Optional[Path], typer.Option("--rerun", metavar="FILE", help="A recording of all runs for the Rerun viewer.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="The tables as JSON.")] = False,
) -> None:
    """Compare recorded runs: what differs in their configuration, key figures with ratios to the first, figures.

    Three runs or more also have median, smallest and largest value of each figure.
    """
    from datetime import datetime

    from rich.console import Console

    from hil.bench import run_options
    from hil.cli import compare_command

    folder = (out or run_options.default_folder("compare", datetime.now())) if report else None
    options = compare_command.CompareOptions(tuple(paths), align, folder, rerun, json)
    compare_command.run(Console(), options)
