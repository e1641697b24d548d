"""One run of a scenario's test, in lockstep or on a bench, and its verdicts."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.bench import assembly, lockstep_run, run_options
from hil.bench.assembly import Bench, Watcher
from hil.bench.memory_run import simulate_in_memory
from hil.bench.run_record import check_complete
from hil.edge.can.bus import BusAddress
from hil.edge.config.accept_table import AcceptTable
from hil.edge.config.settings_file import SettingsError, default_config_dir, of_all
from hil.edge.config.shipped import SCENARIOS, find_scenario
from hil.edge.record.record_errors import IncompleteRecordError, RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.acceptance import verdicts
from hil.review.alarms import injected
from hil.review.judged_scenario import JudgedScenario
from hil.review.kpi import Kpi

NO_LIMITS = "no [[accept]] table"
ENDINGS = ("status", "trips", "reason")
"""A limit on one of these figures says itself how the run has to end."""


@dataclass(frozen=True)
class AcceptanceRun:
    """What to run and judge; can be sent to another process.

    scenario : the file. out : run folder. report : whether it gets report.html. clear_trip : on a bench.
    """

    scenario: Path
    out: Path
    config_dir: Path | None = None
    rig: str | None = None
    seed: int = 1
    rerun: bool = False
    report: bool = False
    clear_trip: bool = False

    def load(self) -> Bench:
        """The bench, with a scenario that can be judged. Raises SettingsError."""
        bench = assembly.load(self.scenario, self.config_dir, rig=self.rig)
        if bench.scenario.accept:
            run_options.check_length(bench, None)
            check_limits(bench)
        return bench


def scenario_files(paths: Sequence[Path], config_dir: Path | None) -> dict[Path, bool]:
    """The files of folders, files and shipped names, and whether each was asked for itself.

    paths : empty for the scenarios of the configuration. Raises SettingsError.
    """
    found: dict[Path, bool] = {}
    for path in paths or ((config_dir or default_config_dir()) / SCENARIOS,):
        if path.is_dir():
            files = sorted(path.glob("*.toml"))
            if not files:
                raise SettingsError(f"{path}: there is no scenario (*.toml) in this folder")
            found.update({file: found.get(file, False) for file in files})
        else:
            found[find_scenario(path, config_dir)] = True
    return found


def check_limits(bench: Bench) -> None:
    """Raise SettingsError for a limit that says nothing on this bench: no such window, above the tanks, no fault."""
    windows = {window.name for window in bench.scenario.window}
    height_cm = max(of_all(bench.rig.tanks.height_cm))
    has_fault = any(fault.is_of_the_process for fault in injected(_faults(bench)))
    for accept in bench.scenario.accept:
        if accept.window is not None and accept.window not in windows:
            raise SettingsError(
                f"{bench.scenario_path}: accept {accept.name!r}: window = {accept.window!r}: must be one of "
                f"{', '.join(sorted(windows)) or 'the windows, and there is none'}"
            )
        if accept.level_max_cm is not None and accept.level_max_cm > height_cm:
            raise SettingsError(
                f"{bench.scenario_path}: accept {accept.name!r}: level_max_cm = {accept.level_max_cm:g}: must be at "
                f"most {height_cm:g}, the height of the tanks in {bench.rig_path}, or it is always kept"
            )
        if accept.detected_within_s is not None and not has_fault:
            raise SettingsError(
                f"{bench.scenario_path}: accept {accept.name!r}: detected_within_s = {accept.detected_within_s:g}: "
                "needs a [[fault]] of the process in the scenario"
            )


def judge_in_lockstep(asked: AcceptanceRun, loaded: Bench | None = None) -> JudgedScenario:
    """Run with the emulator in simulated time, and judge. loaded : what `asked.load` gave, where it is known.

    Raises SettingsError before the first step. A record that can't be begun or is incomplete is the scenario's error.
    """
    bench = loaded or asked.load()
    began, began_s = datetime.now(), time.perf_counter()
    how = run_options.RunOptions(asked.out, asked.seed, None, asked.rerun)
    one = JudgedScenario(
        bench.scenario.scenario.name,
        folder=asked.out,
        began=began,
        about=_about_lockstep(bench, asked),
    )
    try:
        figures = lockstep_run.simulate(bench, how)
        return _judged(bench, asked, one, figures, time.perf_counter() - began_s)
    except RunFolderError as error:
        return replace(one, error=str(error), duration_s=time.perf_counter() - began_s)


def judge_in_memory(asked: AcceptanceRun, bench: Bench) -> JudgedScenario:
    """As `judge_in_lockstep`, without a run folder. Raises SettingsError before the first step."""
    began, began_s = datetime.now(), time.perf_counter()
    result = simulate_in_memory(bench, seed=asked.seed, duration_s=None)
    one = JudgedScenario(bench.scenario.scenario.name, began=began, about=_about_lockstep(bench, asked))
    return _with_verdicts(bench, one, result.kpi, time.perf_counter() - began_s)


def judge_live(
    bench: Bench, asked: AcceptanceRun, address: BusAddress, on_tick: Watcher | None = None
) -> tuple[JudgedScenario, str, str]:
    """Run on a bus in real time, and judge; also how the run ended, as status and reason.

    Raises SettingsError, RunFolderError, BusError before any pump moves.
    """
    from hil.bench.live_run import run_live

    began, began_s = datetime.now(), time.perf_counter()
    how = run_options.RunOptions(asked.out, rerun=asked.rerun, clear_trip=asked.clear_trip)
    one = JudgedScenario(
        bench.scenario.scenario.name,
        folder=asked.out,
        began=began,
        about=(("mode", "live"), ("bus", f"{address.interface} {address.channel}"), ("rig", bench.rig_path.name)),
    )
    try:
        figures, outcome = run_live(bench, how, address, on_tick)
        judged = _judged(bench, asked, one, figures, time.perf_counter() - began_s)
    except IncompleteRecordError as error:
        return replace(one, error=str(error), duration_s=time.perf_counter() - began_s), error.status, error.reason
    return judged, outcome.status, outcome.reason


def is_end_judged(accepts: Sequence[AcceptTable]) -> bool:
    """Whether a limit says how the run has to end; otherwise it has to be complete."""
    return any(
        accept.trip is not None or (accept.figure or "").partition(".")[0].partition("[")[0] in ENDINGS
        for accept in accepts
    )


def _judged(bench: Bench, asked: AcceptanceRun, one: JudgedScenario, figures: Kpi, duration_s: float) -> JudgedScenario:
    """The verdicts; an error for a run that failed, or that ended where no limit expects it.

    Raises IncompleteRecordError for a record with gaps.
    """
    folder = RunFolder.open(asked.out)
    if asked.report:
        from hil.review.run_report import write_report

        write_report(folder)
    check_complete(folder, figures)
    return _with_verdicts(bench, one, figures, duration_s)


def _about_lockstep(bench: Bench, asked: AcceptanceRun) -> tuple[tuple[str, str], ...]:
    return (("mode", "lockstep"), ("seed", str(asked.seed)), ("rig", bench.rig_path.name))


def _with_verdicts(bench: Bench, one: JudgedScenario, figures: Kpi, duration_s: float) -> JudgedScenario:
    accepts = bench.scenario.accept
    found = verdicts(accepts, asdict(figures), _faults(bench))
    is_ended = figures.status == "complete" or (figures.status == "tripped" and is_end_judged(accepts))
    error = "" if is_ended else f"the run did not go to its end: {figures.status}, {figures.reason}"
    return replace(one, verdicts=found, duration_s=duration_s, error=error)


def _faults(bench: Bench) -> list[Mapping[str, Any]]:
    """As the settings of a record have them."""
    return [fault.model_dump(mode="json") for fault in bench.scenario.fault]
