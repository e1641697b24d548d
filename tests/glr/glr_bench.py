"""A rig of its own for the diagnosis: eq. (1) by small Euler steps, noisy 12-bit sensors, the core's loop around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.core import closed_loop
from hil.core.closed_loop import LoopConfig, LoopState
from hil.core.diagnosis.detector import FaultDetector
from hil.core.diagnosis.glr.glr_detector import GlrDetector
from hil.core.estimator import LevelFilter
from hil.core.gain_design import choose_rig_design
from hil.core.laws.state_feedback_law import StateFeedbackLaw
from hil.core.reconfiguration import Reconfiguration
from hil.core.tanks import TankModel, equilibrium, linearise
from hil.core.types import Alarm, BusHealth, Inputs, Measurement, Mode, NodeHealth, NodeState, PumpFeedback
from tests.narrowing import pair, quad

MODEL = TankModel()
PERIOD_S, READINGS, SUBSTEPS = 0.1, 5, 2
STEP_V = 10.24 / 4096
NO_ESTIMATE: Any = None  # the detector does not look at it
ALL = (True, True, True, True)
DESIGN = choose_rig_design(linearise(MODEL, equilibrium(MODEL, (3.0, 3.0))), (-0.252, -0.184, -0.073, -0.06), 10.0)
DETECTOR = GlrDetector(MODEL, 0.2, 0.005)

Fault = tuple[float, Callable[["Plant"], None]]


class Plant:
    """Tanks, pumps and sensors; every parameter drawn within `spread` of the model's."""

    def __init__(self, seed: int, spread: float = 0.03, noise_V: float = 0.005, lag_s: float = 0.2) -> None:
        self.random = np.random.default_rng(seed)

        def drawn(values: tuple[float, ...]) -> npt.NDArray[np.float64]:
            return np.array(values) * (1.0 + spread * self.random.uniform(-1.0, 1.0, len(values)))

        self.outlet = drawn(MODEL.outlet_cm2)
        self.gain = drawn(MODEL.pump_gain_cm3_Vs)
        self.split = drawn(MODEL.valve_split)
        self.lag_s = np.full(2, lag_s)
        self.noise_V = np.full(4, noise_V)
        self.turbulence_cm3_sqrt_s = 0.0
        self.effectiveness, self.leak, self.block = np.ones(2), np.zeros(4), np.zeros(4)
        self.bias, self.drift = np.zeros(4), np.zeros(4)
        self.stuck_V: dict[int, float] = {}
        self.open: set[int] = set()
        self.frozen_V: dict[int, float] = {}
        flow = 3.0 * self.gain
        upper = ((1.0 - self.split) * flow)[::-1]
        through = np.concatenate([self.split * flow + upper, upper])
        self.level = (through / self.outlet) ** 2 / (2.0 * MODEL.gravity_cm_s2)
        self.flow_V = np.zeros(2)
        self.last, self.repeats, self.invalid_run = np.full(4, np.nan), np.zeros(4, int), np.zeros(4, int)

    def stick(self, sensor: int) -> None:
        self.stuck_V[sensor] = float(np.round(0.5 * self.level[sensor] / STEP_V) * STEP_V)

    def period(self, pump_V: tuple[float, float]) -> Measurement:
        """One control period with these voltages applied, and what the sensors say of it."""
        rows = []
        moves = []
        for _ in range(READINGS):
            for _ in range(SUBSTEPS):
                self._move(np.array(pump_V), PERIOD_S / READINGS / SUBSTEPS)
            self.bias += self.drift * PERIOD_S / READINGS
            reading = 0.5 * self.level + self.bias + self.noise_V * self.random.normal(size=4)
            reading = np.clip(np.round(reading / STEP_V) * STEP_V, 0.0, 10.24 - STEP_V)
            for sensor, value in self.stuck_V.items():
                reading[sensor] = value
            self.repeats = np.where(reading == self.last, self.repeats + 1, 0)
            self.invalid_run = np.array([self.invalid_run[i] + 1 if i in self.open else 0 for i in range(4)])
            moves.append((reading - self.last) ** 2)
            self.last = reading
            rows.append(reading)
        readings = np.array(rows)
        steps = np.nan_to_num(np.array(moves))
        jitter = (steps.sum(0) - steps.max(0)) / (2 * READINGS - 2)
        return Measurement(
            tuple(readings.mean(0).tolist()),
            quad(i not in self.open for i in range(4)),
            0.0,
            READINGS,
            tuple(readings.var(0, ddof=1).tolist()),
            tuple(jitter.tolist()),
            quad(int(n) for n in self.repeats),
            quad(int(n) for n in self.invalid_run),
        )

    def _move(self, pump_V: npt.NDArray[np.float64], dt: float) -> None:
        self.flow_V = pump_V + (self.flow_V - pump_V) * np.exp(-dt / self.lag_s)
        for pump, value in self.frozen_V.items():
            self.flow_V[pump] = value
        pumped = self.gain * self.effectiveness * self.flow_V
        out = self.outlet * (1.0 - self.block) * np.sqrt(2.0 * MODEL.gravity_cm_s2 * np.maximum(self.level, 0.0))
        inflow = np.concatenate([self.split * pumped + out[2:], ((1.0 - self.split) * pumped)[::-1]])
        rate = (inflow - out * (1.0 + self.leak)) / np.array(MODEL.area_cm2)
        self.level = self.level + dt * rate
        if self.turbulence_cm3_sqrt_s > 0.0:
            stirred_cm3 = self.turbulence_cm3_sqrt_s * np.sqrt(dt) * self.random.normal(size=4)
            self.level += stirred_cm3 / np.array(MODEL.area_cm2)
        self.level = np.clip(self.level, 0.0, MODEL.height_cm)


