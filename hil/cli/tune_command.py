"""`hil tune`: runs, the table of candidates, the choice, and the rig file."""

from __future__ import annotations

import shutil
from datetime import datetime

from rich.console import Console
from rich.table import Table

from hil.bench import benchmark_run, tuning_run
from hil.bench.law_choices import STATE_FEEDBACK
from hil.bench.tuning_run import NotWrittenError, TuneOptions, TuningResult
from hil.campaigns.toml_text import toml_text
from hil.campaigns.tuning_choice import RULE
from hil.campaigns.tuning_report import HEADS, line
from hil.cli import exit_codes
from hil.cli.complaint import complain
from hil.cli.run_progress import run_progress
from hil.core.counted import counted

MIN_WIDTH = 140


def run(console: Console, options: TuneOptions, *, write: bool) -> int:
    """The whole tuning; returns the exit code. Raises SettingsError before any run is made."""
    prepared = tuning_run.prepare_tuning(options)
    folder = benchmark_run.open_folder(prepared.benchmark, options.out)
    total = len(prepared.benchmark.contests)
    if folder.done:
        console.print(f"Already there: {folder.done} of {counted(total, 'run')}.", highlight=False)
    with run_progress(console, prepared.benchmark.campaign.name, total - folder.done) as advance:
        found = tuning_run.tune(prepared, folder.store, options.noise_max_V, lambda _: advance())
    _show(console, found)
    for file in tuning_run.write_tuning(found, folder.store.path):
        console.print(str(file), highlight=False, soft_wrap=True)
    if not write:
        return 0
    try:
        copy = tuning_run.write_choice(found, datetime.now())
    except NotWrittenError as error:
        return complain(str(error), exit_codes.NOT_DONE)
    console.print(f"{prepared.rig_path} replaced; the old one is {copy}", highlight=False, soft_wrap=True)
    return 0


def _show(console: Console, found: TuningResult) -> None:
    lines = [line(trial) for trial in found.trials]
    width = console.width if console.is_terminal else max(shutil.get_terminal_size().columns, MIN_WIDTH)
    if width < MIN_WIDTH:
        for cells in lines:
            console.print(" ".join(cells[:2]), highlight=False, markup=False)
            for head, cell in zip(HEADS[2:], cells[2:], strict=True):
                if cell:
                    console.print(f"  {head}: {cell}", highlight=False, markup=False)
    else:
        console.width = width
        table = Table(title=f"{found.prepared.law} on {found.prepared.rig_path}", title_justify="left")
        for place, head in enumerate(HEADS):
            table.add_column(
                head.replace(" ", "\n"), no_wrap=not place, justify="right" if 2 <= place < len(HEADS) - 1 else "left"
            )
        for cells in lines:
            table.add_row(*cells)
        console.print(table)
    console.print(RULE, highlight=False, markup=False)
    chosen = found.chosen
    if chosen is None:
        console.print("Chosen: none; no candidate meets the rule.", highlight=False)
        return
    console.print(f"Chosen: {chosen.candidate.label}", highlight=False, markup=False)
    values = dict(chosen.candidate.values)
    if found.prepared.law == STATE_FEEDBACK:
        tables = {"control": {key.partition(".")[2]: value for key, value in values.items()}}
    else:
        tables = {"control": {"law": found.prepared.law, "options": values}}
    console.print(toml_text(tables), highlight=False, markup=False, soft_wrap=True)
