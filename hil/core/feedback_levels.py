"""The levels that the control law is fed: readings, and estimates in their place."""

from __future__ import annotations

from dataclasses import replace

from hil.core.active_isolation import ProbeState
from hil.core.estimator import Estimate
from hil.core.sensors import levels_shown
from hil.core.tanks import TankModel
from hil.core.types import ALL_SENSORS, Diagnosis, Measurement, Quad


def trusted_readings(measurement: Measurement, trusted: tuple[bool, bool, bool, bool]) -> Measurement:
    """The measurement, with sensors that are not trusted marked as not valid."""
    if trusted == ALL_SENSORS:
        return measurement
    v1, v2, v3, v4 = (ok and good for ok, good in zip(measurement.valid, trusted, strict=True))
    return replace(measurement, valid=(v1, v2, v3, v4))


def feedback_levels_cm(
    model: TankModel, measurement: Measurement, diagnosis: Diagnosis, estimate: Estimate, probe: ProbeState
) -> Quad:
    """Readings in cm, (4,), less the movement that a probe is expected to cause.

    The estimate where a sensor is not trusted or its reading not valid.
    """
    level_cm = _levels_in_use_cm(model, measurement, diagnosis, estimate)
    if probe.linear is None:
        return level_cm
    h1, h2, h3, h4 = (h - moved for h, moved in zip(level_cm, probe.deviation_cm, strict=True))
    return h1, h2, h3, h4


def _levels_in_use_cm(model: TankModel, measurement: Measurement, diagnosis: Diagnosis, estimate: Estimate) -> Quad:
    """Readings in cm, (4,); the estimate where a sensor is not trusted or its reading not valid."""
    k = model.level_gain_V_cm
    if measurement.valid == ALL_SENSORS and diagnosis.trusted == ALL_SENSORS:
        return levels_shown(measurement.level_V, k)
    valid = trusted_readings(measurement, diagnosis.trusted).valid
    h1, h2, h3, h4 = (
        y / k if ok else h for y, ok, h in zip(measurement.level_V, valid, estimate.level_cm, strict=True)
    )
    return (h1, h2, h3, h4)
