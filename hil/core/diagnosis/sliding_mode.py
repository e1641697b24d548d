"""A bank of high-order sliding-mode observers: one for each tank, exact in finite time without noise.

A. Levant, Higher-order sliding modes, differentiation and output-feedback control, International Journal of Control
76(9-10), 2003: with e = h_i - y_i,

    h_i' = eq. (1) with the readings + d_i - 2.0 L^(1/3) |e|^(2/3) sign e
    d_i' = c_i - 2.12 L^(2/3) |e|^(1/3) sign e,        c_i' = -1.1 L sign e

d_i is the unknown inflow. L bounds its second derivative: the larger, the quicker, and the noisier. The gains of the
pumps follow from the d_i (`missing_flow`), smoothed; alarms from `gain_alarms`. Ours: everything after the d_i.

What it can't do: as `dedicated_observers`, and the noise of the readings comes through more strongly.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, exp

from hil.core.diagnosis.dedicated_observers import MAX_PERIOD_S, UNKNOWN_STD, as_quad, mean_of, readings_cm
from hil.core.diagnosis.gain_alarms import HEALTHY_PUMPS, GainAlarms, judge
from hil.core.diagnosis.missing_flow import pump_gains
from hil.core.estimator import Estimate
from hil.core.tanks import TankModel, level_rates
from hil.core.types import Diagnosis, Measurement, Pair, Quad

SUBSTEPS = 10
"""Steps of Euler's rule in a control period."""


@dataclass(frozen=True, slots=True)
class SlidingMemory:
    """error_cm, inflow_cm_s, change_cm_s2 : (4,) e, d and c, after t_s. gain : (2,) smoothed."""

    t_s: float | None = None
    began_s: float = 0.0
    level_cm: Quad = (0.0, 0.0, 0.0, 0.0)
    inflow_cm_s: Quad = (0.0, 0.0, 0.0, 0.0)
    change_cm_s2: Quad = (0.0, 0.0, 0.0, 0.0)
    lagged_V: Pair = (0.0, 0.0)
    gain: Pair = (1.0, 1.0)
    alarms: GainAlarms = HEALTHY_PUMPS


@dataclass(frozen=True, slots=True)
class SlidingModeBank:
    """bound_cm_s3 : L. smoothing_s : of the gains. settle_s : after a start nothing is judged for so long."""

    model: TankModel
    bound_cm_s3: float = 0.03
    smoothing_s: float = 1.0
    settle_s: float = 10.0

    def start(self) -> SlidingMemory:
        """Nothing seen yet."""
        return SlidingMemory()

    def step(
        self, memory: SlidingMemory, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[SlidingMemory, Diagnosis]:
        """One step of the observers, and what their missing flows say."""
        readings = readings_cm(self.model, measurement)
        if readings is None:
            return memory, Diagnosis(effectiveness=memory.alarms.told)
        if memory.t_s is None or t_s - memory.t_s > MAX_PERIOD_S:
            fresh = SlidingMemory(
                t_s, t_s, readings, lagged_V=estimate.pump_V, gain=memory.alarms.told, alarms=memory.alarms
            )
            return fresh, Diagnosis(effectiveness=memory.alarms.told)
        period_s, mean_V = t_s - memory.t_s, mean_of(memory.lagged_V, estimate.pump_V)
        rates = level_rates(self.model, readings, mean_V)
        moved = [
            self._slid(h, d, c, rate, reading, period_s)
            for h, d, c, rate, reading in zip(
                memory.level_cm, memory.inflow_cm_s, memory.change_cm_s2, rates, readings, strict=True
            )
        ]
        inflows = [d for _, d, _ in moved]
        now = pump_gains(self.model, inflows, mean_V, memory.gain)
        share = 1.0 - exp(-period_s / self.smoothing_s)
        gain = (
            memory.gain[0] + share * (now[0] - memory.gain[0]),
            memory.gain[1] + share * (now[1] - memory.gain[1]),
        )
        judged = gain if t_s - memory.began_s >= self.settle_s else (1.0, 1.0)
        alarms, diagnosis = judge(memory.alarms, t_s, judged, UNKNOWN_STD)
        levels, changes = as_quad([h for h, _, _ in moved]), as_quad([c for _, _, c in moved])
        new = SlidingMemory(t_s, memory.began_s, levels, as_quad(inflows), changes, estimate.pump_V, gain, alarms)
        return new, diagnosis

    def _slid(
        self, h: float, d: float, c: float, rate: float, reading: float, period_s: float
    ) -> tuple[float, float, float]:
        """Level, inflow and its change after a period."""
        L, dt = self.bound_cm_s3, period_s / SUBSTEPS
        for _ in range(SUBSTEPS):
            e = h - reading
            size, sign = abs(e), copysign(1.0, e) if e else 0.0
            h += dt * (rate + d - 2.0 * L ** (1.0 / 3.0) * size ** (2.0 / 3.0) * sign)
            d += dt * (c - 2.12 * L ** (2.0 / 3.0) * size ** (1.0 / 3.0) * sign)
            c -= dt * 1.1 * L * sign
        return h, d, c
