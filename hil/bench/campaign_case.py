"""One case of a campaign, from its scenario to its row: what every worker process does."""

from __future__ import annotations

import math
import tempfile
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path

from firmware_sim import settings as emulator_settings
from firmware_sim.faults import Fault
from firmware_sim.ports import BusPort as EmulatorPort
from firmware_sim.rig import Rig as Emulator
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings
from hil import lockstep
from hil.bench import assembly, scenario_bound
from hil.bench.assembly import Bench, controller_config, load_contract, make_loop
from hil.campaigns import outcome
from hil.campaigns.cases import Case
from hil.campaigns.observer import Observer
from hil.campaigns.outcome import Rest
from hil.campaigns.rig_draw import RigNumbers
from hil.campaigns.row import Elapsed, Row
from hil.campaigns.told import FlowShare
from hil.campaigns.toml_text import toml_text
from hil.core.fault_kinds import FaultKind
from hil.core.types import Pair, Quad
from hil.edge.can.bus import BusPort
from hil.edge.can.pair_bus import pair
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import SettingsError, validated
from hil.edge.record.file_writing import write_atomically
from hil.edge.record.manifest import Window
from hil.wire.contract import Contract

MAX_V = 10.0
REST_NS = 500_000_000
"""How long the emulator goes on alone after a run, to see at which voltages it comes to rest."""

DRAIN_NS = 60_000_000_000
"""How long it goes on after that: the upper tanks drain into the lower ones, which may still overflow."""

RUNS_ON = (FaultKind.PUMP_STUCK_ON, FaultKind.FOREIGN_COMMAND)
"""Faults with which a pump runs on without a controller, until its supply is cut: nothing is drained then."""


def run_case(case: Case, config_dir: Path, bound_s: outcome.Bound | None = None) -> Row:
    """Run a case in lockstep, without a record. A run that raises gives a row that says so; the other runs go on."""
    started = Elapsed.now()
    try:
        return _run(case, config_dir, bound_s, started)
    except Exception as error:  # noqa: BLE001 - a case must not take the campaign down; its row says that it crashed
        return outcome.crash(case, error, Elapsed.since(started))


def check(case: Case, config_dir: Path, where: str) -> None:
    """Read and check all settings of the case, and try them out. Raises SettingsError, also for the emulator's."""
    assembly.check(_bench(case, config_dir, where))
    _emulator_settings(case, config_dir, where)


def check_settings(case: Case, config_dir: Path, where: str) -> None:
    """Read and check the settings of the case without a trial. Raises SettingsError."""
    _bench(case, config_dir, where)
    _emulator_settings(case, config_dir, where)


def rig_numbers(case: Case, config_dir: Path, where: str) -> RigNumbers:
    """The emulated rig of a case, as the draws of a campaign start from it. Raises SettingsError."""
    truth, _ = _emulator_settings(case, config_dir, where)
    return _numbers(_bench(case, config_dir, where).rig, truth)


def _numbers(rig: Rig, truth: EmulatorSettings) -> RigNumbers:
    tanks, pumps = truth.tanks, truth.pumps
    return RigNumbers(
        gain_cm3_Vs=pumps.gain_cm3_Vs,
        dead_zone_V=_pair(pumps.dead_zone_V),
        curve_1_V=_pair(pumps.curve_1_V),
        lag_s=_pair(pumps.lag_s),
        valve_split=pumps.valve_split,
        outlet_cm2=tanks.outlet_cm2,
        datum_cm=_quad(tanks.datum_cm),
        height_cm=_quad(tanks.height_cm),
        gravity_cm_s2=tanks.gravity_cm_s2,
        level_gain_V_cm=_quad(truth.sensors.gain_V_cm),
        start_V=tanks.start_V,
        operating_point_V=rig.control.operating_point_V,
        range_V=rig.pumps.range_V,
    )


def _pair(value: float | tuple[float, ...]) -> Pair:
    first, second = parts(value, 2)
    return first, second


def _quad(value: float | tuple[float, ...]) -> Quad:
    h1, h2, h3, h4 = parts(value, 4)
    return h1, h2, h3, h4


def _may_overflow(truth: EmulatorSettings, level_cm: Quad) -> bool:
    """Whether a lower tank may be too full for the water that still comes: of the tank above, and of the pumps' lag."""
    tanks, pumps = truth.tanks, truth.pumps
    area_cm2, height_cm = tanks.area_cm2, parts(tanks.height_cm, 4)
    still_s = max(parts(pumps.lag_s, 2)) + max(parts(pumps.delay_s, 2))
    on_the_way_cm3 = MAX_V * max(pumps.gain_cm3_Vs) * still_s
    return any(
        area_cm2[lower] * level_cm[lower] + area_cm2[upper] * level_cm[upper] + on_the_way_cm3
        > area_cm2[lower] * height_cm[lower]
        for lower, upper in ((0, 2), (1, 3))
    )


