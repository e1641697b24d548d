"""Helpers of the core's tests: the bench's models, made-up inputs, tanks to close a loop around."""

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.core import controller
from hil.core.controller import ControllerConfig, ControllerState
from hil.core.diagnosis.ideal import NoDetector
from hil.core.estimator import LevelFilter
from hil.core.gain_design import CalibratedDesign, RigDesign, choose_rig_design
from hil.core.interlocks import Limits
from hil.core.laws.state_feedback_law import FeedbackMemory, StateFeedbackLaw
from hil.core.loop_state import LoopConfig, LoopState
from hil.core.reconfiguration import Reconfiguration
from hil.core.tanks import LinearModel, TankModel, equilibrium, level_rates, linearise
from hil.core.types import (
    BusHealth,
    Inputs,
    Measurement,
    NodeHealth,
    NodeState,
    Pair,
    PumpFeedback,
    Quad,
    TickRecord,
)
from tests.narrowing import pair, quad

RIG = tomllib.loads((Path(__file__).resolve().parents[2] / "config/rig.toml").read_text())
OUTPUT_POLES = tuple(RIG["control"]["output_poles"])
NOISE_GAIN_MAX = RIG["control"]["noise_gain_max"]
BENCH = TankModel()
PERIOD_S = 0.1
SECOND = 1_000_000_000
NO_MEASUREMENT: Any = None
NO_ESTIMATE: Any = None
"""For detectors that look at neither."""
OUTFLOW = math.sqrt(2.0 * 981.0)


def at(voltage_V: Pair = (3.0, 3.0), model: TankModel = BENCH) -> LinearModel:
    """Linear model at the equilibrium of these voltages."""
    return linearise(model, equilibrium(model, voltage_V))


def rig_design() -> RigDesign:
    return choose_rig_design(at(), OUTPUT_POLES, NOISE_GAIN_MAX)


def reconfiguration(design: CalibratedDesign | None = None, limit_V: float = 10.0) -> Reconfiguration:
    return Reconfiguration(BENCH, design or rig_design(), (limit_V, limit_V), (3.0, 3.0))


CALIBRATED = CalibratedDesign()
LIMITS = Limits(
    range_V=(0.0, 10.0),
    rate_V_s=20.0,
    stop_ramp_V_s=20.0,
    model=BENCH,
    lag_s=(0.2, 0.2),
    level_gain_V_cm=0.5,
    level_max_cm=19.0,
    rim_margin_cm=0.5,
    levels_age_max_s=0.3,
    status_age_max_s=0.3,
    heartbeat_age_max_s=0.25,
    echo_age_max_s=0.5,
    echo_tolerance_V=0.05,
    echo_mismatch_s=0.2,
    invalid_run_max=3,
    refused_run_max=5,
    errors_per_s_max=20,
    dead_below=0.1,
    dry_run_V=0.5,
    stops_on_dead_pump=False,
    stops_on_lost_lower_level=False,
    bypass_max_s=600.0,
)


def measurement(
    level_V: Sequence[float],
    *,
    valid: tuple[bool, bool, bool, bool] = (True, True, True, True),
    age_s: float = 0.01,
    readings: int = 5,
) -> Measurement:
    return Measurement(quad(level_V), valid, age_s, readings)


def inputs(
    level_V: Sequence[float],
    applied_V: Pair = (0.0, 0.0),
    state: NodeState = NodeState.RUN,
    shortfall_V: Pair = (0.0, 0.0),
    **changes: Any,
) -> Inputs:
    """What a healthy bench would say."""
    healthy = Inputs(
        measurement(level_V),
        PumpFeedback(applied_V, shortfall_V, state, 0, 0.02, 0.0),
        NodeHealth(0.05, rebooted=False, contract_matches=True),
        BusHealth(10, 0, 0, 0, is_up=True),
    )
    return replace(healthy, **changes)


def volts(level_cm: Sequence[float]) -> Quad:
    return quad(0.5 * h for h in level_cm)


