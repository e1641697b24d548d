"""Whether a reading has settled: its mean, noise and drift over the last seconds.

The noise is computed from the steps between consecutive readings, sqrt(mean(step^2) / 2), so that a drift adds none.
Waves are slower than that: the uncertainty of the mean is taken from the means of blocks of the detrended readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MIN_READINGS = 25
MIN_SPAN_S = 2.0
"""A shorter time does not show whether the reading settles."""
MAX_DRIFT_CM_S = 0.02
"""A level that moves less is settled: in the 3 s between the look at the ruler and the key it moves by 0.6 mm."""
LOOK_S = 1.0
"""One standard deviation of the time between the look at the ruler and the reading."""
BLOCKS = 8
WAIT = "wait"
"""What a reading lacks that has been seen for too short a time."""


@dataclass(frozen=True, slots=True)
class SteadyReading:
    """A reading over some seconds. mean_sd_V : of the mean; noise_V : of one reading; both one standard deviation.

    lacks : why it can't be used, "" if it has settled.
    """

    mean_V: float
    mean_sd_V: float
    noise_V: float
    drift_V_s: float
    count: int
    lacks: str

    @property
    def is_settled(self) -> bool:
        """Whether the mean can be used."""
        return not self.lacks


NO_READING = SteadyReading(float("nan"), inf, float("nan"), float("nan"), 0, "no reading")


def judge(time_s: Array, reading_V: Array, gain_V_cm: float) -> SteadyReading:
    """Mean, noise, drift and verdict. time_s, reading_V : (n,). gain_V_cm : roughly, of either sign."""
    count = len(time_s)
    if count < 3 or time_s[-1] <= time_s[0]:
        return NO_READING
    t = time_s - time_s.mean()
    drift_V_s = float(t @ reading_V / (t @ t))
    mean_V = float(reading_V.mean())
    noise_V = sqrt(float(np.mean(np.diff(reading_V) ** 2)) / 2.0)
    flat = reading_V - mean_V - drift_V_s * t
    blocks = [float(block.mean()) for block in np.array_split(flat, BLOCKS) if len(block)]
    waves_V = float(np.std(blocks, ddof=1)) / sqrt(len(blocks))
    mean_sd_V = sqrt(max(noise_V / sqrt(count), waves_V) ** 2 + (drift_V_s * LOOK_S) ** 2)
    return SteadyReading(
        mean_V,
        mean_sd_V,
        noise_V,
        drift_V_s,
        count,
        _lacks(float(time_s[-1] - time_s[0]), count, drift_V_s / gain_V_cm),
    )


def _lacks(span_s: float, count: int, drift_cm_s: float) -> str:
    if count < MIN_READINGS or span_s < MIN_SPAN_S:
        return WAIT
    if abs(drift_cm_s) > MAX_DRIFT_CM_S:
        return f"the level {'rises' if drift_cm_s > 0.0 else 'falls'} by {abs(drift_cm_s):.2g} cm/s"
    return ""
