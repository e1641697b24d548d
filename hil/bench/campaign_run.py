"""A whole campaign without a terminal: load the cases, run those that are missing, write table and report."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hil.bench import campaign_case, campaign_pool
from hil.campaigns import cases as listing
from hil.campaigns.cases import PAIRS, Case
from hil.campaigns.rig_draw import RigNumbers
from hil.campaigns.row import Row
from hil.campaigns.spec import Spec, load_spec
from hil.campaigns.store import Store
from hil.edge.config.settings_file import SettingsError, default_config_dir, read_toml
from hil.edge.config.shipped import find_campaign, find_rig
from hil.version import __version__

RESULTS_DEPEND_ON = ("rig.toml", "emulator.toml", "bench.dbc")


@dataclass(frozen=True)
class CampaignOptions:
    """How to run a campaign; None: as the campaign file, or this machine, has it.

    out : its folder; rows that are in it are not run again. rig : path or shipped name. report : whether to write
    report.html.
    """

    out: Path | None = None
    config_dir: Path | None = None
    rig: str | Path | None = None
    seeds: int | None = None
    first_seed: int | None = None
    duration_s: float | None = None
    processes: int | None = None
    scheduler: str | None = None
    report: bool = True


@dataclass(frozen=True)
class PreparedCampaign:
    """A campaign whose settings are checked.

    cases : all of them, in order. processes : how many runs there are beside each other.
    """

    name: str
    cases: tuple[Case, ...]
    config_dir: Path
    processes: int
    scheduler: str | None


def prepare(campaign: str | Path, options: CampaignOptions) -> PreparedCampaign:
    """Read and check everything; nothing is run or written. campaign : path or shipped name. Raises SettingsError."""
    config_dir = (options.config_dir or default_config_dir()).resolve()
    name, cases = load(find_campaign(campaign, options.config_dir), config_dir, options)
    processes = campaign_pool.processes_for(options.processes, options.scheduler)
    return PreparedCampaign(name, cases, config_dir, processes, options.scheduler)


def load(path: Path, config_dir: Path, options: CampaignOptions) -> tuple[str, tuple[Case, ...]]:
    """The campaign's name and its cases, checked: the first of each class, every pair and every drawn rig.

    Raises SettingsError.
    """
    spec, files = load_spec(path)
    spec = listing.with_seeds(spec, options.seeds, options.first_seed, options.duration_s)
    rig_file = None if options.rig is None else find_rig(options.rig, options.config_dir).resolve()
    scenarios = [read_toml(file) for file in files]
    rigs = [] if spec.draw is None else [_numbers(spec, data, config_dir, rig_file, path) for data in scenarios]
    try:
        expanded = listing.expand(spec, scenarios, results_digest(config_dir, rig_file), rigs)
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None
    cases = tuple(replace(case, rig_file=rig_file) for case in expanded)
    seen: set[tuple[str, str]] = set()
    for case in cases:
        where = f"{path}: {case.scenario or '?'}: {case.label}"
        if case.label == PAIRS or (case.scenario, case.label) not in seen:
            seen.add((case.scenario, case.label))
            campaign_case.check(case, config_dir, where)
        elif case.drawn:
            campaign_case.check_settings(case, config_dir, f"{where}: seed {case.seed}")
        listing.check_faults_are_played(case, where)
    if len({case.key for case in cases}) < len(cases):
        raise SettingsError(f"{path}: has the same case twice; look for repeated scenarios, targets or values")
    return spec.campaign.name, cases


def _numbers(
    spec: Spec, scenario_data: dict[str, Any], config_dir: Path, rig_file: Path | None, path: Path
) -> RigNumbers:
    """The rig that a scenario's draws start from."""
    data = listing.with_overlay(spec, scenario_data)
    return campaign_case.rig_numbers(Case("", "", "", 0, data, rig_file=rig_file), config_dir, str(path))


def open_store(campaign: PreparedCampaign, out: Path | None) -> Store:
    """The campaign's folder, `runs/campaign_NAME` without `out`. Raises RunFolderError."""
    about = {"name": campaign.name, "cases": len(campaign.cases), "version": __version__}
    return Store.open(out or Path("runs") / f"campaign_{campaign.name}", about)


def run_missing(campaign: PreparedCampaign, store: Store | None, on_row: Callable[[Row], None]) -> tuple[Row, ...]:
    """Run the cases that the store has no row of, and return the rows of all, in the cases' order.

    Each row is in the store as soon as its run has ended. store : None keeps the rows in memory only.
    """
    done = {} if store is None else store.rows()
    missing = [case for case in campaign.cases if case.key not in done]
    if missing:
        for row in campaign_pool.run_all(missing, campaign.config_dir, campaign.processes, campaign.scheduler):
            if store is not None:
                store.add(row)
            done[row.key] = row
            on_row(row)
    return tuple(done[case.key] for case in campaign.cases)


def write_results(campaign: PreparedCampaign, store: Store, rows: Sequence[Row], *, report: bool) -> tuple[Path, ...]:
    """Write table, report, and the scenarios of runs with broken invariants, false alarms or a drawn rig.

    Returns the files.
    """
    written = [store.write_table(rows)]
    is_drawn = any(case.drawn for case in campaign.cases)
    notable = frozenset(row.key for row in rows if is_drawn or row.breaks or row.false_alarms)
    scenarios = store.keep_scenarios(campaign.cases, notable)
    if report:
        from hil.campaigns.campaign_report import write_report  # draws: a second that others need not wait for

        written.append(write_report(store, campaign.name, rows))
    return (*written, scenarios) if notable else tuple(written)


def results_digest(config_dir: Path, rig_file: Path | None) -> str:
    """Digest of what results depend on besides the cases: the bench's files and this program's version."""
    digest = hashlib.sha256(__version__.encode())
    for file in [config_dir / name for name in RESULTS_DEPEND_ON] + ([] if rig_file is None else [rig_file]):
        try:
            digest.update(file.read_bytes())
        except OSError as error:
            raise SettingsError(f"{file}: can't be read: {error.strerror}") from None
    return digest.hexdigest()
