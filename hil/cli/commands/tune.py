"""`hil tune`: the options of a control law on a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.complaint import interruptible
from hil.cli.options import ConfigDir, EmulatedRigFile, ManyProcesses

EXAMPLE = "hil tune --rig decenter2021 --out runs/tuned"


def tune(
    rig: EmulatedRigFile = None,
    config: ConfigDir = None,
    scenario: Annotated[
        Optional[Path],
        typer.Option(
            "--scenario",
            metavar="SCENARIO",
            help="With windows rest, step and loss; its table control names the law and its options. Default: tuning.",
        ),
    ] = None,
    candidates: Annotated[int, typer.Option(min=1, max=200, help="Candidates besides the present options.")] = 9,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds for each candidate.")] = 3,
    first_seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = 40_001,
    spread: Annotated[
        float, typer.Option(metavar="SHARE", min=0.0, max=0.5, help="The rigs of the runs are so far off their file.")
    ] = 0.03,
    noise_max: Annotated[
        Optional[float],
        typer.Option(metavar="MV", min=0.0, help="Largest noise of a command. Default: 1.1 times the present."),
    ] = None,
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="DIR", help="The folder of the tuning; runs that are in it are not repeated."),
    ] = None,
    processes: ManyProcesses = None,
    write: Annotated[
        bool, typer.Option("--write", help="Put the chosen options into the rig file, and keep a dated copy of it.")
    ] = False,
) -> None:
    """Try options of a control law: error after a step and after a loss, noise, margins. The choice has a stated rule.

    For the state feedback: its output poles. For other laws: the numbers among their options.
    docs/how-to/tune.md explains the table and the rule.
    """
    from hil.bench.tuning_run import TuneOptions
    from hil.cli import tune_command as tuning

    noise_max_V = None if noise_max is None else 1e-3 * noise_max
    options = TuneOptions(rig, config, scenario, candidates, seeds, first_seed, spread, noise_max_V, out, processes)
    with interruptible():
        raise typer.Exit(tuning.run(Console(), options, write=write))
