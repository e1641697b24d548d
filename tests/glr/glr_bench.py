"""A rig of its own for the diagnosis: eq. (1) by small Euler steps, noisy 12-bit sensors, the core's loop around it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import dataclass, field
from functools import lru_cache
from math import isnan, nan, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.core import closed_loop
from hil.core.diagnosis.detector import FaultDetector
from hil.core.diagnosis.glr.glr_detector import GlrDetector
from hil.core.estimator import LevelFilter
from hil.core.gain_design import choose_rig_design
from hil.core.laws.state_feedback_law import StateFeedbackLaw
from hil.core.loop_state import LoopConfig, LoopState
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
        self.last, self.repeats, self.invalid_run = [nan] * 4, [0] * 4, [0] * 4

    def stick(self, sensor: int) -> None:
        self.stuck_V[sensor] = float(np.round(0.5 * self.level[sensor] / STEP_V) * STEP_V)

    def period(self, pump_V: tuple[float, float]) -> Measurement:
        """One control period with these voltages applied, and what the sensors say of it.

        In plain numbers: arrays of four elements take five times as long.
        """
        rows: list[list[float]] = []
        moves: list[list[float]] = []
        for _ in range(READINGS):
            self._move(pump_V, PERIOD_S / READINGS)
            self.bias += self.drift * PERIOD_S / READINGS
            reading = self._reading()
            self.repeats = [
                n + 1 if now == old else 0 for n, now, old in zip(self.repeats, reading, self.last, strict=True)
            ]
            self.invalid_run = [n + 1 if i in self.open else 0 for i, n in enumerate(self.invalid_run)]
            moves.append([(now - old) ** 2 for now, old in zip(reading, self.last, strict=True)])
            self.last = reading
            rows.append(reading)
        steps = [[0.0 if isnan(step) else step for step in row] for row in zip(*moves, strict=True)]
        means = [sum(row) / READINGS for row in zip(*rows, strict=True)]
        spreads = [
            sum((value - mean) * (value - mean) for value in row)
            for row, mean in zip(zip(*rows, strict=True), means, strict=True)
        ]
        return Measurement(
            quad(means),
            quad(i not in self.open for i in range(4)),
            0.0,
            READINGS,
            quad(spread / (READINGS - 1) for spread in spreads),
            quad((sum(row) - max(row)) / (2 * READINGS - 2) for row in steps),
            quad(self.repeats),
            quad(self.invalid_run),
        )

    def _reading(self) -> list[float]:
        """The next reading of each sensor, V."""
        noise = (self.noise_V * self.random.normal(size=4)).tolist()
        exact = (0.5 * self.level + self.bias).tolist()
        codes = (round((volts + shake) / STEP_V) * STEP_V for volts, shake in zip(exact, noise, strict=True))
        reading = [min(max(volts, 0.0), 10.24 - STEP_V) for volts in codes]
        for sensor, value in self.stuck_V.items():
            reading[sensor] = value
        return reading

    def _move(self, pump_V: tuple[float, float], duration_s: float) -> None:
        """Some steps of Euler's method."""
        dt = duration_s / SUBSTEPS
        (decay1, decay2), (u1, u2) = np.exp(-dt / self.lag_s).tolist(), pump_V
        (f1, f2), (k1, k2), (s1, s2) = (x.tolist() for x in (self.flow_V, self.gain * self.effectiveness, self.split))
        level, leak = self.level.tolist(), (1.0 + self.leak).tolist()
        open_cm2 = (self.outlet * (1.0 - self.block)).tolist()
        for _ in range(SUBSTEPS):
            f1 = self.frozen_V.get(0, u1 + (f1 - u1) * decay1)
            f2 = self.frozen_V.get(1, u2 + (f2 - u2) * decay2)
            p1, p2 = k1 * f1, k2 * f2
            out = [a * sqrt(2.0 * MODEL.gravity_cm_s2 * max(h, 0.0)) for a, h in zip(open_cm2, level, strict=True)]
            inflow = (s1 * p1 + out[2], s2 * p2 + out[3], (1.0 - s2) * p2, (1.0 - s1) * p1)
            level = [
                h + dt * ((q - o * lost) / area)
                for h, q, o, lost, area in zip(level, inflow, out, leak, MODEL.area_cm2, strict=True)
            ]
            if self.turbulence_cm3_sqrt_s > 0.0:
                stirred_cm3 = self.turbulence_cm3_sqrt_s * np.sqrt(dt) * self.random.normal(size=4)
                level = (np.array(level) + stirred_cm3 / np.array(MODEL.area_cm2)).tolist()
            level = [min(max(h, 0.0), top) for h, top in zip(level, MODEL.height_cm, strict=True)]
        self.flow_V, self.level = np.array((f1, f2)), np.array(level)


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


