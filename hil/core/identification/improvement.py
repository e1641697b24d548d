"""Whether the identified rig predicts held-out records better than the old file: the condition for its replacement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np

from hil.core.identification.result import Identification, Prediction

MIN_IMPROVEMENT = 0.1
"""An old file is replaced only by one whose error on the held-out record is smaller by this share."""


MAX_MISFIT = 2.0
"""A held-out error of more noises than this says that the model lacks something."""


@dataclass(frozen=True, slots=True)
class Improvement:
    """before_V, after_V : RMS error over all sensors of the held-out record; NaN if there is none."""

    before_V: float
    after_V: float

    @property
    def share(self) -> float:
        """By what share the error is smaller now; negative if it is larger, NaN if that is not known."""
        return 1.0 - self.after_V / self.before_V if self.before_V > 0.0 else float("nan")

    @property
    def is_enough(self) -> bool:
        """Whether the old file may be replaced."""
        return self.share >= MIN_IMPROVEMENT

    @property
    def sentence(self) -> str:
        """What was found, for a user."""
        if not isfinite(self.share):
            return "No held-out record tells whether the identified file predicts better than the old one."
        change = f"{abs(self.share) * 100:.3g} % {'less' if self.share >= 0.0 else 'more'}"
        return (
            f"On the held-out record the identified file is off by {self.after_V * 1e3:.3g} mV (RMS of all sensors), "
            f"the old one by {self.before_V * 1e3:.3g} mV: {change}."
        )


def improvement(identification: Identification) -> Improvement:
    """Of the identified rig over the old one, on the sensors that the held-out record has."""
    before, after = identification.holdout_rmse_before_V, identification.holdout_rmse_V
    both = [one for one in zip(before, after, strict=True) if all(map(isfinite, one))]
    return Improvement(_rms([one for one, _ in both]), _rms([one for _, one in both]))


def _rms(values: list[float]) -> float:
    return sqrt(sum(value**2 for value in values) / len(values)) if values else float("nan")


def row_noise_V(predictions: Sequence[Prediction], sensor: int) -> float:  # noqa: N802 - a unit
    """Standard deviation of the noise in a row of records, from the differences of neighbouring residuals.

    Smaller than that of one reading where a row is a mean of several. Residuals of exactly zero, of sensors at an end
    of their range, do not count. NaN without residuals. sensor : 0..3.
    """
    squares = []
    for one in predictions:
        residual = np.where(one.residuals[:, sensor] == 0.0, np.nan, one.residuals[:, sensor])
        difference = np.diff(residual)
        squares.append(difference[np.isfinite(difference)] ** 2)
    pooled = np.concatenate(squares) if squares else np.empty(0)
    return sqrt(0.5 * float(np.mean(pooled))) if len(pooled) else float("nan")


def misfit_sentence(identification: Identification) -> str:
    """What is missing where the identified rig does not predict the held-out record to its noise; "" where it does."""
    held_out = [one for one in identification.predictions if one.is_held_out]
    shares = {}
    for sensor, (error_V, reading_V) in enumerate(
        zip(identification.holdout_rmse_V, identification.model.noise_V, strict=True)
    ):
        row_V = row_noise_V(held_out, sensor)
        noise_V = row_V if isfinite(row_V) else reading_V
        if noise_V > 0.0 and isfinite(error_V):
            shares[sensor + 1] = error_V / noise_V
    if not shares or max(shares.values()) <= MAX_MISFIT:
        return ""
    worst = max(shares, key=lambda sensor: shares[sensor])
    return (
        f"The identified model misses sensor {worst} in the held-out record by {shares[worst]:.2g} times its noise: "
        "the rig has something that this structure does not describe, or it has changed during the records."
    )
