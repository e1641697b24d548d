"""Build the objects of a run, live or in lockstep, from configuration files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.design_figures import stable_ones
from hil.bench.designs import DESIGNS
from hil.bench.detectors import DETECTORS
from hil.bench.dry_step import FAILURES, DryStepError, try_out
from hil.bench.law_choices import STATE_FEEDBACK, make_law
from hil.bench.law_setup import LawSetup
from hil.bench.reference_plan import reference_plan
from hil.core.active_isolation import ProbeConfig
from hil.core.closed_loop import LoopConfig
from hil.core.control_law import ControlLaw
from hil.core.controller import ControllerConfig, Output
from hil.core.diagnosis.detector import FaultDetector
from hil.core.eigenstructure import DesignError
from hil.core.estimator import LevelFilter
from hil.core.gain_design import GainDesign
from hil.core.interlocks import Limits
from hil.core.start_phase import StartConfig
from hil.core.types import Action, Event, Inputs, Mode, Quad, Request, TripCause
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.scenario_file import DiagnosisChoice, OperatorRequest, Scenario, load_scenario
from hil.edge.config.settings_file import SettingsError, default_config_dir, read_text
from hil.edge.config.shipped import find_rig, find_scenario
from hil.edge.record.run_folder import RunPlan, Window
from hil.loop import ControlLoop, OperatorChannel, Port, Recorder
from hil.wire.command_sender import CommandSender
from hil.wire.contract import Contract, ContractError

Watcher = Callable[[Inputs, Output, Mode], None]


@dataclass(frozen=True)
class Bench:
    """A scenario with the rig and the contract that it runs on, all checked, and the files that they came from.

    rig_file : a rig file for controller and emulator; None: `rig.toml` and `emulator.toml` of the configuration folder.
    design, detector, law : objects of the user's own, used instead of what the scenario names; None: what it names.
    shown : names of the numbers that the law has recorded.
    """

    scenario: Scenario
    rig: Rig
    contract: Contract
    scenario_path: Path
    config_dir: Path
    rig_file: Path | None = None
    design: GainDesign | None = None
    detector: FaultDetector | None = None
    law: ControlLaw | None = None
    shown: tuple[str, ...] = ()

    @property
    def rig_path(self) -> Path:
        """The rig file."""
        return self.rig_file or self.config_dir / "rig.toml"

    @property
    def emulator_path(self) -> Path:
        """The emulator's own file."""
        return self.config_dir / "emulator.toml"

    @property
    def dbc_path(self) -> Path:
        """The wire contract's file."""
        return self.config_dir / "bench.dbc"


def load(
    scenario: str | Path,
    config_dir: Path | None = None,
    *,
    rig: str | Path | None = None,
    design: str | GainDesign | None = None,
    detector: str | FaultDetector | None = None,
    law: str | ControlLaw | None = None,
) -> Bench:
    """Read and check everything; raises SettingsError with one line that names file and key.

    scenario, rig : path or shipped name. design, detector, law : a name or an object in place of the scenario's.
    """
    config = config_dir or default_config_dir()
    path = find_scenario(scenario, config_dir)
    rig_file = None if rig is None else find_rig(rig, config_dir)
    settings = _with_choices(load_scenario(path), design, detector, law)
    bench = Bench(
        settings,
        load_rig(rig_file or config / "rig.toml", settings, path),
        load_contract(config / "bench.dbc"),
        path,
        config,
        rig_file,
        None if isinstance(design, str) else design,
        None if isinstance(detector, str) else detector,
        None if isinstance(law, str) else law,
    )
    return replace(bench, shown=check(bench))


def check(bench: Bench) -> tuple[str, ...]:
    """Try the settings out before anything moves; the names of the numbers that the law shows.

    Raises SettingsError that names the file and what is wrong.
    """
    control = bench.scenario.control
    choice = f"design {control.design!r}" if control.law == STATE_FEEDBACK else f"law {control.law!r}"
    try:
        with np.errstate(all="ignore"):  # values that are not finite are refused below
            return try_out(controller_config(bench))
    except SettingsError:
        raise
    except DryStepError as error:
        raise SettingsError(f"{_where(bench)}: control ({choice}): {error}") from None
    except FAILURES as error:
        what = f"{type(error).__name__}: {error}"
        raise SettingsError(f"{_where(bench)}: no controller can be computed from these values: {what}") from None


def _where(bench: Bench) -> str:
    """The file that a wrong rig or design comes from."""
    return f"{bench.scenario_path} [rig] over {bench.rig_path}" if bench.scenario.rig else str(bench.rig_path)


