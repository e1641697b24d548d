"""`hil benchmark`: a progress bar, the table, where the files are, and the exit code."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from hil.bench import benchmark_run, campaign_pool
from hil.bench.benchmark_run import BenchmarkOptions, PreparedBenchmark
from hil.campaigns import benchmark_table as texts
from hil.campaigns.contests import Contest
from hil.campaigns.row import Row
from hil.campaigns.standing import Standings
from hil.campaigns.standings import how_it_ended
from hil.campaigns.store import Store
from hil.cli import exit_codes
from hil.cli.run_progress import run_progress
from hil.core.counted import counted

MIN_WIDTH = 140
MAX_NAMED = 5


def run(console: Console, benchmark: str | Path, options: BenchmarkOptions) -> int:
    """The whole benchmark; returns the exit code. Raises SettingsError and RunFolderError before any run is made."""
    prepared = benchmark_run.prepare(benchmark, options)
    folder = benchmark_run.open_folder(prepared, options.out)
    total = len(prepared.contests)
    if folder.done:
        console.print(f"Already there: {folder.done} of {counted(total, 'run')}.", highlight=False)
    if folder.strange:
        console.print(
            f"Left out: {counted(folder.strange, 'run')} in {folder.store.path}, not of this benchmark as it is now "
            "(the spec, the bench's files or the program have changed, or it has fewer seeds).",
            highlight=False,
            soft_wrap=True,
        )
    if folder.done < total and not campaign_pool.has_dask():
        console.print(f"One process; for all cores: {campaign_pool.INSTALL}", highlight=False, markup=False)
    runs = _run_missing(console, prepared, folder.store, total - folder.done)
    standings = benchmark_run.standings_of(prepared, runs)
    show(console, standings)
    _show_endings(console, runs)
    for file in benchmark_run.write_results(prepared, folder.store, runs, standings, report=options.report):
        console.print(str(file), highlight=False, soft_wrap=True)
    return exit_codes.BROKEN_INVARIANT if any(row.breaks for _, row in runs) else 0


def show(console: Console, standings: Standings) -> None:
    """The table of each rig: wide, or a few lines for each entrant on a narrow terminal."""
    if not console.is_terminal:
        console.width = max(console.width, MIN_WIDTH)
    console.print(f"{counted(len(standings.seeds), 'seed')}, {standings.seeds[0]} to {standings.seeds[-1]}.",
                  highlight=False)  # fmt: skip
    for rig in standings.rigs:
        heads = texts.heads([course for course in standings.courses if course.rig == rig])
        lines = texts.lines(standings, rig)
        if console.width < MIN_WIDTH:
            for line in lines:
                console.print(line[0], highlight=False, markup=False)
                for head, cell in zip(heads[1:], line[1:], strict=True):
                    console.print(f"  {head}: {cell}", highlight=False, markup=False)
            continue
        parts = 1 + len(texts.SUMMARY_HEADS)
        console.print(_table(f"Rig {rig}", heads[:parts], [line[:parts] for line in lines]))
        console.print(
            _table(
                f"Rig {rig}: IAE of outputs 1 / 2 [V s], medians",
                [heads[0], *heads[parts:]],
                [[line[0], *line[parts:]] for line in lines],
            )
        )


def _table(title: str, heads: Sequence[str], lines: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left")
    for place, head in enumerate(heads):
        wrapped = head.replace(": ", ":\n").replace(" [", "\n[").replace(" (over", "\n(over")
        table.add_column(wrapped, justify="right" if place else "left", no_wrap=not place)
    for line in lines:
        table.add_row(*line)
    return table


def _show_endings(console: Console, runs: tuple[tuple[Contest, Row], ...]) -> None:
    """Runs that tripped, stopped or broke an invariant."""
    causes: dict[str, int] = {}
    for _, row in runs:
        if how := how_it_ended(row):
            causes[how] = causes.get(how, 0) + 1
    if causes:
        named = ", ".join(f"{cause} {count}" for cause, count in causes.items())
        console.print(f"Did not go on to their end: {named}", highlight=False, markup=False, soft_wrap=True)
    guilty = [(contest, row) for contest, row in runs if row.breaks]
    for contest, row in guilty[:MAX_NAMED]:
        console.print(
            f"broken: {contest.case.label}, {contest.scenario}, seed {row.seed}: {row.broken}",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
    if not guilty:
        console.print(f"All invariants hold in {counted(len(runs), 'run')}.", highlight=False)
    steps = sum(row.steps for _, row in runs)
    if steps:
        cpu_s = sum(row.cpu_s for _, row in runs)
        console.print(
            f"{cpu_s:.0f} s of processor time, {cpu_s / len(runs):.2f} s a run, {1e6 * cpu_s / steps:.0f} µs a control "
            "step.",
            highlight=False,
        )


def _run_missing(
    console: Console, prepared: PreparedBenchmark, store: Store, missing: int
) -> tuple[tuple[Contest, Row], ...]:
    with run_progress(console, prepared.campaign.name, missing) as advance:
        return benchmark_run.run_missing(prepared, store, lambda _: advance())
