"""Live levels: the level that a sensor may still show although the diagnosis does not trust it.

A slow blockage of a tank's outlet and a slow drift of its sensor give the same readings. If the diagnosis names the
drift and is wrong, the sensor shows how the tank fills, and the model does not. So the reading keeps its veto on high
levels, as far as it can be the level: water rises no faster than a pump at its largest voltage and a full tank above
can fill a tank whose outlet is shut. A faster rise is the sensor's and is subtracted; an equally sudden fall gives it
back. A sensor whose readings are not valid, or are refuted by the diagnosis, has no veto. What a movement of the pumps
has proven to be the sensor's own is subtracted, too; what it reads more from then on counts again.
Why, and what it costs: docs/decisions/0022-veto-of-a-live-sensor.md.
"""

from __future__ import annotations

from math import exp, inf, isfinite, nan, sqrt
from typing import NamedTuple

from hil.core.tanks import TankModel
from hil.core.types import ALL_SENSORS, Diagnosis, Measurement, Pair, Quad

RATE_MARGIN = 1.5
"""Pumps and outlets may give this many times what the rig file says."""

NOISE_STDS = 6.0
"""A change between two means of readings is noise up to this many of its standard deviations."""

FORGET_S = 60.0
"""Time constant with which a sudden rise is forgotten while the sensor is trusted: it was no fault."""

NONE = (-inf, -inf, -inf, -inf)
"""No sensor that is not trusted shows a level."""


class LiveLevels(NamedTuple):
    """State of the monitor.

    reading_cm : (4,) newest valid readings, NaN before the first. sudden_cm : (4,) the part of each that rose too fast
    for water. read_ns : (4,) when they were read.
    """

    reading_cm: Quad = (nan, nan, nan, nan)
    sudden_cm: Quad = (0.0, 0.0, 0.0, 0.0)
    read_ns: tuple[int, int, int, int] = (0, 0, 0, 0)


def watch_readings(
    model: TankModel, max_V: Pair, live: LiveLevels, measurement: Measurement, trusted: tuple[bool, ...], now_ns: int
) -> LiveLevels:
    """Update with this step's readings. max_V : (2,) the largest drive of each pump."""
    readings, sudden, times = list(live.reading_cm), list(live.sudden_cm), list(live.read_ns)
    level_V, valid, gain = measurement.level_V, measurement.valid, model.level_gain_V_cm
    for tank in range(4):
        now_cm = level_V[tank] / gain
        if not valid[tank] or not isfinite(now_cm):
            continue
        if isfinite(readings[tank]):
            period_s = (now_ns - times[tank]) * 1e-9
            noise_cm = _noise_cm(model, measurement, tank)
            change_cm = now_cm - readings[tank]
            if abs(change_cm) > noise_cm and _is_too_fast(model, max_V, tank, change_cm, period_s, noise_cm):
                sudden[tank] = max(sudden[tank] + change_cm, 0.0)
            if trusted[tank] and sudden[tank]:
                sudden[tank] *= exp(-period_s / FORGET_S)
        readings[tank], times[tank] = now_cm, now_ns
    (r1, r2, r3, r4), (s1, s2, s3, s4), (t1, t2, t3, t4) = readings, sudden, times
    return LiveLevels(reading_cm=(r1, r2, r3, r4), sudden_cm=(s1, s2, s3, s4), read_ns=(t1, t2, t3, t4))


def _is_too_fast(model: TankModel, max_V: Pair, tank: int, change_cm: float, period_s: float, noise_cm: float) -> bool:
    """Whether water can't have changed a level by so much in period_s."""
    rises, falls = fastest_changes(model, max_V)
    return change_cm > rises[tank] * period_s + noise_cm or -change_cm > falls[tank] * period_s + noise_cm


def live_levels_cm(model: TankModel, live: LiveLevels, measurement: Measurement, diagnosis: Diagnosis) -> Quad:
    """(4,) the level that each sensor without trust may still show, in cm; -inf for all others.

    Of what rose too fast for water and what is proven to be the sensor's own, the larger is subtracted: both may
    contain the same.
    """
    valid, trusted, refuted = measurement.valid, diagnosis.trusted, diagnosis.refuted
    if trusted == ALL_SENSORS:
        return NONE
    own_cm = [proven_V / model.level_gain_V_cm for proven_V in diagnosis.proven_V]
    h1, h2, h3, h4 = (
        live.reading_cm[i] - max(live.sudden_cm[i], own_cm[i]) if valid[i] and not (trusted[i] or refuted[i]) else -inf
        for i in range(4)
    )
    return h1, h2, h3, h4


def fastest_changes(model: TankModel, max_V: Pair) -> tuple[Quad, Quad]:
    """(4,) the fastest rise and (4,) the fastest fall of each level, in cm/s.

    Rise: the outlet shut, all water of a pump at max_V and the outflow of a full tank above. Fall: no inflow, full.
    """
    A1, A2, A3, A4 = model.area_cm2
    out1, out2, out3, out4 = (
        a * sqrt(2.0 * model.gravity_cm_s2 * (model.height_cm[i] + model.datum_cm[i]))
        for i, a in enumerate(model.outlet_cm2)
    )
    q1, q2 = model.pump_gain_cm3_Vs[0] * max_V[0], model.pump_gain_cm3_Vs[1] * max_V[1]
    m = RATE_MARGIN
    rises = (m * (q1 + out3) / A1, m * (q2 + out4) / A2, m * q2 / A3, m * q1 / A4)
    return rises, (m * out1 / A1, m * out2 / A2, m * out3 / A3, m * out4 / A4)


def _noise_cm(model: TankModel, measurement: Measurement, tank: int) -> float:
    """What noise may add to the change between two means of readings. Without several readings: nothing."""
    variance_V2 = measurement.jitter_V2[tank]
    if not isfinite(variance_V2) or measurement.readings < 1:
        return 0.0
    return NOISE_STDS * sqrt(2.0 * variance_V2 / measurement.readings) / model.level_gain_V_cm
