"""`hil identify RUN... --check` on the terminal: a table over the runs, the trend, and what is beyond the limit."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hil.bench.experiment_folder import make_folder
from hil.bench.identify_check import CHECK_FILE, TREND_FILE, Check, check_runs
from hil.cli import exit_codes
from hil.core.identification.drift import ALL_CHECKED, Drift
from hil.edge.config.settings_file import SettingsError
from hil.edge.record.file_writing import write_atomically
from hil.review.parameter_drift import has_moved, parameters_json, sentence
from hil.review.trend_figure import trend_png

NAME_WIDTH = 16


def run(console: Console, runs: Sequence[Path], rig_path: Path | None, limit_sd: float, out: Path | None) -> int:
    """Check the runs; the exit code is `exit_codes.MOVED` when a parameter is beyond the limit.

    out : the folder for check.json and trend.png; None: nothing is written. Raises SettingsError, RunFolderError.
    """
    if not runs:
        raise SettingsError("--check looks at recorded runs: name their folders")
    check = check_runs(runs, rig_path)
    console.print(moves_table(check))
    for line in rate_lines(check):
        console.print(line, highlight=False, markup=False)
    beyond = {moved.name for moved in check.beyond(limit_sd)}
    for name, value in newest_values(check).items():
        if has_moved(value) or name in beyond:
            text = sentence(name, value, f"{check.file} says")
            more = f": beyond {limit_sd:g}" if name in beyond else ""
            console.print(f"{text[0].upper()}{text[1:]}{more}.", highlight=False, markup=False)
    if not beyond:
        known = any(one.drift.moved for one in check.runs)
        verdict = f"Nothing has moved by more than {limit_sd:g} standard deviations." if known else "Not determined."
        console.print(verdict, highlight=False, markup=False)
    if out is not None:
        make_folder(out)
        write_atomically(out / CHECK_FILE, check.to_json(limit_sd))
        write_atomically(out / TREND_FILE, trend_png(points(check)))
        console.print(f"{out / CHECK_FILE}, {out / TREND_FILE}", highlight=False, markup=False, soft_wrap=True)
    return exit_codes.MOVED if beyond else 0


def newest_values(check: Check) -> dict[str, dict[str, float | None]]:
    """The newest move of each parameter that any run determines, as kpi.json has it."""
    newest = [moved for name in ALL_CHECKED if (moved := check.newest(name)) is not None]
    return parameters_json(Drift(tuple(newest), ()), None)


def moves_table(check: Check) -> Table:
    """A row for each run: by how many per cent each parameter is off the file; "–" where it is not determined."""
    table = Table(title=f"moved from {check.file}, %", title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("run", overflow="fold", max_width=NAME_WIDTH)
    for name in ALL_CHECKED:
        table.add_column(name, justify="right", no_wrap=True)
    for one in check.runs:
        started = datetime.fromisoformat(one.started_utc).strftime("%m-%d %H:%M")
        cells = ["–" if (moved := one.moved(name)) is None else f"{100 * moved.share:+.2f}" for name in ALL_CHECKED]
        table.add_row(f"{escape(one.name)}\n{started}", *cells)
    newest = [check.newest(name) for name in ALL_CHECKED]
    sds = ["–" if moved is None else f"{moved.shift_sd:+.1f}" for moved in newest]
    table.add_section()
    table.add_row("newest, in sd", *sds)
    return table


def rate_lines(check: Check) -> list[str]:
    """A line for each parameter that moves, and for each run that determines nothing."""
    lines = []
    for name in ALL_CHECKED:
        rate = check.rate(name)
        if rate is not None and abs(rate[0]) > 2.0 * rate[1]:
            lines.append(f"{name} moves by {100 * rate[0]:+.2g} % an hour (± {100 * rate[1]:.1g})")
    lines += [f"{one.name}: not determined: {one.drift.why}" for one in check.runs if one.drift.why]
    return lines


def points(check: Check) -> dict[str, list[tuple[float, float, float]]]:
    """The points of the picture."""
    return {
        name: [
            (one.hours, 100.0 * moved.share, 100.0 * moved.sd / moved.file)
            for one in check.runs
            if (moved := one.moved(name)) is not None
        ]
        for name in ALL_CHECKED
    }