def feedback_law(rule: Reconfiguration | None = None, anti_windup_s: float = 5.0) -> StateFeedbackLaw:
    return StateFeedbackLaw(rule or reconfiguration(), PERIOD_S, anti_windup_s)


def memory_of(state: LoopState | None) -> FeedbackMemory:
    """What the state feedback remembers of the last step."""
    assert state is not None
    memory = state.law_memory
    assert isinstance(memory, FeedbackMemory)
    return memory


def integrals_after(state: LoopState | None) -> Pair:
    """The integrals with which the state feedback will begin its next step."""
    assert state is not None
    last = state.last
    told = replace(state.inputs, given_V=last.given_V, excess_V=last.excess_V, authority=last.authority)
    return feedback_law().advanced(memory_of(state), told)


def bench_loop(
    design: CalibratedDesign | None = None,
    references: tuple[tuple[float, Pair], ...] | None = None,
    rule: Reconfiguration | None = None,
    **changes: Any,
) -> LoopConfig:
    h1, h2, _, _ = equilibrium(BENCH, (3.0, 3.0))
    loop = LoopConfig(
        law=feedback_law(rule or reconfiguration(design)),
        detector=NoDetector(),
        level_filter=LevelFilter(BENCH, lag_s=(0.0, 0.0), filter_s=0.5),
        references=references or ((0.0, (0.5 * h1, 0.5 * h2)),),
        reconfigure=True,
        period_s=PERIOD_S,
    )
    return replace(loop, **changes)


class Plant:
    """Eq. (1) by the classical Runge-Kutta rule; the applied voltages follow the commands at once."""

    def __init__(self, model: TankModel = BENCH, start_V: Pair = (3.0, 3.0)) -> None:
        self.model = model
        self.level_cm = equilibrium(model, start_V)
        self.effectiveness = (1.0, 1.0)

    def advance(self, applied_V: Pair, dt_s: float) -> None:
        drive = pair(e * v for e, v in zip(self.effectiveness, applied_V, strict=True))

        def rates(h: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
            return np.array(level_rates(self.model, quad(np.maximum(h, 0.0)), drive))

        h = np.array(self.level_cm)
        k1 = rates(h)
        k2 = rates(h + dt_s / 2.0 * k1)
        k3 = rates(h + dt_s / 2.0 * k2)
        k4 = rates(h + dt_s * k3)
        self.level_cm = tuple(np.maximum(h + dt_s / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4), 0.0).tolist())


def run(
    config: ControllerConfig,
    plant: Plant,
    steps: int,
    faults: dict[int, Pair] | None = None,
    on_step: Callable[[int, Inputs], Inputs] | None = None,
    late_ns: dict[int, int] | None = None,
) -> tuple[controller.ControllerState, list[TickRecord]]:
    """Close the loop in process: the records of all steps in control.

    faults : step number -> effectiveness. late_ns : step number -> lateness of that step.
    """
    state, applied, records = ControllerState(), (0.0, 0.0), []
    node = NodeState.READY
    for number in range(steps):
        if faults and number in faults:
            plant.effectiveness = faults[number]
        now_ns = round(number * config.loop.period_s * SECOND) + (late_ns or {}).get(number, 0)
        seen = inputs(volts(plant.level_cm), applied, node)
        if on_step is not None:
            seen = on_step(number, seen)
        state, output = controller.step(config, state, seen, now_ns)
        if output.record is not None:
            records.append(output.record)
        applied = output.command.voltage_V if output.command.enable else (0.0, 0.0)
        node = NodeState.RUN if output.command.enable else NodeState.READY
        if state.loop is not None:
            plant.advance(applied, config.loop.period_s)
    return state, records


def controller_config(
    loop: LoopConfig | None = None, duration_s: float = math.inf, limits: Limits = LIMITS
) -> ControllerConfig:
    return ControllerConfig(loop or bench_loop(), limits, duration_s)
