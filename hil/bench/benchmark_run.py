"""A whole benchmark without a terminal: load the cases, run those that are missing, write table and report."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import firmware_sim
import hil
from hil.bench import campaign_case, campaign_pool, campaign_run
from hil.bench.campaign_run import PreparedCampaign
from hil.campaigns import cases as listing
from hil.campaigns.benchmark_spec import BenchmarkSpec, load_benchmark_spec, with_benchmark_seeds
from hil.campaigns.contests import Contest, contests
from hil.campaigns.row import Row
from hil.campaigns.standing import Standings
from hil.campaigns.standings import Runs, how_it_ended, standings
from hil.campaigns.store import Store
from hil.edge.config.settings_file import SettingsError, default_config_dir, read_toml
from hil.edge.config.shipped import find_benchmark, find_rig
from hil.version import __version__

AFTER_THE_RUNS = ("benchmark_", "campaign_report", "delay_figures", "figure_text", "standing", "tuning_")
"""How the names of modules begin that only deal with rows of runs that have ended."""


@dataclass(frozen=True)
class BenchmarkOptions:
    """How to run a benchmark; None: as the benchmark file, or this machine, has it.

    out : its folder; rows that are in it are not run again. report : whether to write report.html.
    """

    out: Path | None = None
    config_dir: Path | None = None
    seeds: int | None = None
    first_seed: int | None = None
    processes: int | None = None
    scheduler: str | None = None
    report: bool = True


@dataclass(frozen=True)
class PreparedBenchmark:
    """A benchmark whose settings are checked. contests : all runs, in order. campaign : the same as a campaign."""

    spec: BenchmarkSpec
    contests: tuple[Contest, ...]
    campaign: PreparedCampaign


@dataclass(frozen=True)
class Opened:
    """The benchmark's folder. done : runs that are there already.

    strange : rows that are not of this benchmark: spec, files or program have changed, or there are fewer seeds.
    """

    store: Store
    done: int
    strange: int


def prepare(benchmark: str | Path, options: BenchmarkOptions) -> PreparedBenchmark:
    """Read and check everything; nothing is run or written. benchmark : path or shipped name. Raises SettingsError."""
    config_dir = (options.config_dir or default_config_dir()).resolve()
    path = find_benchmark(benchmark, options.config_dir)
    spec, files = load_benchmark_spec(path)
    spec = with_benchmark_seeds(spec, options.seeds, options.first_seed)
    return prepare_spec(spec, path, files, config_dir, options)


def prepare_spec(
    spec: BenchmarkSpec, path: Path, files: tuple[Path, ...], config_dir: Path, options: BenchmarkOptions
) -> PreparedBenchmark:
    """The benchmark of a spec. path : of the benchmark file, for messages. files : its scenarios.

    Raises SettingsError.
    """
    rig_files = [_rig_file(rig.file, path, options.config_dir) for rig in spec.rigs]
    try:
        found = contests(
            spec,
            [read_toml(file) for file in files],
            rig_files,
            lambda rig_file: campaign_run.results_digest(config_dir, rig_file) + program_digest(),
        )
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None
    seen: set[tuple[object, str]] = set()
    for contest in found:
        where = f"{path}: {contest.scenario or '?'}: {contest.case.label}"
        if (contest.entrant, contest.scenario) not in seen:
            seen.add((contest.entrant, contest.scenario))
            campaign_case.check(contest.case, config_dir, where)
            listing.check_faults_are_played(contest.case, where)
    cases = tuple(contest.case for contest in found)
    if len({case.key for case in cases}) < len(cases):
        raise SettingsError(f"{path}: has the same run twice: look for laws, detectors or rigs with the same settings")
    processes = campaign_pool.processes_for(options.processes, options.scheduler)
    campaign = PreparedCampaign(spec.benchmark.name, cases, config_dir, processes, options.scheduler)
    return PreparedBenchmark(spec, found, campaign)


def open_folder(benchmark: PreparedBenchmark, out: Path | None) -> Opened:
    """The benchmark's folder, `runs/benchmark_NAME` without `out`. Raises RunFolderError."""
    path = out or Path("runs") / f"benchmark_{benchmark.campaign.name}"
    about = {
        "name": benchmark.campaign.name,
        "cases": len(benchmark.contests),
        "version": __version__,
        "benchmark": benchmark.spec.model_dump(mode="json"),
    }
    store = Store.open(path, about)
    keys = {contest.case.key for contest in benchmark.contests}
    there = store.rows().keys()
    return Opened(store, len(keys & there), len(there - keys))


def run_missing(
    benchmark: PreparedBenchmark, store: Store | None, on_row: Callable[[Row], None]
) -> tuple[tuple[Contest, Row], ...]:
    """Run what the store has no row of; all runs with their rows, in order. store : None keeps them in memory."""
    rows = campaign_run.run_missing(benchmark.campaign, store, on_row)
    return tuple(zip(benchmark.contests, rows, strict=True))


def standings_of(benchmark: PreparedBenchmark, runs: Runs) -> Standings:
    """Who is ahead."""
    return standings(runs, benchmark.spec.benchmark.noise_window)


def write_results(
    benchmark: PreparedBenchmark, store: Store, runs: Runs, found: Standings, *, report: bool
) -> tuple[Path, ...]:
    """Write tables, report, and the scenarios of the runs that did not end or broke an invariant. Returns the files."""
    from hil.campaigns.benchmark_files import write_files
    from hil.campaigns.benchmark_report import write_benchmark_report  # draws: a second that others need not wait for

    name = benchmark.campaign.name
    written = [*write_files(store.path, name, runs, found), store.write_table([row for _, row in runs])]
    notable = frozenset(row.key for _, row in runs if row.breaks or how_it_ended(row))
    scenarios = store.keep_scenarios(benchmark.campaign.cases, notable)
    if report:
        written.append(write_benchmark_report(store.report_path, name, runs, found))
    return (*written, scenarios) if notable else tuple(written)


@cache
def program_digest() -> str:
    """Digest of the sources that a run depends on: a law that was changed is run again, a report is not."""
    digest = hashlib.sha256()
    for package in (hil, firmware_sim):
        folder = Path(str(package.__file__)).parent
        for file in sorted(folder.rglob("*.py")):
            if "cli" not in file.parts and not file.stem.startswith(AFTER_THE_RUNS):
                digest.update(file.read_bytes())
    return digest.hexdigest()


def _rig_file(rig: str | None, path: Path, config_dir: Path | None) -> Path | None:
    if rig is None:
        return None
    beside = path.parent / rig
    return (beside if beside.is_file() else find_rig(rig, config_dir)).resolve()