def _with_choices(
    scenario: Scenario,
    design: str | GainDesign | None,
    detector: str | FaultDetector | None,
    law: str | ControlLaw | None,
) -> Scenario:
    """The scenario with the names of what is used; an object has its class's name.

    Options are those of the scenario's law: another one begins with its defaults.
    """
    control: dict[str, Any] = {}
    changes: dict[str, Any] = {}
    if design is not None:
        control["design"] = _name(design)
    if law is not None and _name(law) != scenario.control.law:
        control |= {"law": _name(law), "options": {}}
    if control:
        changes["control"] = scenario.control.model_copy(update=control)
    if detector is not None:
        changes["diagnosis"] = scenario.diagnosis.model_copy(update={"method": _name(detector)})
    return scenario.model_copy(update=changes)


def _name(choice: object) -> str:
    return choice if isinstance(choice, str) else type(choice).__name__


def load_contract(path: Path) -> Contract:
    """The wire contract from a DBC file. Raises SettingsError that names the file and what is wrong with it."""
    try:
        return Contract.from_dbc(read_text(path))
    except ContractError as error:
        raise SettingsError(f"{path}: {error}") from None


def controller_config(bench: Bench, duration_s: float | None = None) -> ControllerConfig:
    """The controller of this scenario on this rig. Raises SettingsError when no design meets the rig file."""
    rig, scenario = bench.rig, bench.scenario
    model, path = rig.tank_model, rig.pump_path
    references, moves = reference_plan(scenario, rig, str(bench.scenario_path))
    loop = LoopConfig(
        law=_control_law(bench),
        detector=_fault_detector(bench),
        level_filter=LevelFilter(model, rig.lags_s, rig.control.level_filter_s),
        references=references,
        moves=moves,
        reconfigure=scenario.control.reconfigure,
        period_s=rig.control.period_s,
        start=StartConfig(
            when=rig.start.when,
            rate_cm_s=rig.start.rate_cm_s,
            settle_s=rig.start.settle_s,
            tolerance_cm=rig.start.tolerance_cm,
            level_max_cm=rig.safety.level_max_cm,
            max_drives=path.max_drives,
            max_V=rig.pumps.range_V[1],
        ),
        pumps=path,
        sensors=rig.level_sensors,
    )
    return ControllerConfig(
        loop,
        safety_limits(rig),
        scenario.scenario.length_s if duration_s is None else duration_s,
        tuple((request.at_s, _request(request)) for request in scenario.request),
        _probe(scenario.diagnosis),
    )


def make_loop(
    bench: Bench,
    config: ControllerConfig,
    port: Port,
    recorder: Recorder,
    *,
    clear_trip: bool = False,
    true_level_cm: Callable[[], Quad] | None = None,
    on_tick: Watcher | None = None,
    clock_ns: Callable[[], int] | None = None,
    operator: OperatorChannel | None = None,
    sender: CommandSender | None = None,
    troubles: Callable[[], tuple[Event, ...]] = tuple,
) -> ControlLoop:
    """The control loop of a bench on an open port, for any clock. Keyword arguments: see `ControlLoop`."""
    return ControlLoop(
        config,
        bench.contract,
        bench.rig.sensors.range_V,
        port,
        recorder,
        arm_timeout_s=bench.rig.safety.arm_timeout_s,
        clear_trip=clear_trip,
        true_level_cm=true_level_cm,
        on_tick=on_tick,
        clock_ns=clock_ns,
        operator=operator,
        sender=sender,
        troubles=troubles,
    )


def _control_law(bench: Bench) -> ControlLaw:
    """The user's own, or the one that the scenario names. Raises SettingsError."""
    if bench.law is not None:
        return bench.law
    return make_law(LawSetup(bench.rig, bench.scenario, lambda: _gain_design(bench)), str(bench.scenario_path))


def _gain_design(bench: Bench) -> GainDesign:
    """The user's own, or the one that the scenario names. Raises SettingsError when this rig can't have it."""
    if bench.design is not None:
        return bench.design
    choice = DESIGNS.find(bench.scenario.control.design, str(bench.scenario_path))
    try:
        return choice.make(bench.rig)
    except DesignError as error:
        where = _where(bench)
        raise SettingsError(f"{where}: control: {error}; {stable_ones(bench.rig, where)}") from None


