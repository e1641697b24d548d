"""`hil test` on the terminal: scenarios one after the other, a table of verdicts, a JUnit file."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from hil.bench import assembly, lockstep_run, run_options
from hil.bench.assembly import Bench
from hil.cli import exit_codes
from hil.core.counted import counted
from hil.edge.config.settings_file import SettingsError
from hil.edge.config.shipped import find_scenario
from hil.edge.record.run_folder import RunFolderError
from hil.review.acceptance import LimitVerdict, verdicts
from hil.review.junit import JudgedScenario, write_junit


@dataclass(frozen=True)
class LimitOptions:
    """Options of the command line."""

    paths: tuple[Path, ...]
    out: Path
    junit: Path | None
    seed: int
    rig: str | None
    config_dir: Path | None
    rerun: bool


def run(console: Console, options: LimitOptions) -> int:
    """Run and judge all; returns the exit code. Raises SettingsError before the first run."""
    benches = []
    for path, is_asked_for in scenario_files(options.paths, options.config_dir).items():
        bench = _bench(path, options, is_asked_for=is_asked_for)
        if bench.scenario.accept:
            benches.append(bench)
        else:
            console.print(f"{path}: no [[accept]] table, not run", highlight=False, markup=False, soft_wrap=True)
    if not benches:
        raise SettingsError("no scenario of these has an [[accept]] table: there is nothing to test")
    names = [bench.scenario.scenario.name for bench in benches]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise SettingsError(f"two scenarios have the name {repeated[0]!r}: each needs its own")
    tested = []
    for bench in benches:
        tested.append(_tested(bench, options))
        _show(console, tested[-1])
    kept = sum(one.is_passed for one in tested)
    console.print(
        f"{kept} of {counted(len(tested), 'scenario')} passed; runs in {options.out}", highlight=False, soft_wrap=True
    )
    if options.junit is not None:
        try:
            write_junit(options.junit, tested)
        except OSError as error:
            raise SettingsError(f"{options.junit}: can't be written: {error.strerror}") from error
    return 0 if kept == len(tested) else exit_codes.LIMIT_NOT_KEPT


def scenario_files(paths: Sequence[Path], config_dir: Path | None) -> dict[Path, bool]:
    """The files of folders, files and shipped names, and whether each was asked for itself. Raises SettingsError."""
    found: dict[Path, bool] = {}
    for path in paths:
        if path.is_dir():
            files = sorted(path.glob("*.toml"))
            if not files:
                raise SettingsError(f"{path}: there is no scenario (*.toml) in this folder")
            found.update({file: found.get(file, False) for file in files})
        else:
            found[find_scenario(path, config_dir)] = True
    return found


def _bench(path: Path, options: LimitOptions, *, is_asked_for: bool) -> Bench:
    bench = assembly.load(path, options.config_dir, rig=options.rig)
    if is_asked_for and not bench.scenario.accept:
        raise SettingsError(f"{path}: accept: there is no [[accept]] table, so nothing to test; `hil simulate` runs it")
    run_options.check_length(bench, None)
    windows = {window.name for window in bench.scenario.window}
    for accept in bench.scenario.accept:
        if accept.window is not None and accept.window not in windows:
            raise SettingsError(
                f"{path}: accept {accept.name!r}: window = {accept.window!r}: must be one of "
                f"{', '.join(sorted(windows)) or 'the windows, and there is none'}"
            )
    return bench


def _tested(bench: Bench, options: LimitOptions) -> JudgedScenario:
    name, began_s = bench.scenario.scenario.name, time.perf_counter()
    how = run_options.RunOptions(options.out / name, options.seed, None, options.rerun)
    try:
        figures = lockstep_run.simulate(bench, how)
    except RunFolderError as error:
        return JudgedScenario(name, (), time.perf_counter() - began_s, str(error))
    faults = [fault.model_dump(mode="json") for fault in bench.scenario.fault]
    found = verdicts(bench.scenario.accept, asdict(figures), faults)
    return JudgedScenario(name, found, time.perf_counter() - began_s)


def _show(console: Console, tested: JudgedScenario) -> None:
    table = Table(title=f"{tested.name}: {'passed' if tested.is_passed else 'FAILED'}", title_justify="left")
    for head in ("limit", "value", "allowed", "when", ""):
        table.add_column(head, overflow="fold")
    for row in _rows(tested.verdicts):
        table.add_row(*row)
    console.print(table, markup=False, highlight=False)
    if tested.error:
        console.print(f"{tested.name}: {tested.error}", markup=False, highlight=False, soft_wrap=True)


def _rows(found: Iterable[LimitVerdict]) -> Iterable[tuple[str, ...]]:
    for one in found:
        yield one.name, one.value, one.limit, one.when, "pass" if one.is_passed else "FAIL"
