"""`hil runs`: the run folders as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

EXAMPLE = "hil runs --where \"status == 'tripped'\" --sort started_utc"


def runs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of runs.")] = Path("runs"),
    where: Annotated[
        Optional[str],
        typer.Option(
            "--where",
            metavar="EXPR",
            help="Only runs for which this is true: columns and keys of kpi.json, compared; and, or, not.",
        ),
    ] = None,
    sort: Annotated[
        Optional[str],
        typer.Option("--sort", metavar="KEY", help="By this value, as in --where; -KEY: the largest first."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="As JSON, with all key figures.")] = False,
    trash: Annotated[
        Optional[list[str]],
        typer.Option("--trash", metavar="RUN", help="Move this run to DIR/.trash, after a question. May be repeated."),
    ] = None,
    empty_trash: Annotated[
        bool, typer.Option("--empty-trash", help="Delete what is in DIR/.trash, after a question.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing.")] = False,
) -> None:
    """List the run folders in DIR and in folders within: what was run, how it ended, key figures, size on disk.

    Runs are read once; an index in DIR keeps what they say until they change. A run that goes on is never moved to the
    trash.
    """
    from rich.console import Console

    from hil.cli import runs_command

    options = runs_command.RunsOptions(folder, where, sort, json, tuple(trash or ()), empty_trash, yes)
    raise typer.Exit(runs_command.run(Console(), options))
