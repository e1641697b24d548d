"""One step of a filter of a rig that its file does not describe, see `first_day`.

Why: `docs/decisions/0056-the-end-of-a-dead-zone.md`.
"""

from __future__ import annotations

from math import exp, sqrt

from hil.core.diagnosis.glr import kernels
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import VOLTAGE, StepResult
from hil.core.diagnosis.glr.model import BEND, LAG, PUMP, ZONE, Array

STILL_V = 0.1
"""A lag shows in what a pump may still have to follow. With less, its estimate in a wide filter only follows those of
the other parameters: in the ramp of a start phase it went from twice to a twentieth of the file's, with a true one of
three times, so that the end of the ramp was a fault."""

MIN_ZONE_STD_V, CORNER_V = 0.05, 0.5
"""Of a pump whose voltage is at most this much above its dead zone, that is known no better: it ends in no corner, and
whatever else errs by a twentieth of a volt of flow moves it."""


def step(config: DetectorConfig, x: Array, P: Array, entry: Array, result: StepResult) -> float:
    """One step of a wide filter, in place; the log-likelihood of the readings.

    A lag that does not show stays. One that is found shorter becomes so by its logarithm: with its large standard
    deviation the linear step went to nothing in the first tenths of a second, and with such a lag there is nothing left
    to learn from.
    """
    lags, variances = x[LAG : LAG + 2].tolist(), P.diagonal()[LAG : LAG + 2].tolist()
    gaps_V = [_gap_V(x, P, j, float(entry[VOLTAGE + j])) for j in range(2)]
    likelihood: float = kernels.filter_step(config.model, x, P, entry, result)
    for j in range(2):
        if gaps_V[j] < STILL_V:
            x[LAG + j], P[LAG + j, LAG + j] = lags[j], variances[j]
            result.K[LAG + j] = 0.0
        elif x[LAG + j] < lags[j]:
            x[LAG + j] = lags[j] * exp(x[LAG + j] / lags[j] - 1.0)
        if float(entry[VOLTAGE + j] - x[ZONE + j]) < CORNER_V:
            P[ZONE + j, ZONE + j] = max(float(P[ZONE + j, ZONE + j]), MIN_ZONE_STD_V**2)
    return likelihood


def _gap_V(x: Array, P: Array, pump: int, voltage_V: float) -> float:  # noqa: N802 - a unit
    """What a pump may still have to follow at this voltage: the estimate, and one standard deviation of it."""
    at, zone, bend = PUMP + pump, ZONE + pump, BEND + pump
    flow_V, by_zone, by_bend = kernels.flow_voltage(x, pump, voltage_V, sqrt(max(float(P[zone, zone]), 0.0)))
    variance = float(
        P[at, at]
        + by_zone * (by_zone * P[zone, zone] + 2.0 * (by_bend * P[zone, bend] - P[zone, at]))
        + by_bend * (by_bend * P[bend, bend] - 2.0 * P[bend, at])
    )
    return abs(float(flow_V - x[at])) + sqrt(max(variance, 0.0))
