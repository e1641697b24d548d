"""Level filter: the tank model driven by the applied voltages, corrected by the readings.

State: four levels in cm and the two voltages after the pump lag in V. Between readings eq. (1) predicts; a reading
moves each level by a fixed share of its innovation, given by a time constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, nan

from hil.core.tanks import TankModel, level_rates
from hil.core.types import Measurement, Pair, Quad


@dataclass(frozen=True, slots=True)
class LevelFilter:
    """Configuration: the tank model, the pump lag and the filter's time constant, s."""

    model: TankModel
    lag_s: float
    filter_s: float


@dataclass(frozen=True, slots=True)
class Estimate:
    """Levels in cm and as sensor voltages, V; pump voltages after the lag, V; innovations, V, NaN without a reading."""

    level_cm: Quad
    level_V: Quad
    pump_V: Pair
    innovation_V: Quad


def start(filter_: LevelFilter, measurement: Measurement, applied_V: Pair) -> Estimate:
    """The first estimate: the readings. Every channel must be valid."""
    k = filter_.model.level_gain_V_cm
    y1, y2, y3, y4 = measurement.level_V
    return Estimate(
        level_cm=(y1 / k, y2 / k, y3 / k, y4 / k),
        level_V=measurement.level_V,
        pump_V=applied_V,
        innovation_V=(0.0, 0.0, 0.0, 0.0),
    )


def step(
    filter_: LevelFilter,
    estimate: Estimate,
    applied_V: Pair,
    effectiveness: Pair,
    measurement: Measurement,
    period_s: float,
) -> Estimate:
    """Predict over the last period, then correct with the readings.

    applied_V : (2,) pump voltages over that period. A channel that is not valid is only predicted.
    """
    predicted, pump_V = _predict(filter_, estimate, applied_V, effectiveness, period_s)
    k = filter_.model.level_gain_V_cm
    share = 1.0 - exp(-period_s / filter_.filter_s) if filter_.filter_s > 0.0 else 1.0
    if measurement.readings > 0:
        y1, y2, y3, y4 = (y if ok else nan for y, ok in zip(measurement.level_V, measurement.valid, strict=True))
    else:
        y1 = y2 = y3 = y4 = nan
    h1, h2, h3, h4 = predicted
    innovation_V = (y1 - k * h1, y2 - k * h2, y3 - k * h3, y4 - k * h4)
    n1, n2, n3, n4 = (n if isfinite(n) else 0.0 for n in innovation_V)
    gain = share / k
    h1, h2, h3, h4 = h1 + gain * n1, h2 + gain * n2, h3 + gain * n3, h4 + gain * n4
    level_cm = (max(h1, 0.0), max(h2, 0.0), max(h3, 0.0), max(h4, 0.0))
    h1, h2, h3, h4 = level_cm
    level_V = (k * h1, k * h2, k * h3, k * h4)
    return Estimate(level_cm=level_cm, level_V=level_V, pump_V=pump_V, innovation_V=innovation_V)


def _predict(
    filter_: LevelFilter, estimate: Estimate, applied_V: Pair, effectiveness: Pair, period_s: float
) -> tuple[Quad, Pair]:
    """Heun's rule on eq. (1); the lag is exact over the period, its mean voltage drives the tanks."""
    decay = exp(-period_s / filter_.lag_s) if filter_.lag_s > 0.0 else 0.0
    mean_share = (1.0 - decay) * filter_.lag_s / period_s if period_s > 0.0 else 0.0
    (p1, p2), (v1, v2), (t1, t2) = estimate.pump_V, applied_V, effectiveness
    drive = (t1 * (v1 + (p1 - v1) * mean_share), t2 * (v2 + (p2 - v2) * mean_share))
    h = estimate.level_cm
    first = level_rates(filter_.model, h, drive)
    second = level_rates(filter_.model, _moved(h, first, period_s, filter_.model.height_cm), drive)
    (a1, a2, a3, a4), (b1, b2, b3, b4) = first, second
    mean = ((a1 + b1) / 2.0, (a2 + b2) / 2.0, (a3 + b3) / 2.0, (a4 + b4) / 2.0)
    return _moved(h, mean, period_s, filter_.model.height_cm), (v1 + (p1 - v1) * decay, v2 + (p2 - v2) * decay)


def _moved(level_cm: Quad, rate_cm_s: Quad, dt: float, height_cm: float) -> Quad:
    (h1, h2, h3, h4), (r1, r2, r3, r4) = level_cm, rate_cm_s
    h1, h2, h3, h4 = h1 + dt * r1, h2 + dt * r2, h3 + dt * r3, h4 + dt * r4
    return (
        min(max(h1, 0.0), height_cm),
        min(max(h2, 0.0), height_cm),
        min(max(h3, 0.0), height_cm),
        min(max(h4, 0.0), height_cm),
    )
