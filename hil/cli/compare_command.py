"""`hil compare` on the terminal: differences of configuration, then the key figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from hil.cli.complaint import warn
from hil.compare.compare_report import NOTHING_DIFFERS, alignment, ratio_text, same_text, value_text
from hil.compare.compared_run import CompareError
from hil.compare.comparison import Comparison
from hil.compare.figure_rows import MIN_SPREAD, FigureRow
from hil.core.counted import counted

MAX_WIDTH = 1000
"""Of a table, where no terminal sets its width."""


@dataclass(frozen=True)
class CompareOptions:
    """Options of the command line. out : None: no report is written."""

    paths: tuple[Path, ...]
    align: str
    out: Path | None
    rerun: Path | None
    as_json: bool


def run(console: Console, options: CompareOptions) -> None:
    """Compare, show and write. Raises RunFolderError."""
    if not console.is_terminal:
        console.width = MAX_WIDTH
    comparison = Comparison.of(options.paths, options.align, whole=options.rerun is not None)
    for note in comparison.notes:
        warn(note)
    if options.as_json:
        typer.echo(json.dumps(comparison.as_dict(), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        _show(console, comparison)
    written = []
    if options.out is not None:
        try:
            written.append(comparison.write_report(options.out))
        except OSError as error:
            raise CompareError(f"no report can be written to {options.out}: {error.strerror}") from None
    if options.rerun is not None:
        comparison.write_recording(options.rerun)
        written.append(options.rerun)
    if not options.as_json:
        for path in written:
            typer.echo(path)


def _show(console: Console, comparison: Comparison) -> None:
    names = [run.name for run in comparison.runs]
    console.print(
        f"{counted(len(names), 'run')}, aligned {alignment(comparison.align)}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
    if comparison.differences:
        table = _table("What differs in the configuration", "key", *names)
        for one in comparison.differences:
            table.add_row(one.key, *one.values)
        _print(console, table)
    else:
        console.print(NOTHING_DIFFERS, highlight=False, markup=False, soft_wrap=True)
    _print(console, _figure_table(comparison.rows, names, is_short=False), _short_table(comparison))
    if text := same_text(comparison.rows):
        console.print(text, highlight=False, markup=False, soft_wrap=True)


def _short_table(comparison: Comparison) -> Table | None:
    """For a terminal that is too narrow for all runs: the first and the spread of all."""
    names = [run.name for run in comparison.runs]
    return _figure_table(comparison.rows, names, is_short=True) if len(names) >= MIN_SPREAD else None


def _figure_table(rows: tuple[FigureRow, ...], names: list[str], *, is_short: bool) -> Table:
    heads = ["figure", "unit", names[0]]
    for name in [] if is_short else names[1:]:
        heads += [name, "ratio"]
    has_spread = len(names) >= MIN_SPREAD
    table = _table("Key figures", *heads, *(("median", "min", "max") if has_spread else ()))
    for column in table.columns[2:]:
        column.justify = "right"
    for row in rows:
        if row.is_same:
            continue
        cells = [row.label, row.unit, value_text(row.values[0])]
        for value, ratio in zip(row.values[1:], row.ratios[1:], strict=True):
            cells += [] if is_short else [value_text(value), ratio_text(ratio)]
        spread = (row.median, row.low, row.high) if has_spread else ()
        table.add_row(*cells, *(value_text(one) for one in spread))
    return table


def _table(title: str, *heads: str) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for head in heads:
        table.add_column(head, overflow="fold")
    return table


def _print(console: Console, table: Table, short: Table | None = None) -> None:
    """The table, or the short one where the terminal is too narrow for it."""
    wide = console.options.update_width(MAX_WIDTH)
    if short is not None and console.measure(table, options=wide).maximum > console.width:
        table = short
    console.print(table, markup=False, highlight=False)
