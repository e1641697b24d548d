"""Build the objects of a run, live or in lockstep, from configuration files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.core_settings import operator_request, probe_config, safety_limits, start_config
from hil.bench.design_figures import stable_ones
from hil.bench.designs import DESIGNS
from hil.bench.detectors import DETECTORS
from hil.bench.dry_step import FAILURES, DryStepError, try_out
from hil.bench.law_choices import STATE_FEEDBACK, make_law
from hil.bench.law_setup import LawSetup
from hil.bench.reference_plan import reference_plan
from hil.core.control_law import ControlLaw
from hil.core.controller import ControllerConfig, Output
from hil.core.diagnosis.detector import FaultDetector
from hil.core.eigenstructure import DesignError
from hil.core.estimator import LevelFilter
from hil.core.gain_design import GainDesign
from hil.core.loop_state import LoopConfig
from hil.core.types import Event, Inputs, Mode, Quad
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.scenario_file import Scenario, load_scenario
from hil.edge.config.settings_file import SettingsError, default_config_dir, read_text
from hil.edge.config.shipped import find_rig, find_scenario
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
    references, moves = reference_plan(scenario, rig, str(bench.scenario_path))
    loop = LoopConfig(
        law=_control_law(bench),
        detector=_fault_detector(bench),
        level_filter=LevelFilter(rig.tank_model, rig.lags_s, rig.control.level_filter_s),
        references=references,
        moves=moves,
        reconfigure=scenario.control.reconfigure,
        period_s=rig.control.period_s,
        start=start_config(rig),
        pumps=rig.pump_path,
        sensors=rig.level_sensors,
    )
    return ControllerConfig(
        loop,
        safety_limits(rig),
        scenario.scenario.length_s if duration_s is None else duration_s,
        tuple((request.at_s, operator_request(request)) for request in scenario.request),
        probe_config(scenario.diagnosis),
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
