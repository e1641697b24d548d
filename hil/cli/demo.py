"""`hil demo`: the paper's experiment four times over the virtual bus, and its table 3 beside the paper's numbers."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from hil.cli import build, experiment
from hil.edge.run_folder import RunFolder, RunFolderError
from hil.edge.settings import default_config_dir
from hil.review import table3
from hil.review.kpi import Kpi
from hil.review.report import write_report

SCENARIOS = ("paper_quick", "paper")
LEGEND = (
    "ideal: the paper's gain on its ideal plant, control period 50 ms.",
    "rig: decoupled outputs, 0.1 s, on a rig with pump lag, noise and 12 bit.",
    "Every level and every command went through CAN frames on a virtual bus.",
)
STRATEGIES = {"kept": False, "reconfigured": True}


@dataclass(frozen=True)
class Job:
    """One run of the demonstration, for a worker process."""

    scenario_path: Path
    config_dir: Path
    out: Path
    reconfigure: bool
    rerun: bool


def run(console: Console, out: Path, config_dir: Path | None) -> None:
    """Four runs on two cores, then the table and where to look. Raises SettingsError, RunFolderError."""
    config = config_dir or default_config_dir()
    folder = out / f"{datetime.now():%Y%m%d-%H%M%S}_demo"
    jobs = {
        f"{scenario}_{strategy}": Job(
            config / "scenarios" / f"{scenario}.toml",
            config,
            folder / f"{scenario}_{strategy}",
            reconfigure,
            rerun=scenario == "paper",
        )
        for scenario in SCENARIOS
        for strategy, reconfigure in STRATEGIES.items()
    }
    for job in jobs.values():
        build.load(job.scenario_path, config)  # bad input shows here, in one line, and not in a worker
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise RunFolderError(f"cannot make {folder}: {error.strerror}") from None
    figures = _run_all(console, jobs)
    console.print(_table(figures))
    for line in LEGEND:
        console.print(line, highlight=False)
    kept, reconfigured = (RunFolder.open(jobs[f"paper_{strategy}"].out) for strategy in STRATEGIES)
    report = write_report(reconfigured, kept)
    console.print(f"Report:    {report}", soft_wrap=True, highlight=False)
    console.print(
        f"Recording: {reconfigured.rrd_path}  (hil view {reconfigured.path})", soft_wrap=True, highlight=False
    )


def _work(job: Job) -> Kpi:
    bench = build.load(job.scenario_path, job.config_dir)
    choice = bench.scenario.control.model_copy(update={"reconfigure": job.reconfigure})
    bench = replace(bench, scenario=bench.scenario.model_copy(update={"control": choice}))
    return experiment.simulate(bench, experiment.Options(job.out, rerun=job.rerun))


def _run_all(console: Console, jobs: dict[str, Job]) -> dict[str, Kpi]:
    """All runs, over as many processes as there are cores."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    context = multiprocessing.get_context("spawn")
    workers = min(len(jobs), os.cpu_count() or 1)
    with (
        ProcessPoolExecutor(workers, mp_context=context) as pool,
        Progress(*columns, console=console, transient=True) as bar,
    ):
        task = bar.add_task("the paper's experiment, four runs of 500 s", total=len(jobs))
        futures: dict[str, Future[Kpi]] = {name: pool.submit(_work, job) for name, job in jobs.items()}
        for future in futures.values():
            future.add_done_callback(lambda _: bar.advance(task))
        return {name: future.result() for name, future in futures.items()}


def _table(figures: dict[str, Kpi]) -> Table:
    """Table 3 of the paper, its reproduction, and the rig's design on a realistic rig."""
    table = Table(title="Integral of the absolute error [V s]", title_justify="left")
    for name in ("window", "gains"):
        table.add_column(name)
    for name in ("output", "paper", "ideal", "off by", "rig"):
        table.add_column(name, justify="right")
    papers = {"kept": table3.PAPER_KEPT_VS, "reconfigured": table3.PAPER_RECONFIGURED_VS}
    for window in table3.TITLES:
        for strategy, paper in papers.items():
            reproduced = figures[f"paper_quick_{strategy}"].iae_Vs[window]
            rig = figures[f"paper_{strategy}"].iae_Vs[window]
            for output in (0, 1):
                theirs, ours = paper[window][output], reproduced[output]
                table.add_row(
                    window.replace("_", " ") if (strategy, output) == ("kept", 0) else "",
                    strategy if output == 0 else "",
                    str(output + 1),
                    table3.cell(theirs),
                    table3.cell(ours),
                    table3.deviation(ours, theirs),
                    table3.cell(rig[output]),
                    end_section=(strategy, output) == ("reconfigured", 1),
                )
    return table