def _fault_detector(bench: Bench) -> FaultDetector:
    """The user's own, or the one that the scenario names. Raises SettingsError."""
    if bench.detector is not None:
        return bench.detector
    choice = DETECTORS.find(bench.scenario.diagnosis.method, str(bench.scenario_path))
    return choice.make(bench.rig, bench.scenario)


def run_plan(
    bench: Bench, *, is_live: bool, seed: int | None, config: ControllerConfig | None = None, clear_trip: bool = False
) -> RunPlan:
    """What the run folder keeps of the configuration. config, clear_trip : with them, a replay knows the options."""
    files = [bench.rig_path, bench.scenario_path, bench.dbc_path]
    if not is_live:
        files.append(bench.emulator_path)
    settings: dict[str, Any] = {
        "rig": bench.rig.model_dump(mode="json"),
        "rig_file": bench.rig_path.name,
        "scenario": bench.scenario.model_dump(mode="json"),
    }
    if config is not None:
        settings["options"] = {
            "duration_s": config.duration_s if isfinite(config.duration_s) else None,
            "clear_trip": clear_trip,
            "attended_s": config.limits.attended_s,
        }
    if is_live:  # in lockstep the same seed gives the same bytes
        written = datetime.fromtimestamp(bench.rig_path.stat().st_mtime, UTC)
        settings["rig_file_utc"] = written.isoformat(timespec="seconds")
    return RunPlan(
        scenario=bench.scenario.scenario.name,
        mode="live" if is_live else "lockstep",
        seed=seed,
        period_s=bench.rig.control.period_s,
        windows=tuple(Window(w.name, w.from_s, w.to_s) for w in bench.scenario.window),
        reconfigure=bench.scenario.control.reconfigure,
        settings=settings,
        copies={_copy_name(bench, file): read_text(file) for file in files} | _trajectories(bench),
        shown=bench.shown,
    )


def _copy_name(bench: Bench, file: Path) -> str:
    """File name of a copy. A scenario may have any name, even rig.toml, so it has a folder of its own."""
    if file == bench.scenario_path:
        return f"scenarios/{file.name}"
    return "rig.toml" if file == bench.rig_path else file.name


def _trajectories(bench: Bench) -> dict[str, str]:
    """Copies of the references' CSV files, by names relative to which the scenario's copy finds them."""
    named = [reference.file for reference in bench.scenario.reference if reference.file is not None]
    return {f"scenarios/{name}": read_text(bench.scenario_path.parent / name) for name in named}


def safety_limits(rig: Rig) -> Limits:
    """The supervisor's limits for a rig."""
    safety, path, model, (lag1, lag2) = rig.safety, rig.pump_path, rig.tank_model, rig.lags_s
    return Limits(
        range_V=rig.pumps.range_V,
        rate_V_s=rig.pumps.rate_V_s,
        stop_ramp_V_s=safety.stop_ramp_V_s,
        model=model,
        lag_s=(lag1 + path.delay_s[0], lag2 + path.delay_s[1]),
        level_gain_V_cm=model.level_gain_V_cm,
        level_max_cm=safety.level_max_cm,
        rim_margin_cm=safety.rim_margin_cm,
        levels_age_max_s=safety.levels_age_max_s,
        status_age_max_s=safety.status_age_max_s,
        heartbeat_age_max_s=safety.heartbeat_age_max_s,
        echo_age_max_s=safety.echo_age_max_s,
        echo_tolerance_V=safety.echo_tolerance_V,
        echo_mismatch_s=safety.echo_mismatch_s,
        invalid_run_max=safety.invalid_run_max,
        refused_run_max=safety.refused_run_max,
        errors_per_s_max=safety.errors_per_s_max,
        dead_below=safety.dead_below,
        dry_run_V=safety.dry_run_V,
        stops_on_dead_pump=safety.dead_pump == "stop",
        stops_on_lost_lower_level=safety.lost_lower_level == "stop",
        bypass_max_s=safety.bypass_max_s,
        pumps=path,
        unknown_fault_max_s=safety.unknown_fault_max_s,
        unattended_s=safety.unattended_s,
    )


def _probe(choice: DiagnosisChoice) -> ProbeConfig:
    return ProbeConfig(
        is_allowed=choice.probe,
        voltage_V=choice.probe_V,
        move_s=choice.probe_s,
        hold_s=choice.probe_hold_s,
        after_s=choice.probe_after_s,
        again_s=choice.probe_again_s,
    )


def _request(request: OperatorRequest) -> Request:
    interlock = None if request.interlock is None else TripCause(request.interlock)
    return Request(Action(request.action), request.voltage_V, interlock, request.for_s or 0.0)
