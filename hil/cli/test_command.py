"""`hil test` on the terminal: scenarios in lockstep or on a bench, a table of verdicts, a JUnit file, a page."""

from __future__ import annotations

import os
import platform
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from hil.bench.acceptance_pool import judge_all
from hil.bench.acceptance_run import NO_LIMITS, AcceptanceRun, judge_in_lockstep, scenario_files
from hil.bench.assembly import Bench
from hil.bench.bus_choice import chosen_bus
from hil.cli import exit_codes
from hil.cli.bench_test import on_bench
from hil.cli.run_progress import run_progress
from hil.edge.can.bus import BusAddress
from hil.edge.config.settings_file import SettingsError
from hil.edge.record.file_writing import write_to
from hil.review.judged_scenario import JudgedScenario, is_good, summary
from hil.review.junit import junit_text
from hil.review.verdict_page import verdict_page

Work = list[tuple[Bench, AcceptanceRun]]


@dataclass(frozen=True)
class LimitOptions:
    """Options of the command line. interface, channel, bitrate : None for all: in lockstep."""

    paths: tuple[Path, ...]
    out: Path
    junit: Path | None = None
    html: Path | None = None
    seed: int | None = None
    rig: str | None = None
    config_dir: Path | None = None
    rerun: bool = False
    processes: int | None = None
    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    clear_trip: bool = False

    @property
    def is_live(self) -> bool:
        """Whether the scenarios run on a bus."""
        return self.interface is not None or self.channel is not None


def run(console: Console, options: LimitOptions) -> int:
    """Run and judge all; returns the exit code. Raises SettingsError before the first run.

    Whatever ends the test, the files get the verdicts of the runs that were made.
    """
    _check(options)
    work, left_out = _load(options)
    for one in left_out:
        console.print(f"{one.name}: {one.not_run}, not run", highlight=False, markup=False, soft_wrap=True)
    tested: list[JudgedScenario] = []

    def add(one: JudgedScenario) -> None:
        tested.append(one)
        _show(console, one)

    code = 0
    try:
        if options.is_live:
            code = on_bench(console, [(*one, _address(one[0], options)) for one in work], add)
        else:
            with closing(_in_lockstep(console, work, options)) as found:
                for judged in found:
                    add(judged)
    finally:
        rest = [bench.scenario.scenario.name for bench, _ in work[len(tested) :]]
        tested += [JudgedScenario(name, not_run="the test was interrupted") for name in rest]
        console.print(f"{summary(tested)}; runs in {options.out}", highlight=False, soft_wrap=True)
        _write(options, [*tested, *left_out])
    return code or (0 if is_good(tested) else exit_codes.LIMIT_NOT_KEPT)


def _check(options: LimitOptions) -> None:
    """Raise SettingsError for options that contradict each other, and files that can't be written."""
    for option, value in (("--processes", options.processes), ("--seed", options.seed)):
        if options.is_live and value is not None:
            raise SettingsError(f"{option}: only in lockstep; on a bus the scenarios run one after the other")
    for option, is_given in (("--clear-trip", options.clear_trip), ("--bitrate", options.bitrate is not None)):
        if not options.is_live and is_given:
            raise SettingsError(f"{option}: only on a bus (-i, -c)")
    for file in (options.junit, options.html):
        if file is not None and (file.is_dir() or not file.absolute().parent.is_dir()):
            raise SettingsError(f"{file}: can't be written: {'a folder' if file.is_dir() else 'no such folder'}")


def _load(options: LimitOptions) -> tuple[Work, list[JudgedScenario]]:
    """What is to be run, and the scenarios without limits. Raises SettingsError."""
    work: Work = []
    left_out = []
    for path, is_asked_for in scenario_files(options.paths, options.config_dir).items():
        asked = AcceptanceRun(
            path,
            options.out,
            options.config_dir,
            options.rig,
            1 if options.seed is None else options.seed,
            options.rerun,
            report=options.html is not None,
            clear_trip=options.clear_trip,
        )
        bench = asked.load()
        name = bench.scenario.scenario.name
        if bench.scenario.accept:
            work.append((bench, replace(asked, out=options.out / name)))
        elif is_asked_for:
            raise SettingsError(f"{path}: accept: {NO_LIMITS}, so nothing to test; `hil simulate` runs it")
        else:
            left_out.append(JudgedScenario(name, not_run=NO_LIMITS))
    if not work:
        raise SettingsError("no scenario of these has an [[accept]] table: there is nothing to test")
    names = [bench.scenario.scenario.name for bench, _ in work]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise SettingsError(f"two scenarios have the name {repeated[0]!r}: each needs its own")
    return work, left_out


def _in_lockstep(console: Console, work: Work, options: LimitOptions) -> Generator[JudgedScenario, None, None]:
    """In the order of the files, whichever ends first."""
    processes = min(options.processes or os.cpu_count() or 1, len(work))
    with run_progress(console, "scenarios", len(work)) as advance:
        if processes == 1:
            for bench, asked in work:
                yield judge_in_lockstep(asked, bench)
                advance()
            return
        with closing(judge_all([asked for _, asked in work], processes)) as found:
            for judged in found:
                yield judged
                advance()


def _address(bench: Bench, options: LimitOptions) -> BusAddress:
    return chosen_bus(bench.rig, options.interface, options.channel, options.bitrate)


def _show(console: Console, tested: JudgedScenario) -> None:
    if tested.not_run:
        text = f"{tested.name}: not run: {tested.not_run}"
        console.print(text, markup=False, highlight=False, soft_wrap=True)
        return
    table = Table(title=f"{tested.name}: {tested.result}", title_justify="left")
    for head in ("limit", "value", "allowed", "when", ""):
        table.add_column(head, overflow="fold")
    for one in tested.verdicts:
        table.add_row(one.name, one.value, one.limit, one.when, "pass" if one.is_passed else "FAIL")
    if tested.verdicts:
        console.print(table, markup=False, highlight=False)
    if tested.error:
        console.print(f"{tested.name}: {tested.error}", markup=False, highlight=False, soft_wrap=True)


def _write(options: LimitOptions, tested: Sequence[JudgedScenario]) -> None:
    """The files. Raises IncompleteRecordError."""
    if options.junit is not None:
        write_to(options.junit, junit_text(tested, platform.node()))
    if options.html is not None:
        write_to(options.html, verdict_page(tested, options.html.absolute().parent))
