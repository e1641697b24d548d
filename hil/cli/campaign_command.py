"""`hil campaign`: a progress bar, the table of outcomes, where the files are, and the exit code."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from hil.bench import campaign_pool, campaign_run
from hil.bench.campaign_run import CampaignOptions, PreparedCampaign
from hil.campaigns.row import Row
from hil.campaigns.store import Store
from hil.cli import campaign_tables, exit_codes
from hil.cli.run_progress import run_progress
from hil.core.counted import counted


def run(console: Console, campaign: str | Path, options: CampaignOptions) -> int:
    """The whole campaign; returns the exit code. Raises SettingsError and RunFolderError before any run is made."""
    prepared = campaign_run.prepare(campaign, options)
    store = campaign_run.open_store(prepared, options.out)
    done = len(prepared.cases) - len(_missing(prepared, store))
    if done:
        console.print(f"Already there: {done} of {counted(len(prepared.cases), 'run')}.", highlight=False)
    if done < len(prepared.cases) and not campaign_pool.has_dask():
        console.print(f"One process; for all cores: {campaign_pool.INSTALL}", highlight=False, markup=False)
    rows = _run_missing(console, prepared, store)
    campaign_tables.show(console, rows)
    for file in campaign_run.write_results(prepared, store, rows, report=options.report):
        console.print(str(file), highlight=False, soft_wrap=True)
    return exit_codes.BROKEN_INVARIANT if any(row.breaks for row in rows) else 0


def _missing(campaign: PreparedCampaign, store: Store) -> list[str]:
    done = store.rows()
    return [case.key for case in campaign.cases if case.key not in done]


def _run_missing(console: Console, campaign: PreparedCampaign, store: Store) -> tuple[Row, ...]:
    """The missing runs with a progress bar."""
    with run_progress(console, campaign.name, len(_missing(campaign, store))) as advance:
        return campaign_run.run_missing(campaign, store, lambda _: advance())