def _run(case: Case, config_dir: Path, bound_s: outcome.Bound | None, started: Elapsed) -> Row:
    bench = _bench(case, config_dir, case.key)
    config = controller_config(bench)
    truth, faults = _emulator_settings(case, config_dir, case.key)
    rig = bench.rig
    observer = Observer(rig.pumps.range_V)
    emulator = Emulator(truth, faults, case.seed, _fingerprint(config_dir), observer.on_change)
    observer.pump, observer.effectiveness = emulator.pump, lambda: emulator.effectiveness
    with ExitStack() as stack:
        ours, theirs = (stack.enter_context(end) for end in pair())
        port = BusPort(ours)
        loop = make_loop(bench, config, port, observer, true_level_cm=lambda: emulator.levels_cm)
        ending = lockstep.run(loop, port, EmulatorPort(emulator, theirs), config.loop.period_s)
    emulator.advance(emulator.now_ns + REST_NS)
    applied_V = emulator.pump.applied_V
    kinds = {fault["kind"] for fault in case.faults}
    if kinds.isdisjoint(RUNS_ON) and (FaultKind.PUMP_LAG in kinds or _may_overflow(truth, emulator.levels_cm)):
        emulator.advance(emulator.now_ns + DRAIN_NS)
    rest = Rest(emulator.truth().spilled_cm3, applied_V)
    return outcome.evaluate(
        case,
        _figures(bench, truth),
        observer.result(),
        ending,
        rest,
        elapsed=Elapsed.since(started),
        bound_s=bound_s or (lambda _: scenario_bound.detection_bound(bench, truth.nodes.levels_period_s)),
    )


def flow_share(rig: Rig, emulated: RigNumbers) -> FlowShare:
    """What the emulator's healthy pumps (1, 2) give at a voltage, over what the rig file says."""
    gains, path = rig.pumps.gain_cm3_Vs, rig.pump_path

    def share(pump: int, voltage_V: float) -> float:
        by_file_cm3_s = gains[pump - 1] * path.drive((voltage_V, voltage_V))[pump - 1]
        return emulated.flow_cm3_s(pump - 1, voltage_V) / by_file_cm3_s if by_file_cm3_s > 0.0 else math.inf

    return share


def _figures(bench: Bench, truth: EmulatorSettings) -> outcome.RigFigures:
    rig = bench.rig
    return outcome.RigFigures(
        windows=tuple(Window(w.name, w.from_s, w.to_s) for w in bench.scenario.window),
        period_s=rig.control.period_s,
        rate_V_s=max(rig.pumps.rate_V_s, rig.safety.stop_ramp_V_s),
        height_cm=rig.tank_model.height_cm,
        level_gain_V_cm=rig.tank_model.level_gain_V_cm,
        valve_split=rig.pumps.valve_split,
        flow_share=flow_share(rig, _numbers(rig, truth)),
    )


def _bench(case: Case, config_dir: Path, where: str) -> Bench:
    """As `assembly.load`, from a dict instead of a file."""
    scenario = validated(Scenario, case.scenario_data, where)
    rig = load_rig(case.rig_file or config_dir / "rig.toml", scenario, Path(where))
    return Bench(scenario, rig, _contract(config_dir), Path(where), config_dir, case.rig_file)


def _emulator_settings(case: Case, config_dir: Path, where: str) -> tuple[EmulatorSettings, tuple[Fault, ...]]:
    """The emulator's settings. It reads files, so the scenario is written into a temporary one."""
    file = _scratch() / "case.toml"
    write_atomically(file, toml_text(case.scenario_data))
    try:
        return emulator_settings.load(config_dir / "emulator.toml", file, case.rig_file)
    except emulator_settings.SettingsError as error:
        raise SettingsError(str(error).replace(str(file), where)) from None


@lru_cache(maxsize=1)
def _scratch_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="hil-campaign-")


def _scratch() -> Path:
    return Path(_scratch_folder().name)


@lru_cache(maxsize=4)
def _contract(config_dir: Path) -> Contract:
    return load_contract(config_dir / "bench.dbc")


@lru_cache(maxsize=4)
def _fingerprint(config_dir: Path) -> int:
    return emulator_settings.load_fingerprint(config_dir / "bench.dbc")
