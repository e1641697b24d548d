"""Level filter: the tank model driven by the applied voltages, corrected by the readings.

State: four levels in cm and the two drives after the pump lag in V, see `hil.core.pumps`. Between readings eq. (1)
predicts; a reading moves each level by a fixed share of its innovation, given by a time constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, nan
from typing import NamedTuple

from hil.core.sensors import levels_shown
from hil.core.tanks import TankModel, level_rates
from hil.core.types import ALL_SENSORS, Measurement, Pair, Quad

NOTHING = (nan, nan, nan, nan)
"""Without a reading."""


@dataclass(frozen=True, slots=True)
class LevelFilter:
    """Configuration: the tank model, each pump's lag and the filter's time constant, s."""

    model: TankModel
    lag_s: Pair
    filter_s: float


class Estimate(NamedTuple):
    """Levels in cm and as level signals, V; drives after the lag, V; innovations, V, NaN without a reading."""

    level_cm: Quad
    level_V: Quad
    pump_V: Pair
    innovation_V: Quad


def start(filter_: LevelFilter, measurement: Measurement, applied_V: Pair) -> Estimate:
    """The first estimate: the readings. Every channel must be valid."""
    return Estimate(
        level_cm=levels_shown(measurement.level_V, filter_.model.level_gain_V_cm),
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

    applied_V : (2,) drives that arrived over that period. A channel that is not valid is only predicted.
    """
    predicted, pump_V = _predict(filter_, estimate, applied_V, effectiveness, period_s)
    k = filter_.model.level_gain_V_cm
    share = 1.0 - exp(-period_s / filter_.filter_s) if filter_.filter_s > 0.0 else 1.0
    y1, y2, y3, y4 = measurement.level_V if measurement.readings > 0 else NOTHING
    if measurement.valid != ALL_SENSORS:
        y1, y2, y3, y4 = (y if ok else nan for y, ok in zip((y1, y2, y3, y4), measurement.valid, strict=True))
    h1, h2, h3, h4 = predicted
    innovation_V = (y1 - k * h1, y2 - k * h2, y3 - k * h3, y4 - k * h4)
    n1, n2, n3, n4 = innovation_V
    if not isfinite(n1 + n2 + n3 + n4):
        n1, n2, n3, n4 = (n if isfinite(n) else 0.0 for n in innovation_V)
    gain = share / k
    h1, h2, h3, h4 = h1 + gain * n1, h2 + gain * n2, h3 + gain * n3, h4 + gain * n4
    h1, h2 = 0.0 if h1 < 0.0 else h1, 0.0 if h2 < 0.0 else h2
    h3, h4 = 0.0 if h3 < 0.0 else h3, 0.0 if h4 < 0.0 else h4
    level_V = (k * h1, k * h2, k * h3, k * h4)
    return Estimate(level_cm=(h1, h2, h3, h4), level_V=level_V, pump_V=pump_V, innovation_V=innovation_V)


def _predict(
    filter_: LevelFilter, estimate: Estimate, applied_V: Pair, effectiveness: Pair, period_s: float
) -> tuple[Quad, Pair]:
    """Heun's rule on eq. (1); the lag is exact over the period, its mean voltage drives the tanks."""
    (decay1, share1), (decay2, share2) = _lag(filter_.lag_s[0], period_s), _lag(filter_.lag_s[1], period_s)
    (p1, p2), (v1, v2), (t1, t2) = estimate.pump_V, applied_V, effectiveness
    drive = (t1 * (v1 + (p1 - v1) * share1), t2 * (v2 + (p2 - v2) * share2))
    h = estimate.level_cm
    first = level_rates(filter_.model, h, drive)
    second = level_rates(filter_.model, _moved(h, first, period_s, filter_.model.height_cm), drive)
    (a1, a2, a3, a4), (b1, b2, b3, b4) = first, second
    mean = ((a1 + b1) / 2.0, (a2 + b2) / 2.0, (a3 + b3) / 2.0, (a4 + b4) / 2.0)
    return _moved(h, mean, period_s, filter_.model.height_cm), (v1 + (p1 - v1) * decay1, v2 + (p2 - v2) * decay2)


def _lag(lag_s: float, period_s: float) -> Pair:
    """What is left of a gap after a period, and its mean over the period, as shares of the gap at its start."""
    decay = exp(-period_s / lag_s) if lag_s > 0.0 else 0.0
    return decay, (1.0 - decay) * lag_s / period_s if period_s > 0.0 else 0.0


def _moved(level_cm: Quad, rate_cm_s: Quad, dt: float, height_cm: Quad) -> Quad:
    (h1, h2, h3, h4), (r1, r2, r3, r4), (t1, t2, t3, t4) = level_cm, rate_cm_s, height_cm
    h1, h2, h3, h4 = h1 + dt * r1, h2 + dt * r2, h3 + dt * r3, h4 + dt * r4
    return (
        0.0 if h1 < 0.0 else t1 if h1 > t1 else h1,
        0.0 if h2 < 0.0 else t2 if h2 > t2 else h2,
        0.0 if h3 < 0.0 else t3 if h3 > t3 else h3,
        0.0 if h4 < 0.0 else t4 if h4 > t4 else h4,
    )
