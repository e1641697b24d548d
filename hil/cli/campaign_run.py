"""One case of a campaign from its story to its row: what every worker does, whatever started it."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from functools import lru_cache
from math import ceil
from pathlib import Path

from firmware_sim import settings as emulator_settings
from firmware_sim.faults import Fault
from firmware_sim.ports import BusPort as EmulatorPort
from firmware_sim.rig import Rig as Emulator
from firmware_sim.settings import EmulatorSettings
from hil import lockstep
from hil.campaign import outcome
from hil.campaign.cases import Case
from hil.campaign.observer import Observer
from hil.campaign.outcome import Rest
from hil.campaign.row import Row, Took
from hil.campaign.toml_text import toml_text
from hil.cli.build import Bench, controller_config, load_contract, reference_schedule
from hil.core.tanks import holding_voltages
from hil.core.types import Pair
from hil.edge.bus import BusPort
from hil.edge.pair_bus import pair
from hil.edge.rig_file import Rig, load_rig
from hil.edge.run_folder import Window
from hil.edge.scenario_file import Scenario
from hil.edge.settings import SettingsError, validated
from hil.loop import ControlLoop
from hil.wire.contract import Contract

STEP_TOLERANCE = 1e-9
REST_NS = 500_000_000
"""How long the emulator goes on alone after a run, so that what it comes to rest at can be seen."""


def run_case(case: Case, config_dir: Path, bound_s: outcome.Bound | None = None) -> Row:
    """Run a case in lockstep, without a record. What a run raises becomes its row: the others go on."""
    started = Took.now()
    try:
        return _run(case, config_dir, bound_s, started)
    except Exception as error:  # noqa: BLE001 - a case must not take the campaign down; its row says that it crashed
        return outcome.crash(case, error, Took.since(started))


def check(case: Case, config_dir: Path, where: str) -> None:
    """Read and check all that the case would be built from; raises SettingsError (of either twin)."""
    controller_config(_bench(case, config_dir, where))
    _emulator_settings(case, config_dir, where)


def _run(case: Case, config_dir: Path, bound_s: outcome.Bound | None, started: Took) -> Row:
    bench = _bench(case, config_dir, case.key)
    config = controller_config(bench)
    truth, faults = _emulator_settings(case, config_dir, case.key)
    rig = bench.rig
    observer = Observer(rig.pumps.range_V)
    emulator = Emulator(truth, faults, case.seed, _fingerprint(config_dir), observer.on_change)
    observer.pump = emulator.pump
    with ExitStack() as stack:
        ours, theirs = (stack.enter_context(end) for end in pair())
        port = BusPort(ours)
        loop = ControlLoop(
            config,
            bench.contract,
            rig.sensors.range_V,
            port,
            observer,
            arm_timeout_s=rig.safety.arm_timeout_s,
            true_level_cm=lambda: emulator.levels_cm,
        )
        ending = lockstep.run(loop, port, EmulatorPort(emulator, theirs), config.loop.period_s)
    emulator.advance(emulator.now_ns + REST_NS)
    rest = Rest(emulator.truth().spilled_cm3, emulator.pump.applied_V)
    return outcome.evaluate(
        case,
        _figures(bench),
        observer.result(),
        ending,
        rest,
        took=Took.since(started),
        bound_s=bound_s or (lambda _: information_bound(bench, truth.nodes.levels_period_s)),
    )


def information_bound(bench: Bench, reading_s: float) -> float | None:
    """Seconds that any detector needs for the scenario's faults; None when they aren't one jump that begins at once.

    The pumps are taken to hold the reference that is in force when the fault begins. What is known between two control
    steps counts from the next one: no detector says anything before.
    """
    faults = bench.scenario.fault
    onsets = {fault.at_s for fault in faults}
    if bench.scenario.diagnosis.method != "glr" or len(onsets) != 1:
        return None
    from hil.core.glr.bound import jumps_of_fault

    model = bench.rig.tank_model
    jumps: dict[int, float] = {}
    for fault in faults:
        if not isinstance(fault.target, int):
            return None
        jumps |= jumps_of_fault(fault.kind, fault.target, fault.value, model)
    if len(jumps) != len(faults):
        return None
    onset_s = onsets.pop()
    levels_V = [at for at in reference_schedule(bench.scenario, bench.rig, "") if at[0] <= onset_s][-1][1]
    k = model.level_gain_V_cm
    holding_V = holding_voltages(model, (levels_V[0] / k, levels_V[1] / k))
    bound_s = _bound(bench.rig, reading_s, tuple(sorted(jumps.items())), holding_V)
    if bound_s is None:
        return None
    period_s = bench.rig.control.period_s
    return ceil((onset_s + bound_s) / period_s - STEP_TOLERANCE) * period_s - onset_s


@lru_cache(maxsize=256)
def _bound(rig: Rig, reading_s: float, jumps: tuple[tuple[int, float], ...], holding_V: Pair) -> float | None:
    from hil.core.glr.bound import detection_bound_s

    period_s, noise_V = rig.control.period_s, rig.sensors.noise_V
    return detection_bound_s(rig.tank_model, rig.pumps.lag_s, noise_V, dict(jumps), holding_V, period_s, reading_s)


def _figures(bench: Bench) -> outcome.Bench:
    rig = bench.rig
    return outcome.Bench(
        windows=tuple(Window(w.name, w.from_s, w.to_s) for w in bench.scenario.window),
        period_s=rig.control.period_s,
        rate_V_s=max(rig.pumps.rate_V_s, rig.safety.stop_ramp_V_s),
        height_cm=rig.tanks.height_cm,
        level_gain_V_cm=rig.sensors.gain_V_cm,
    )


def _bench(case: Case, config_dir: Path, where: str) -> Bench:
    """As `build.load`, from the case's story instead of a file."""
    scenario = validated(Scenario, case.story, where)
    rig = load_rig(config_dir / "rig.toml", scenario, Path(where))
    return Bench(scenario, rig, _contract(config_dir), Path(where), config_dir)


def _emulator_settings(case: Case, config_dir: Path, where: str) -> tuple[EmulatorSettings, tuple[Fault, ...]]:
    """The emulator reads files; it gets one."""
    file = _scratch() / "case.toml"
    file.write_text(toml_text(case.story), encoding="utf-8")
    try:
        return emulator_settings.load(config_dir / "emulator.toml", file)
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
