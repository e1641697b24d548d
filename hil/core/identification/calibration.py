"""Gain and offset of a level sensor from known levels: the line reading = offset + gain times level.

Both coordinates have an error: the level that of the ruler, the reading that of its noise. The fit is a weighted least
squares fit in the reading with the effective variance sd_reading^2 + (gain sd_level)^2 (Orear, Am. J. Phys. 50, 1982),
repeated until the gain does not change. A point is judged by its distance from the line through the other points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from hil.core.counted import counted
from hil.core.errors import HilError
from hil.core.types import Pair

Array = NDArray[np.float64]

RULER_SD_CM = 0.1
"""One standard deviation of a level read by a ruler."""
MAX_GAIN_SD = 0.03
"""Largest standard deviation of a gain, relative to it: what the shipped rig file believes of its other parameters."""
MAX_DISTANCE = 3.5
"""A point may be so many standard deviations away from the line through the other points."""
MIN_GAIN_V_CM = 1e-3
"""A sensor with less gain shows no level."""
END_NOISES = 2.0
"""A mean reading within so many noise standard deviations of an end of the range may be cut off there."""
ITERATIONS = 5
MIN_SD_V = 1e-9


class CalibrationError(HilError, ValueError):
    """Points that give no calibration. The message names tank, value and what is allowed."""


@dataclass(frozen=True, slots=True)
class LevelPoint:
    """A known level and the mean reading there. tank : 0..3. level_sd_cm, reading_sd_V : one standard deviation."""

    tank: int
    level_cm: float
    reading_V: float
    level_sd_cm: float = RULER_SD_CM
    reading_sd_V: float = 0.0


@dataclass(frozen=True, slots=True)
class SensorLine:
    """The line of a sensor. gain_sd_V_cm, offset_sd_V : one standard deviation.

    misses_cm : of each point, how far its level is from the line.
    """

    tank: int
    gain_V_cm: float
    offset_V: float
    gain_sd_V_cm: float
    offset_sd_V: float
    points: tuple[LevelPoint, ...]
    misses_cm: tuple[float, ...]


def check_point(point: LevelPoint, height_cm: float, range_V: Pair, noise_V: float) -> None:
    """Raise CalibrationError for a level outside the tank, or a reading outside the sensor's range or at its end.

    height_cm : of the rim. range_V : smallest and largest valid reading. noise_V : of one reading.
    """
    tank, (low_V, high_V) = point.tank + 1, range_V
    if not 0.0 <= point.level_cm <= height_cm:
        raise CalibrationError(
            f"tank {tank}: level {point.level_cm:g} cm is outside 0..{height_cm:g} cm, the tank's height"
        )
    if not low_V <= point.reading_V <= high_V:
        raise CalibrationError(
            f"tank {tank}: reading {point.reading_V:.4g} V at {point.level_cm:g} cm is outside sensors.range_V "
            f"{low_V:g}..{high_V:g} V"
        )
    if min(point.reading_V - low_V, high_V - point.reading_V) < END_NOISES * noise_V:
        raise CalibrationError(
            f"tank {tank}: reading {point.reading_V:.4g} V at {point.level_cm:g} cm is at the end of sensors.range_V "
            f"{low_V:g}..{high_V:g} V, where the sensor may be saturated: use a level that it shows"
        )


def fit_line(points: Sequence[LevelPoint]) -> SensorLine:
    """The line through the points of one tank, two or more.

    Raises CalibrationError when there are too few levels, when they are too close to each other, when the reading does
    not follow the level, and when a point is too far from the line through the others.
    """
    tank = points[0].tank + 1 if points else 0
    level = np.array([point.level_cm for point in points])
    reading = np.array([point.reading_V for point in points])
    if len(set(level.tolist())) < 2:
        raise CalibrationError(
            f"tank {tank}: {counted(len(points), 'point')} at one level; gain and offset need two levels or more"
        )
    gain, offset = float(np.polyfit(level - level.mean(), reading, 1)[0]), 0.0
    for _ in range(ITERATIONS):
        sd = np.array([max(hypot(point.reading_sd_V, gain * point.level_sd_cm), MIN_SD_V) for point in points])
        offset, gain, covariance = _weighted(level, reading, sd)
    gain_sd, offset_sd = sqrt(covariance[1, 1]), sqrt(covariance[0, 0])
    _refuse_no_change(tank, points, gain)
    _refuse_close(tank, points, gain, gain_sd)
    misses = reading - offset - gain * level
    _refuse_bent(tank, points, misses / gain, sd / abs(gain), _leverage(level, sd, covariance))
    return SensorLine(points[0].tank, gain, offset, gain_sd, offset_sd, tuple(points), tuple((-misses / gain).tolist()))


def fit_sensors(points: Sequence[LevelPoint]) -> tuple[SensorLine, ...]:
    """The lines of all tanks that have points, in the order of the tanks. Raises CalibrationError."""
    if not points:
        raise CalibrationError("no points: gain and offset need two levels or more of a tank")
    tanks = sorted({point.tank for point in points})
    return tuple(fit_line([point for point in points if point.tank == tank]) for tank in tanks)


def _weighted(level: Array, reading: Array, sd: Array) -> tuple[float, float, Array]:
    """Offset, gain and their (2, 2) covariance."""
    design = np.column_stack([np.ones_like(level), level]) / sd[:, None]
    covariance: Array = np.asarray(np.linalg.inv(design.T @ design), dtype=np.float64)
    offset, gain = covariance @ design.T @ (reading / sd)
    return float(offset), float(gain), covariance


def _leverage(level: Array, sd: Array, covariance: Array) -> Array:
    """(n,) the weight of each reading in its own fitted value, 0..1."""
    design = np.column_stack([np.ones_like(level), level]) / sd[:, None]
    return np.asarray(np.einsum("ij,jk,ik->i", design, covariance, design))


def _refuse_no_change(tank: int, points: Sequence[LevelPoint], gain: float) -> None:
    levels = [point.level_cm for point in points]
    noise = 3.0 * max(point.reading_sd_V for point in points) / (max(levels) - min(levels))
    if abs(gain) < max(MIN_GAIN_V_CM, noise):
        raise CalibrationError(
            f"tank {tank}: the reading does not follow the level: {gain:.2g} V/cm between {min(levels):g} and "
            f"{max(levels):g} cm; are these levels of another tank, or is the sensor stuck?"
        )


def _refuse_close(tank: int, points: Sequence[LevelPoint], gain: float, gain_sd: float) -> None:
    share = gain_sd / abs(gain)
    if share <= MAX_GAIN_SD:
        return
    levels = [point.level_cm for point in points]
    span_cm = max(levels) - min(levels)
    raise CalibrationError(
        f"tank {tank}: levels from {min(levels):g} to {max(levels):g} cm are too close: they give the gain to "
        f"{100.0 * share:.2g} %, wanted {100.0 * MAX_GAIN_SD:g} % or better; "
        f"two levels {span_cm * share / MAX_GAIN_SD:.2g} cm apart would do"
    )


def _refuse_bent(tank: int, points: Sequence[LevelPoint], miss_cm: Array, sd_cm: Array, leverage: Array) -> None:
    """Refuse the point that is farthest from the line through the others. miss_cm : from the line through all."""
    if len(points) < 3:
        return
    rest = np.maximum(1.0 - leverage, 1e-9)
    distance_cm, allowed_cm = np.abs(miss_cm) / rest, MAX_DISTANCE * sd_cm / np.sqrt(rest)
    worst = int(np.argmax(distance_cm / allowed_cm))
    if distance_cm[worst] <= allowed_cm[worst]:
        return
    point = points[worst]
    which = "any of the three may be wrong" if len(points) == 3 else "read it again, or is the sensor not linear?"
    raise CalibrationError(
        f"tank {tank}: the points do not lie on a line: {point.reading_V:.4g} V at {point.level_cm:g} cm is "
        f"{distance_cm[worst]:.2f} cm off the line through the others, allowed {allowed_cm[worst]:.2f} cm; {which}"
    )