@dataclass
class _Progress:
    """A run as far as it has come. number : control steps made."""

    plant: Plant
    measurement: Measurement
    applied: tuple[float, float] = (0.0, 0.0)
    state: LoopState | None = None
    number: int = 0
    log: RunLog = field(default_factory=RunLog)

    @classmethod
    def of(cls, plant: Plant) -> _Progress:
        return cls(plant, Measurement(quad((0.5 * plant.level).tolist()), ALL, 0.0, READINGS))

    def step(self, loop: LoopConfig, begin: Iterable[Callable[[Plant], None]]) -> None:
        """One control period, at whose start these faults begin."""
        pumps = PumpFeedback(self.applied, (0.0, 0.0), NodeState.RUN, 0, 0.0, 0.0)
        inputs = Inputs(self.measurement, pumps, NodeHealth(0.0, False, True), BusHealth(0, 0, 0, 0, True))
        now_ns = round(self.number * PERIOD_S * 1e9)
        state = self.state or closed_loop.begin(loop, inputs, now_ns)
        state, _ = closed_loop.step(loop, state, inputs, now_ns)
        self.applied = pair(
            min(max(wanted, last - 2.0, 0.0), last + 2.0, 10.0)
            for wanted, last in zip(state.raw_V, self.applied, strict=True)
        )
        self.log.alarms += state.diagnosis.new_alarms
        self.log.states.append(state)
        self.log.true_V.append(0.5 * self.plant.level)
        self.log.commands_V.append(self.applied)
        self.state = closed_loop.conclude(loop, state, inputs, self.applied, Mode.RUNNING)
        for fault in begin:
            fault(self.plant)
        self.measurement = self.plant.period(self.applied)
        self.number += 1

    def copy(self) -> _Progress:
        """Another run from here on."""
        plant, state = deepcopy((self.plant, self.state))
        log = RunLog(*(list(part) for part in vars(self.log).values()))
        return _Progress(plant, self.measurement, self.applied, state, self.number, log)


@lru_cache(maxsize=8)
def _healthy(seed: int, steps: tuple[tuple[float, float], ...], detector: FaultDetector, number: int) -> _Progress:
    """A run without faults, so many control steps from its start: the same for all tests whose fault comes then."""
    progress, loop = _Progress.of(Plant(seed)), config(detector, steps)
    while progress.number < number:
        progress.step(loop, ())
    return progress


def play(
    seed: int,
    duration_s: float,
    faults: tuple[Fault, ...] = (),
    steps: tuple[tuple[float, float], ...] = ((5.0, 0.3),),
    detector: FaultDetector = DETECTOR,
    plant: Plant | None = None,
) -> RunLog:
    """Close the loop on a plant for a while; every fault begins at the start of its control period."""
    loop, total = config(detector, steps), round(duration_s / PERIOD_S) + 1
    waiting = [(begin_at(at_s), fault) for at_s, fault in sorted(faults, key=lambda fault: fault[0])]
    if plant is not None or not waiting:
        progress = _Progress.of(plant or Plant(seed))
    else:
        shared: Any = detector  # a protocol does not say that it can be hashed
        progress = _healthy(seed, steps, shared, min(waiting[0][0], total)).copy()
    while progress.number < total:
        now = [fault for number, fault in waiting if number == progress.number]
        progress.step(loop, now)
    return progress.log


def begin_at(at_s: float) -> int:
    """The control step after which a fault at this time begins."""
    number = max(round(at_s / PERIOD_S) - 2, 0)
    while at_s >= (number + 1) * PERIOD_S - 1e-9:
        number += 1
    return number


def put(name: str, index: int, value: float) -> Callable[[Plant], None]:
    """A fault that sets one element of one of the plant's arrays."""

    def begin(plant: Plant) -> None:
        getattr(plant, name)[index] = value

    return begin
