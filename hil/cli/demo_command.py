"""`hil demo`: the paper's experiment over the virtual bus, and the same fault with each fault detector."""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Mapping
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from hil.bench import assembly, lockstep_run, run_options
from hil.bench.campaign_case import run_case
from hil.bench.run_record import check_complete
from hil.campaigns.cases import Case
from hil.cli import demo_tables
from hil.cli.demo_tables import GLR_DETECTOR, IDEAL_DETECTOR, NO_RECONFIGURATION, Figures
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import default_config_dir, merged, read_toml, validated
from hil.edge.record.new_folder import NewFolder
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.kpi import Kpi
from hil.review.run_report import write_report

NO_DETECTOR: dict[str, Any] = {"diagnosis": {"method": "none"}, "control": {"reconfigure": False}}
IDEAL: dict[str, Any] = {"diagnosis": {"method": "ideal", "delay_s": 1.0}}
GLR: dict[str, Any] = {"diagnosis": {"method": "glr"}}
SHORT: dict[str, Any] = {"scenario": {"duration_s": 350.0}}
"""Up to the end of the window in which the fault begins."""

RECORDED = ("glr_detector", "no_reconfiguration")
"""Folders of the two runs that are recorded."""

RIGS = (1, 2, 3)
"""Seeds: each draws the parameters of a rig, and its noise."""


@dataclass(frozen=True)
class Job:
    """One run of the demonstration, for a worker process.

    changes : laid over the scenario. record : the run folder; None: nothing is recorded.
    """

    scenario_path: Path
    config_dir: Path
    changes: Mapping[str, Any]
    seed: int = 1
    record: Path | None = None

    @property
    def scenario_data(self) -> dict[str, Any]:
        """The scenario as a dict, with the changes."""
        return merged(read_toml(self.scenario_path), dict(self.changes))


def run(console: Console, out: Path, config_dir: Path | None) -> None:
    """Run everything on all cores, print the tables and the paths. Raises SettingsError, RunFolderError."""
    config = config_dir or default_config_dir()
    folder = out / f"{datetime.now():%Y%m%d-%H%M%S}_demo"
    jobs = _jobs(config, folder)
    for path in {job.scenario_path for job in jobs.values()}:
        assembly.load(path, config)  # bad input is one line here, not a traceback of a worker
    try:
        made = NewFolder.make(folder)
    except OSError as error:
        raise RunFolderError(f"cannot make {folder}: {error.strerror}") from None
    try:
        figures = _run_all(console, jobs)
    except RunFolderError:
        made.remove_if_empty()
        raise
    for line in demo_tables.both(figures, RIGS, console.width):
        console.print(line, highlight=False)
    glr, without = (RunFolder.open(folder / name) for name in RECORDED)
    report = write_report(glr, without)
    console.print(f"Report:    {report}", soft_wrap=True, highlight=False)
    console.print(f"Recording: {glr.rrd_path}  (hil view {glr.path})", soft_wrap=True, highlight=False)


def _jobs(config: Path, folder: Path) -> dict[str, Job]:
    """The runs by the names that the tables use, the long ones first."""
    quick, rig, one = (config / f"scenarios/{name}.toml" for name in ("paper_quick", "paper_glr", "pump_loss"))
    glr, without = (folder / name for name in RECORDED)
    return {
        f"ideal plant, {NO_RECONFIGURATION}": Job(quick, config, NO_DETECTOR),
        f"ideal plant, {IDEAL_DETECTOR}": Job(quick, config, IDEAL),
        "recorded": Job(rig, config, GLR, record=glr),
        f"both pumps, {NO_RECONFIGURATION}": Job(rig, config, NO_DETECTOR, record=without),
        f"both pumps, {IDEAL_DETECTOR}": Job(rig, config, IDEAL),
        **{f"both pumps, {GLR_DETECTOR}, rig {seed}": Job(rig, config, GLR | SHORT, seed) for seed in RIGS},
        f"pump 1, {NO_RECONFIGURATION}": Job(one, config, NO_DETECTOR | SHORT),
        f"pump 1, {IDEAL_DETECTOR}": Job(one, config, IDEAL | SHORT),
        **{f"pump 1, {GLR_DETECTOR}, rig {seed}": Job(one, config, GLR | SHORT, seed) for seed in RIGS},
    }


def _work(job: Job) -> Figures:
    return _unrecorded(job) if job.record is None else _recorded(job, job.record)


def _recorded(job: Job, record: Path) -> Figures:
    bench = assembly.load(job.scenario_path, job.config_dir)
    bench = replace(bench, scenario=validated(Scenario, job.scenario_data, str(job.scenario_path)))
    kpi: Kpi = lockstep_run.simulate(bench, run_options.RunOptions(record, job.seed))
    check_complete(RunFolder.open(record), kpi)
    return Figures(kpi.iae_Vs)


def _unrecorded(job: Job) -> Figures:
    name = job.scenario_path.stem
    row = run_case(Case(name, name, name, job.seed, job.scenario_data), job.config_dir, lambda _: None)
    if row.crashed:
        raise RuntimeError(f"{name}, seed {job.seed}: {row.reason}")
    windows = {name: (iae[0], iae[1]) for name, iae in json.loads(row.iae_windows_json).items()}
    return Figures(windows, row.detection_s, row.isolation_s, row.size_error_1s)


def _run_all(console: Console, jobs: dict[str, Job]) -> dict[str, Figures]:
    """All runs, over as many processes as there are cores."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    context = multiprocessing.get_context("spawn")
    workers = min(len(jobs), os.cpu_count() or 1)
    with (
        ProcessPoolExecutor(workers, mp_context=context) as pool,
        Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        task = bar.add_task(f"the paper's experiment, {len(jobs)} runs", total=len(jobs))
        futures: dict[str, Future[Figures]] = {name: pool.submit(_work, job) for name, job in jobs.items()}
        for future in futures.values():
            future.add_done_callback(lambda _: bar.advance(task))
        wait(futures.values(), return_when=FIRST_EXCEPTION)
        pool.shutdown(wait=False, cancel_futures=True)  # after an error nobody waits for the rest
        return {name: future.result() for name, future in futures.items() if not future.cancelled()}
