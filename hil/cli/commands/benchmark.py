"""`hil benchmark`: laws times detectors times rigs times scenarios times seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.options import ConfigDir, ManyProcesses, ReportChoice, SchedulerAddress

EXAMPLE = "hil benchmark fault_tolerant_four_tank --seeds 5 --out runs/benchmark"


def benchmark(
    spec: Annotated[
        Path,
        typer.Argument(metavar="BENCHMARK", help="A benchmark file, or a shipped name."),
    ],
    seeds: Annotated[Optional[int], typer.Option(min=1, help="Seeds. Default: the file's, else 20.")] = None,
    first_seed: Annotated[
        Optional[int], typer.Option(min=0, help="The first seed. Default: the file's, else 50001.")
    ] = None,
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="DIR", help="The benchmark's folder; runs that are in it are not repeated."),
    ] = None,
    config: ConfigDir = None,
    processes: ManyProcesses = None,
    scheduler: SchedulerAddress = None,
    report: ReportChoice = True,
) -> None:
    """Compare control laws and detectors on the same rigs, scenarios and seeds: one table, and a report.

    Stopped by Ctrl-C, the same command goes on where it was. Exit code 3: a run broke an invariant, see hil campaign.
    docs/how-to/benchmark.md says how entrants are compared.
    """
    from hil.bench.benchmark_run import BenchmarkOptions
    from hil.cli import benchmark_command as benchmarks

    options = BenchmarkOptions(out, config, seeds, first_seed, processes, scheduler, report)
    raise typer.Exit(benchmarks.run(Console(), spec, options))
