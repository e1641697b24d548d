"""`hil campaign`: from the campaign file to the table of outcomes, the report and the exit code."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from hil.bench import campaign_case, campaign_pool
from hil.campaigns import cases as listing
from hil.campaigns import summary
from hil.campaigns.cases import PAIRS, Case
from hil.campaigns.row import Row
from hil.campaigns.spec import load_spec
from hil.campaigns.store import Store
from hil.edge.config.settings_file import SettingsError, default_config_dir, read_toml
from hil.version import __version__

EXIT_BROKEN = 3
RESULTS_DEPEND_ON = ("rig.toml", "emulator.toml", "bench.dbc")


@dataclass(frozen=True)
class CampaignOptions:
    """What the command line says; None: as the campaign file, or this machine, has it."""

    out: Path | None = None
    config_dir: Path | None = None
    seeds: int | None = None
    first_seed: int | None = None
    duration_s: float | None = None
    processes: int | None = None
    scheduler: str | None = None
    report: bool = True


def run(console: Console, path: Path, options: CampaignOptions) -> int:
    """The whole campaign; returns the exit code. Raises SettingsError and RunFolderError before any run is made."""
    config_dir = (options.config_dir or default_config_dir()).resolve()
    name, cases = load(path, config_dir, options)
    processes = campaign_pool.processes_for(options.processes, options.scheduler)
    folder = options.out or Path("runs") / f"campaign_{name}"
    store = Store.open(folder, {"name": name, "cases": len(cases), "version": __version__})
    done = store.rows()
    todo = [case for case in cases if case.key not in done]
    if len(todo) < len(cases):
        console.print(f"{len(cases) - len(todo)} of {len(cases)} runs are there already.", highlight=False)
    if todo and not campaign_pool.has_dask():
        console.print(f"One process; for all cores: {campaign_pool.INSTALL}", highlight=False, markup=False)
    done |= _run_all(console, store, name, todo, config_dir, processes, options.scheduler)
    return _conclude(console, store, name, cases, [done[case.key] for case in cases], report=options.report)


def load(path: Path, config_dir: Path, options: CampaignOptions) -> tuple[str, tuple[Case, ...]]:
    """The campaign's name and its cases, checked: the first of each class, and every pair. Raises SettingsError."""
    spec, files = load_spec(path)
    spec = listing.with_seeds(spec, options.seeds, options.first_seed, options.duration_s)
    stories = [read_toml(file) for file in files]
    cases = listing.expand(spec, stories, _digest(config_dir))
    seen: set[tuple[str, str]] = set()
    for case in cases:
        where = f"{path}: {case.scenario or '?'}: {case.label}"
        if case.label == PAIRS or (case.scenario, case.label) not in seen:
            seen.add((case.scenario, case.label))
            campaign_case.check(case, config_dir, where)
    if len({case.key for case in cases}) < len(cases):
        raise SettingsError(f"{path}: has the same case twice; look for repeated scenarios, targets or values")
    return spec.campaign.name, cases


def _run_all(
    console: Console,
    store: Store,
    name: str,
    cases: Sequence[Case],
    config_dir: Path,
    processes: int,
    scheduler: str | None,
) -> dict[str, Row]:
    """Make the runs; each is in the store as soon as it has ended."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    rows: dict[str, Row] = {}
    if not cases:
        return rows
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(name, total=len(cases))
        for row in campaign_pool.run_all(cases, config_dir, processes, scheduler):
            store.add(row)
            rows[row.key] = row
            bar.advance(task)
    return rows


def _conclude(
    console: Console, store: Store, name: str, cases: Sequence[Case], rows: Sequence[Row], *, report: bool
) -> int:
    table = store.write_table(rows)
    notable = frozenset(row.key for row in rows if row.breaks or row.false_alarms)
    kept = store.keep_scenarios(cases, notable)
    summary.show(console, rows)
    written = [table]
    if report:
        from hil.campaigns.campaign_report import write_report

        written.append(write_report(store, name, rows))
    if notable:
        written.append(kept)
    for file in written:
        console.print(str(file), highlight=False, soft_wrap=True)
    return EXIT_BROKEN if any(row.breaks for row in rows) else 0


def _digest(config_dir: Path) -> str:
    """Of all that results depend on beside the cases: the bench's files and this program's version."""
    digest = hashlib.sha256(__version__.encode())
    for name in RESULTS_DEPEND_ON:
        try:
            digest.update((config_dir / name).read_bytes())
        except OSError as error:
            raise SettingsError(f"{config_dir / name}: can't be read: {error.strerror}") from None
    return digest.hexdigest()