@dataclass
class RunLog:
    """The log of a run: alarms in order, and step by step time, verdict, law and true levels (V)."""

    alarms: list[Alarm] = field(default_factory=list)
    states: list[LoopState] = field(default_factory=list)
    true_V: list[npt.NDArray[np.float64]] = field(default_factory=list)
    commands_V: list[tuple[float, float]] = field(default_factory=list)

    @property
    def last(self) -> LoopState:
        return self.states[-1]

    def settled(self) -> list[Alarm]:
        """Verdicts only."""
        return [alarm for alarm in self.alarms if alarm.isolated_s is not None]

    def iae(self, from_s: float, to_s: float) -> npt.NDArray[np.float64]:
        """Integral of the true error of both outputs, V s."""
        chosen = range(round(from_s / PERIOD_S), round(to_s / PERIOD_S))
        errors = [np.abs(np.array(self.states[n].reference_V) - self.true_V[n][:2]) for n in chosen]
        total: npt.NDArray[np.float64] = PERIOD_S * np.sum(errors, axis=0)
        return total


def config(detector: FaultDetector, steps: tuple[tuple[float, float], ...]) -> LoopConfig:
    h1, h2, _, _ = equilibrium(MODEL, (3.0, 3.0))
    reference = (0.5 * h1, 0.5 * h2)
    schedule = [(0.0, reference)]
    for at_s, change_V in steps:
        reference = (reference[0] + change_V, reference[1] + change_V)
        schedule.append((at_s, reference))
    reconfiguration = Reconfiguration(MODEL, DESIGN, (10.0, 10.0), (3.0, 3.0))
    law = StateFeedbackLaw(reconfiguration, PERIOD_S, anti_windup_s=5.0)
    return LoopConfig(law, detector, LevelFilter(MODEL, (0.2, 0.2), 0.5), tuple(schedule), True, PERIOD_S)


def play(
    seed: int,
    duration_s: float,
    faults: tuple[Fault, ...] = (),
    steps: tuple[tuple[float, float], ...] = ((5.0, 0.3),),
    detector: FaultDetector = DETECTOR,
    plant: Plant | None = None,
) -> RunLog:
    """Close the loop on a plant for a while; every fault begins at the start of its control period."""
    plant = plant or Plant(seed)
    loop, log = config(detector, steps), RunLog()
    measurement = Measurement(tuple((0.5 * plant.level).tolist()), ALL, 0.0, READINGS)
    applied, state = (0.0, 0.0), None
    waiting = sorted(faults, key=lambda fault: fault[0])
    for number in range(round(duration_s / PERIOD_S) + 1):
        pumps = PumpFeedback(applied, (0.0, 0.0), NodeState.RUN, 0, 0.0, 0.0)
        inputs = Inputs(measurement, pumps, NodeHealth(0.0, False, True), BusHealth(0, 0, 0, 0, True))
        now_ns = round(number * PERIOD_S * 1e9)
        state = state or closed_loop.begin(loop, inputs, now_ns)
        state, _ = closed_loop.step(loop, state, inputs, now_ns)
        applied = pair(
            min(max(wanted, last - 2.0, 0.0), last + 2.0, 10.0)
            for wanted, last in zip(state.raw_V, applied, strict=True)
        )
        log.alarms += state.diagnosis.new_alarms
        log.states.append(state)
        log.true_V.append(0.5 * plant.level)
        log.commands_V.append(applied)
        state = closed_loop.conclude(loop, state, inputs, applied, Mode.RUNNING)
        while waiting and waiting[0][0] < (number + 1) * PERIOD_S - 1e-9:
            waiting.pop(0)[1](plant)
        measurement = plant.period(applied)
    return log


def put(name: str, index: int, value: float) -> Callable[[Plant], None]:
    """A fault that sets one element of one of the plant's arrays."""

    def begin(plant: Plant) -> None:
        getattr(plant, name)[index] = value

    return begin
