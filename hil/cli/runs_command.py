"""`hil runs` on the terminal: the table of run folders, and its trash."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from hil.cli import exit_codes
from hil.core.counted import counted
from hil.edge.record.record_errors import RunFolderError
from hil.run_index.index_file import index_of
from hil.run_index.indexed_run import IndexedRun
from hil.run_index.selection import SelectionError, chosen, ordered
from hil.run_index.trash import TRASH_NAME, empty_trash, move_to_trash, run_named, trash_content

HEADS = (
    *("run", "started", "scenario", "status", "mode", "duration", "rig", "law", "detector", "seed"),
    *("IAE 1, 2\n[V s]", "alarms", "trips", "size"),
)
NUMBERS = ("duration", "seed", HEADS[10], "alarms", "trips", "size")
CAPTION = "IAE: sum over the windows of the run"
MAX_WIDTH = 1000
"""Of the table, where no terminal sets its width."""


@dataclass(frozen=True)
class RunsOptions:
    """Options of the command line."""

    folder: Path
    where: str | None
    sort: str | None
    as_json: bool
    trash: tuple[str, ...]
    empty_trash: bool
    yes: bool


def run(console: Console, options: RunsOptions) -> int:
    """Do what was asked; returns the exit code. Raises NoRunFolderError, SelectionError and TrashError."""
    if options.trash or options.empty_trash:
        if options.where is not None or options.sort is not None or options.as_json:
            raise RunFolderError("--trash and --empty-trash show no table: leave --where, --sort and --json out")
        return _tidy(options)
    rows = list(index_of(options.folder))
    shown = rows
    try:
        option = "--where"
        shown = shown if options.where is None else chosen(shown, options.where)
        option = "--sort"
        shown = shown if options.sort is None else ordered(shown, options.sort)
    except SelectionError as error:
        raise SelectionError(f"{option} {error}") from None
    if options.as_json:
        typer.echo(json.dumps(_as_json(options.folder, rows, shown), indent=2, ensure_ascii=False, allow_nan=False))
        return 0
    _show(console, shown)
    for line in _foot(options.folder, rows, shown):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    return 0


def _tidy(options: RunsOptions) -> int:
    """Move runs to the trash and empty it, each after a question; the exit code says whether all was done."""
    is_done = True
    index = {row.name: row for row in index_of(options.folder)}
    names = [run_named(options.folder, text) for text in options.trash]
    for name in dict.fromkeys(names):
        size = size_text(index[name].size_bytes) if name in index else "unknown size"
        if not _agrees(f"Move {options.folder / name} ({size}) to the trash?", options):
            typer.echo(f"{options.folder / name} stays where it is")
            is_done = False
            continue
        typer.echo(f"{options.folder / name} is now {move_to_trash(options.folder, name, datetime.now())}")
    if options.empty_trash:
        is_done = _empty(options) and is_done
    return 0 if is_done else exit_codes.NOT_DONE


def _empty(options: RunsOptions) -> bool:
    content = trash_content(options.folder)
    if not content.size_bytes and not (options.folder / TRASH_NAME).exists():
        typer.echo("the trash is empty")
        return True
    what = f"{counted(content.runs, 'run')}, {size_text(content.size_bytes)}"
    if not _agrees(f"Delete what is in {options.folder / TRASH_NAME} ({what})? It can't be had back.", options):
        typer.echo("the trash stays as it is")
        return False
    empty_trash(options.folder)
    typer.echo(f"the trash is empty: {what} deleted")
    return True


def _agrees(question: str, options: RunsOptions) -> bool:
    if options.yes:
        return True
    if not sys.stdin.isatty():
        raise RunFolderError(f"{question} Nobody can answer here: --yes does it without a question")
    return typer.confirm(question)


def size_text(size_bytes: float) -> str:
    """A size as people read it: `12.3 MB`."""
    for unit in ("B", "kB", "MB"):
        if size_bytes < 999.5:
            return f"{size_bytes:.0f} B" if unit == "B" else f"{size_bytes:.3g} {unit}"
        size_bytes /= 1000.0
    return f"{size_bytes:.3g} GB" if size_bytes < 999.5 else f"{size_bytes:.0f} GB"


def _as_json(folder: Path, rows: Sequence[IndexedRun], shown: Sequence[IndexedRun]) -> dict[str, Any]:
    content = trash_content(folder)
    return {
        "folder": str(folder),
        "runs": [{"path": str(folder / row.name), **row.as_dict()} for row in shown],
        "all_runs": len(rows),
        "all_size_bytes": sum(row.size_bytes for row in rows),
        "trash": {"runs": content.runs, "size_bytes": content.size_bytes},
    }


def _foot(folder: Path, rows: Sequence[IndexedRun], shown: Sequence[IndexedRun]) -> list[str]:
    """Number and size of the runs, what is missing, what is in the trash."""
    total = f"{counted(len(rows), 'run')}, {size_text(sum(row.size_bytes for row in rows))}, in {folder}"
    if len(shown) < len(rows):
        here = f"{counted(len(shown), 'run')}, {size_text(sum(row.size_bytes for row in shown))}"
        total = f"{here}; of {total}"
    lines = [total]
    for problem in dict.fromkeys(row.problem for row in shown if row.problem):
        names = [row.name for row in shown if row.problem == problem]
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        lines.append(f"{', '.join(names[:3])}{more}: {problem}")
    content = trash_content(folder)
    if content.size_bytes:
        lines.append(
            f"in the trash: {counted(content.runs, 'run')}, {size_text(content.size_bytes)}; "
            f"`hil runs {folder} --empty-trash` deletes it"
        )
    return lines


def _show(console: Console, rows: Sequence[IndexedRun]) -> None:
    """A table, or where the terminal is too narrow for it a few lines for each run."""
    if not rows:
        return
    lines = [_cells(row) for row in rows]
    table = Table(box=SIMPLE_HEAD, pad_edge=False, caption=CAPTION, caption_justify="left")
    for head in HEADS:
        table.add_column(head, justify="right" if head in NUMBERS else "left", no_wrap=True)
    for cells in lines:
        table.add_row(*cells)
    if not console.is_terminal:
        console.width = MAX_WIDTH
    wide = console.options.update_width(MAX_WIDTH)
    if console.measure(table, options=wide).maximum <= console.width:
        console.print(table, markup=False, highlight=False)
        return
    for cells in lines:
        named = zip(HEADS[1:], cells[1:], strict=True)
        facts = [f"{' '.join(head.split())} {cell}" for head, cell in named if cell != "–"]
        console.print(cells[0], style="bold", highlight=False, markup=False)
        console.print(f"  {'; '.join(facts)}", highlight=False, markup=False)


def _cells(row: IndexedRun) -> tuple[str, ...]:
    started = row.started_utc[:16].replace("T", " ")
    law = f"{row.law} ({row.design})" if row.law == "state_feedback" and row.design else row.law
    texts = (row.name, started, row.scenario, row.status, row.mode, duration_text(row.duration_s), row.rig, law)
    numbers = (_text(row.seed), _iae(row.figures), _text(row.alarms), _text(row.trips))
    return tuple(text or "–" for text in (*texts, row.detector, *numbers, size_text(row.size_bytes)))


def duration_text(duration_s: float | None) -> str:
    """A duration as people read it; "" for an unknown one."""
    if duration_s is None:
        return ""
    if duration_s < 6000.0:
        return f"{duration_s:.0f} s"
    return f"{duration_s / 3600.0:.1f} h"


def _text(value: object) -> str:
    return "" if value is None else str(value)


def _iae(figures: Mapping[str, Any]) -> str:
    """The sum over the windows that the run has reached, for both outputs; "" where it is not known."""
    try:
        covered_s = figures.get("iae_covered_s", {})
        pairs = [pair for window, pair in figures["iae_Vs"].items() if covered_s.get(window, 1.0) > 0.0]
        sums = [sum(float(pair[output]) for pair in pairs) for output in (0, 1)]
    except (AttributeError, KeyError, TypeError, ValueError, IndexError):
        return ""
    return f"{sums[0]:.3g}, {sums[1]:.3g}" if pairs else ""
