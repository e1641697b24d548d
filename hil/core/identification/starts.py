"""Other starts for a fit that ended far from its readings.

The cost has few minima: from a rig file that is 50 % off, without curve, dead zone, delay and datum, nearly every fit
ends at the lowest. A fit can end at a rig whose upper tank is always empty: no parameter of that tank moves a reading
there any more. Then the residuals are much larger than the noise of the readings, and the fit begins again elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.minimum import robust_scale
from hil.core.identification.records import LevelRecord
from hil.core.identification.unknowns import Unknowns
from hil.core.types import Quad

Array = NDArray[np.float64]

MISFIT = 4.0
"""Residuals of a sensor that are so many times its noise ask for another start."""

MIN_NOISE_V = 1e-3
"""A sensor with less noise, by the differences of its readings, is one whose converter does not show it."""

SAME = 0.02
"""Two starts whose residuals differ by a smaller share ended at the same minimum."""

OTHERS: tuple[dict[str, tuple[float, float]], ...] = (
    {"k": (0.7, 0.0), "dead_zone": (1.0, 0.3)},
    {"k": (1.5, 0.0), "a": (1.2, 0.0), "gamma": (0.7, 0.0)},
    {"delay": (1.0, 0.5), "dead_zone": (1.0, 0.8)},
    {"a": (0.6, 0.0), "k": (0.6, 0.0), "lag": (3.0, 0.0)},
)
"""Each start by group: factor and summand for the value of the first start."""


def other_starts(unknowns: Unknowns) -> list[Array]:
    """(p,) each, within the limits; those that the unknowns do not change are left out."""
    found = []
    for change in OTHERS:
        values = unknowns.start.copy()
        for at, name in enumerate(unknowns.parameters):
            factor, summand = change.get(name.rstrip("1234"), (1.0, 0.0))
            values[at] = values[at] * factor + summand
        values = np.clip(values, unknowns.low, unknowns.high)
        if not np.array_equal(values, unknowns.start):
            found.append(values)
    return found


def reading_noise(records: Sequence[LevelRecord]) -> Quad:
    """(4,) noise of one reading by the differences of neighbouring values, V; inf without readings.

    Where the levels move from one value to the next, as in a record with seconds between them, this is more than noise.
    """
    found = []
    for sensor in range(4):
        parts = []
        for record in records:
            low_V, high_V = record.ends
            with np.errstate(invalid="ignore"):
                is_read = (record.reading_V[:, sensor] > low_V) & (record.reading_V[:, sensor] < high_V)
            count = np.ones(int(is_read.sum())) if record.samples is None else record.samples[is_read, sensor]
            step_V = np.diff(record.reading_V[is_read, sensor])
            parts.append(step_V / np.sqrt(1.0 / np.maximum(count[1:], 1.0) + 1.0 / np.maximum(count[:-1], 1.0)))
        steps = np.concatenate(parts)
        found.append(robust_scale(steps) if len(steps) > 8 else float("inf"))
    return found[0], found[1], found[2], found[3]


def misfit(residual_V: Quad, noise_V: Quad) -> float:
    """By how many times the residuals of the worst sensor are larger than its noise."""
    return max(residual / max(noise, MIN_NOISE_V) for residual, noise in zip(residual_V, noise_V, strict=True))


def size_of(residual_V: Quad) -> float:
    """One number to compare the residuals of two starts: their logarithms' mean."""
    return float(np.mean(np.log(residual_V)))
