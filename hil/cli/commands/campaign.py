"""`hil campaign`: scenarios times faults times seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.options import ConfigDir, Duration, EmulatedRigFile, ManyProcesses, ReportChoice, SchedulerAddress

EXAMPLE = "hil campaign pump_losses --seeds 20 --out runs/losses"


def campaign(
    spec: Annotated[
        Path,
        typer.Argument(
            metavar="CAMPAIGN", help="A campaign file, a scenario file, a folder of scenarios, or a shipped name."
        ),
    ],
    seeds: Annotated[
        Optional[int], typer.Option(min=1, help="Seeds for each case. Default: the file's, else 10.")
    ] = None,
    first_seed: Annotated[
        Optional[int], typer.Option(min=0, help="The first seed. Default: the file's, else 1.")
    ] = None,
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="DIR", help="The campaign's folder; runs that are in it are not repeated."),
    ] = None,
    duration: Duration = None,
    rig: EmulatedRigFile = None,
    config: ConfigDir = None,
    processes: ManyProcesses = None,
    scheduler: SchedulerAddress = None,
    report: ReportChoice = True,
) -> None:
    """Run scenarios times faults times seeds: a table of outcomes and a report. Exit code 3: a run broke an invariant.

    The invariants must hold in every run: no tank overflows, voltages stay in their range, pumps stop after a trip.
    docs/how-to/campaign.md has all of them.
    """
    from hil.bench.campaign_run import CampaignOptions
    from hil.cli import campaign_command as campaigns

    options = CampaignOptions(out, config, rig, seeds, first_seed, duration or None, processes, scheduler, report)
    raise typer.Exit(campaigns.run(Console(), spec, options))
