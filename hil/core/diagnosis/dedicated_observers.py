"""Dedicated observers with fixed thresholds: one for each tank, fed by the readings of all.

Idea: R. N. Clark, Instrument fault detection, IEEE Trans. Aerospace and Electronic Systems 14(3), 1978, for sensors;
here the four observers are dedicated to the flows into the tanks:

    h_i' = eq. (1) with the readings of the other tanks + d_i + l1 (y_i - h_i),     d_i' = l2 (y_i - h_i)

Two equal poles at -1/observer_s. The gains of the pumps follow from the d_i (`missing_flow`), alarms from
`gain_alarms`.

What it can't do: a sensor that fails, a leak and a blocked outlet are missing flow as well, and are taken for a pump,
or for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

from hil.core.diagnosis.gain_alarms import HEALTHY_PUMPS, GainAlarms, judge
from hil.core.diagnosis.missing_flow import pump_gains
from hil.core.estimator import Estimate
from hil.core.tanks import TankModel, level_rates
from hil.core.types import Diagnosis, Measurement, Pair, Quad

MAX_PERIOD_S = 0.5
"""After a longer pause the observers begin again."""


UNKNOWN_STD = (float("nan"), float("nan"))


@dataclass(frozen=True, slots=True)
class ObserverMemory:
    """level_cm, inflow_cm_s : (4,) of the observers, after t_s. lagged_V : (2,) drives then."""

    t_s: float | None = None
    began_s: float = 0.0
    level_cm: Quad = (0.0, 0.0, 0.0, 0.0)
    inflow_cm_s: Quad = (0.0, 0.0, 0.0, 0.0)
    lagged_V: Pair = (0.0, 0.0)
    gain: Pair = (1.0, 1.0)
    alarms: GainAlarms = HEALTHY_PUMPS


@dataclass(frozen=True, slots=True)
class DedicatedObservers:
    """observer_s : time constant of the observers. settle_s : after a start nothing is judged for so long."""

    model: TankModel
    observer_s: float = 0.5
    settle_s: float = 5.0

    def start(self) -> ObserverMemory:
        """Nothing seen yet."""
        return ObserverMemory()

    def step(
        self, memory: ObserverMemory, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[ObserverMemory, Diagnosis]:
        """One step of the observers, and what their missing flows say."""
        readings = readings_cm(self.model, measurement)
        period_s = 0.0 if memory.t_s is None else t_s - memory.t_s
        if readings is None:
            return memory, Diagnosis(effectiveness=memory.alarms.told)
        if memory.t_s is None or period_s > MAX_PERIOD_S:
            fresh = ObserverMemory(
                t_s, t_s, readings, lagged_V=estimate.pump_V, gain=memory.alarms.told, alarms=memory.alarms
            )
            return fresh, Diagnosis(effectiveness=memory.alarms.told)
        mean_V = mean_of(memory.lagged_V, estimate.pump_V)
        rates = level_rates(self.model, readings, mean_V)
        left = exp(-period_s / self.observer_s) if period_s > 0.0 else 1.0
        share, learned = 1.0 - left**2, (1.0 - left) ** 2 / max(period_s, 1e-9)
        levels, inflows = [], []
        for h, d, rate, reading in zip(memory.level_cm, memory.inflow_cm_s, rates, readings, strict=True):
            predicted = h + period_s * (rate + d)
            levels.append(predicted + share * (reading - predicted))
            inflows.append(d + learned * (reading - predicted))
        gain = pump_gains(self.model, inflows, mean_V, memory.gain)
        judged = gain if t_s - memory.began_s >= self.settle_s else (1.0, 1.0)
        alarms, diagnosis = judge(memory.alarms, t_s, judged, UNKNOWN_STD)
        now = ObserverMemory(t_s, memory.began_s, as_quad(levels), as_quad(inflows), estimate.pump_V, gain, alarms)
        return now, diagnosis


def readings_cm(model: TankModel, measurement: Measurement) -> Quad | None:
    """(4,) the readings as levels; None if one of them is not valid."""
    if not all(measurement.valid) or measurement.readings <= 0:
        return None
    k = model.level_gain_V_cm
    h1, h2, h3, h4 = (max(y / k, 0.0) for y in measurement.level_V)
    return h1, h2, h3, h4


def mean_of(first: Pair, second: Pair) -> Pair:
    """(2,) the mean of two pairs of drives."""
    return (first[0] + second[0]) / 2.0, (first[1] + second[1]) / 2.0


def as_quad(values: list[float]) -> Quad:
    """Four values as a tuple."""
    a, b, c, d = values
    return a, b, c, d
