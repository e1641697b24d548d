"""The functions of `import hil`: load, simulate, run, campaign, design. Everything else in the package may move.

None of them touches the terminal. What a user can fix raises a subclass of `hil.HilError` before anything moves.
Why it is so: docs/decisions/0017-public-face.md.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from math import isfinite
from pathlib import Path

from hil.bench import assembly, campaign_run
from hil.bench.assembly import Bench, Watcher
from hil.bench.bus_choice import chosen_bus
from hil.bench.campaign_run import CampaignOptions
from hil.bench.design_figures import DesignFigures, design_figures
from hil.bench.results import CampaignResult, RunResult, result_of_folder
from hil.bench.run_options import RunOptions
from hil.campaigns.row import Row
from hil.core.control_law import ControlLaw
from hil.core.diagnosis.detector import FaultDetector
from hil.core.gain_design import GainDesign
from hil.edge.config.rig_file import load_rig
from hil.edge.config.settings_file import MAX_DURATION_S, SettingsError
from hil.edge.config.shipped import rig_file_in_use
from hil.edge.host.realtime import RealTime

StrPath = str | Path


def load(
    scenario: StrPath,
    rig: StrPath | None = None,
    config: StrPath | None = None,
    *,
    design: str | GainDesign | None = None,
    detector: str | FaultDetector | None = None,
    law: str | ControlLaw | None = None,
) -> Bench:
    """Read and check a scenario, the rig and the wire contract; nothing moves.

    Parameters
    ----------
    scenario : str or path
        A scenario file, or the name of a shipped one, such as ``"paper"``.
    rig : str or path, optional
        A rig file, or the name of a shipped one, such as ``"decenter2021"``, in place of the configuration's
        `rig.toml`. The emulator then is this rig, too, plus what the scenario's `[emulator]` table says otherwise.
    config : str or path, optional
        Folder with `rig.toml`, `emulator.toml` and `bench.dbc`; the shipped one by default.
    design : str or GainDesign, optional
        A design by name (`hil design` lists them) or an object of your own, in place of the scenario's.
    detector : str or FaultDetector, optional
        A fault detector by name or an object of your own, in place of the scenario's.
    law : str or ControlLaw, optional
        A control law by name or an object of your own, in place of the scenario's. The scenario's `[control.options]`
        are for its own law: another one has its defaults.

    Returns
    -------
    Bench
        What `simulate` and `run` take; its `scenario` and `rig` are the checked settings.

    Raises
    ------
    SettingsError
        Names the file, the key, the value and what is allowed; also when the design does not stabilise this rig.

    Examples
    --------
    >>> import hil
    >>> bench = hil.load("paper")
    >>> bench.rig.control.period_s
    0.1

    """
    return assembly.load(scenario, _path(config), rig=rig, design=design, detector=detector, law=law)


def simulate(
    scenario: StrPath | Bench,
    *,
    rig: StrPath | None = None,
    config: StrPath | None = None,
    design: str | GainDesign | None = None,
    detector: str | FaultDetector | None = None,
    law: str | ControlLaw | None = None,
    seed: int = 1,
    duration_s: float | None = None,
    out: StrPath | None = None,
    rerun: bool = True,
    on_progress: Callable[[int], None] | None = None,
) -> RunResult:
    """Run a scenario in lockstep with the emulator, every frame on a virtual CAN bus, faster than real time.

    Parameters
    ----------
    scenario : str, path or Bench
        A scenario file, a shipped name, or what `load` returned; then `rig`, `config`, `design`, `detector` and
        `law` are those of `load`.
    rig, config, design, detector, law : optional
        As for `load`.
    seed : int
        Of the emulator's noise and parameter spread. Equal seeds give equal results.
    duration_s : float, optional
        Length of the run in s, in place of the scenario's.
    out : str or path, optional
        Run folder to write; refused if it exists. Without it the record stays in memory and no file is written.
    rerun : bool
        Whether a run folder gets a recording for the Rerun viewer.
    on_progress : callable, optional
        Is called with the number of control steps made so far.

    Returns
    -------
    RunResult
        Key figures (those of `kpi.json`), time series as arrays, alarms and events.

    Raises
    ------
    SettingsError
        Before anything runs, for settings that can't be used.
    RunFolderError
        When `out` exists or can't be written.

    Examples
    --------
    >>> import hil
    >>> result = hil.simulate("paper", duration_s=5.0)
    >>> result.status, float(result.series["t_s"][1])
    ('complete', 0.1)

    """
    _check_whole("seed", seed, 0)
    _check_duration(duration_s)
    bench = _bench(scenario, rig, config, design, detector, law)
    if out is None:
        from hil.bench.memory_run import simulate_in_memory

        return simulate_in_memory(bench, seed=seed, duration_s=duration_s, on_progress=on_progress)
    from hil.bench.lockstep_run import simulate as simulate_into_folder

    folder = Path(out)
    kpi = simulate_into_folder(bench, RunOptions(folder, seed, duration_s, rerun), on_progress)
    return result_of_folder(folder, kpi)


def run(
    scenario: StrPath | Bench,
    *,
    out: StrPath,
    rig: StrPath | None = None,
    config: StrPath | None = None,
    design: str | GainDesign | None = None,
    detector: str | FaultDetector | None = None,
    law: str | ControlLaw | None = None,
    interface: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    duration_s: float | None = None,
    clear_trip: bool = False,
    rerun: bool = True,
    realtime: RealTime | None = None,
    on_tick: Watcher | None = None,
) -> RunResult:
    """Run a scenario in real time on a CAN bus: the rig's, or that of a started emulator; moves pumps.

    Parameters
    ----------
    scenario, rig, config, design, detector, law : optional
        As for `simulate`.
    out : str or path
        Run folder to write; refused if it exists.
    interface, channel : str, optional
        The bus in python-can's words, such as ``"slcan"`` and ``"/dev/ttyACM0"``; the rig file's by default.
    bitrate : int, optional
        In bit/s; the rig file's by default.
    duration_s : float, optional
        Length of the run in s, in place of the scenario's.
    clear_trip : bool
        Clear a trip that an earlier run left latched at the pump node.
    rerun : bool
        Whether the run folder gets a recording for the Rerun viewer.
    realtime : RealTime, optional
        Priority and processor to ask the system for.
    on_tick : callable, optional
        Is called with inputs, output and mode of every control step; it must not block.

    Returns
    -------
    RunResult
        As of `simulate`; true levels are NaN.

    Raises
    ------
    SettingsError, BusError, RunFolderError
        Before anything moves.

    Notes
    -----
    The function takes over SIGINT, SIGTERM and SIGHUP while the run lasts: each stops the pumps in order. Only the main
    thread can do that, so a call from any other one is a RuntimeError.

    Examples
    --------
    >>> import hil
    >>> hil.run("steps", out="runs/first", interface="socketcan", channel="can0")  # doctest: +SKIP

    """
    if threading.current_thread() is not threading.main_thread():
        raise RuntimeError("hil.run must be called from the main thread: only there Ctrl-C can stop the pumps")
    from hil.bench.live_run import run_live

    bench = _bench(scenario, rig, config, design, detector, law)
    address = chosen_bus(bench.rig, interface, channel, bitrate)
    folder = Path(out)
    options = RunOptions(folder, duration_s=duration_s, rerun=rerun, clear_trip=clear_trip, realtime=realtime)
    kpi, _ = run_live(bench, options, address, on_tick)
    return result_of_folder(folder, kpi)


def campaign(
    spec: StrPath,
    *,
    rig: StrPath | None = None,
    config: StrPath | None = None,
    seeds: int | None = None,
    first_seed: int | None = None,
    duration_s: float | None = None,
    processes: int = 1,
    scheduler: str | None = None,
    out: StrPath | None = None,
    report: bool = True,
    on_row: Callable[[Row], None] | None = None,
) -> CampaignResult:
    """Run scenarios times faults times seeds in lockstep and report the outcome of each run.

    Parameters
    ----------
    spec : str or path
        A campaign file, a scenario file, a folder of scenarios, or a shipped name.
        Designs, detectors and laws are chosen by name in these files.
    rig : str or path, optional
        As for `load`.
    config : str or path, optional
        Folder with `rig.toml`, `emulator.toml` and `bench.dbc`; the shipped one by default.
    seeds, first_seed : int, optional
        How many seeds each case runs with, and the first of them; the campaign file's by default.
    duration_s : float, optional
        Length of each run in s. A fault that would begin later is refused.
    processes : int
        Runs beside each other. More than one needs Dask, and the calling script a main guard
        (``if __name__ == "__main__":``), because each process imports it.
    scheduler : str, optional
        Address of a Dask scheduler, ``"tcp://host:8786"``.
    out : str or path, optional
        The campaign's folder; runs that are in it are not repeated. Without it nothing is written.
    report : bool
        Whether the folder gets `report.html`.
    on_row : callable, optional
        Is called with each row as its run ends.

    Returns
    -------
    CampaignResult
        One row for each run, and statistics for each class of faults.

    Raises
    ------
    SettingsError, RunFolderError
        Before the first run. A run that raises becomes a row that says so.

    Examples
    --------
    >>> import hil
    >>> result = hil.campaign("paper", seeds=2, duration_s=205.0)
    >>> [row.detected for row in result.rows]
    [True, True]

    """
    _check_duration(duration_s)
    for name, value, least in (("seeds", seeds, 1), ("first_seed", first_seed, 0), ("processes", processes, 1)):
        if value is not None:
            _check_whole(name, value, least)
    options = CampaignOptions(
        _path(out), _path(config), rig, seeds, first_seed, duration_s, processes, scheduler, report
    )
    prepared = campaign_run.prepare(spec, options)
    store = None if out is None else campaign_run.open_store(prepared, Path(out))
    rows = campaign_run.run_missing(prepared, store, on_row or (lambda _: None))
    if store is not None:
        campaign_run.write_results(prepared, store, rows, report=report)
    return CampaignResult(prepared.name, rows, None if store is None else store.path)


def design(
    design: str | GainDesign = "rig", *, rig: StrPath | None = None, config: StrPath | None = None
) -> DesignFigures:
    """Gains, poles, noise gain and robustness of a design on a rig.

    Parameters
    ----------
    design : str or GainDesign
        Its name in the table of designs, or an object of your own.
    rig : str or path, optional
        A rig file, or the name of a shipped one, in place of the configuration's `rig.toml`.
    config : str or path, optional
        Folder with `rig.toml`; the shipped one by default.

    Returns
    -------
    DesignFigures
        Gains, poles, condition number, noise gain, and the slowest pole after the loss of a pump.

    Raises
    ------
    SettingsError
        When the design is not known or can't be had on this rig.

    Examples
    --------
    >>> import hil
    >>> figures = hil.design("rig")
    >>> figures.K.shape, figures.is_stable
    ((2, 6), True)

    """
    path = rig_file_in_use(rig, _path(config))
    return design_figures(load_rig(path), design, str(path))


def _bench(
    scenario: StrPath | Bench,
    rig: StrPath | None,
    config: StrPath | None,
    design: str | GainDesign | None,
    detector: str | FaultDetector | None,
    law: str | ControlLaw | None,
) -> Bench:
    if not isinstance(scenario, Bench):
        return load(scenario, rig, config, design=design, detector=detector, law=law)
    if any(given is not None for given in (rig, config, design, detector, law)):
        raise TypeError(
            "rig, config, design, detector and law are chosen when the scenario is loaded: give them to hil.load"
        )
    return scenario


def _path(given: StrPath | None) -> Path | None:
    return None if given is None else Path(given)


def _check_duration(duration_s: float | None) -> None:
    """Refuse what is no duration. Raises SettingsError."""
    if duration_s is None:
        return
    is_number = isinstance(duration_s, (int, float)) and not isinstance(duration_s, bool)
    if not (is_number and isfinite(duration_s) and 0.0 <= duration_s <= MAX_DURATION_S):
        raise SettingsError(f"duration_s = {duration_s!r}: must be a number of seconds within 0..{MAX_DURATION_S:g}")


def _check_whole(name: str, value: int, least: int) -> None:
    """Refuse what is no whole number of at least `least`. Raises SettingsError."""
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise SettingsError(f"{name} = {value!r}: must be a whole number, at least {least}")
