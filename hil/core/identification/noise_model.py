"""What colours the residuals of a simulation: noise of the sensors, waves, turbulence, each as large as the data say.

White noise: at first from the differences of neighbouring residuals, which waves and turbulence hardly touch. Then
all three, by `noise_estimate`. Where residuals are white, waves and turbulence come out as nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.parameters import RigModel
from hil.core.identification.whitening import whitened_side

Array = NDArray[np.float64]

FIT_BIN_S = 0.5
SIDES = ((0, 2), (1, 3))
"""Lower and upper tank of each side."""
OUTLIER_SD = 8.0
MIN_NOISE_V = 1e-5
MAX_BINS = 6000
EMPTY_CM = 0.01


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A record about the model's simulation of it.

    time_s : (n,). residual_V : (n, 4) reading less prediction, NaN where there is none, or one at the end of its range.
    sensitivity_V : (n, 4, p) derivatives of the predictions. level_cm : (n, 4) simulated. samples : (n, 4) how many
    readings each value is the mean of.
    """

    time_s: Array
    residual_V: Array
    sensitivity_V: Array
    level_cm: Array
    samples: Array


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """noise_V : (4,) white noise of one reading. wave_V : (4,). wave_s : (2,) their correlation time on each side.

    turbulence_cm_sqrt_s : (4,) random walk of each level.
    """

    noise_V: tuple[float, ...]
    wave_V: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    wave_s: tuple[float, ...] = (3.0, 3.0)
    turbulence_cm_sqrt_s: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Whitened:
    """White residuals and the sensitivities that belong to them.

    residual : (m,). sensitivity : (m, p). channel : (m,) tank 0..3, or -1 for a reading by a ruler. block : (m,) number
    of the time bin, for residuals that are still correlated. logdet : of the covariance.
    """

    residual: Array
    sensitivity: Array
    channel: NDArray[np.int64]
    block: NDArray[np.int64]
    logdet: float


def white_noise(records: Sequence[Linearisation], fallback_V: Sequence[float]) -> tuple[float, ...]:
    """(4,) standard deviation of one reading, V, from differences of neighbouring residuals; robust to outliers."""
    found = []
    for channel in range(4):
        parts = []
        for record in records:
            value, count = record.residual_V[:, channel], record.samples[:, channel]
            difference = np.diff(value) / np.sqrt(1.0 / count[1:] + 1.0 / count[:-1])
            parts.append(difference[np.isfinite(difference)])
        all_of_them = np.concatenate(parts)
        enough = len(all_of_them) >= 20
        sd = float(np.median(np.abs(all_of_them))) / 0.6745 if enough else float(fallback_V[channel])
        if enough and sd > 0.0:
            inside = all_of_them[np.abs(all_of_them) < 5.0 * sd]
            sd = float(np.sqrt(np.mean(inside**2)))
        found.append(max(sd, MIN_NOISE_V))
    return tuple(found)


def without_outliers(record: Linearisation, noise_V: Sequence[float]) -> Linearisation:
    """Drop single readings that lie far from the median of their neighbourhood."""
    residual = record.residual_V.copy()
    n = len(residual)
    for channel in range(4):
        value = residual[:, channel]
        padded = np.concatenate([np.full(3, np.nan), value, np.full(3, np.nan)])
        around = np.stack([padded[i : i + n] for i in range(7)])
        known = np.isfinite(around).any(axis=0)
        centre = np.full(n, np.nan)
        centre[known] = np.nanmedian(around[:, known], axis=0)
        sd = noise_V[channel] / np.sqrt(record.samples[:, channel])
        with np.errstate(invalid="ignore"):
            residual[np.abs(value - centre) > OUTLIER_SD * sd, channel] = np.nan
    return Linearisation(record.time_s, residual, record.sensitivity_V, record.level_cm, record.samples)


def binned(record: Linearisation, width_s: float) -> Linearisation:
    """Means over bins of this width, weighted by the number of readings; NaN where a bin has none."""
    number = np.floor((record.time_s - record.time_s[0]) / width_s + 1e-9).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    known = np.isfinite(record.residual_V)
    count = np.where(known, record.samples, 0.0)
    total = np.add.reduceat(count, starts)
    safe = np.maximum(total, 1e-12)
    residual = np.add.reduceat(np.where(known, record.residual_V, 0.0) * count, starts) / safe
    sensitivity = np.add.reduceat(record.sensitivity_V * count[:, :, None], starts) / safe[:, :, None]
    rows = np.diff(np.append(starts, len(number)))[:, None]
    return Linearisation(
        time_s=np.add.reduceat(record.time_s, starts) / rows[:, 0],
        residual_V=np.where(total > 0.0, residual, np.nan),
        sensitivity_V=sensitivity,
        level_cm=np.add.reduceat(record.level_cm, starts) / rows,
        samples=np.maximum(total, 1.0),
    )


@dataclass(frozen=True, eq=False)
class SideData:
    """What `whitened_side` needs of one side, all records in a row."""

    columns: Array
    readings: Array
    decay: Array
    gain: Array
    ratio: float
    step: Array
    record: NDArray[np.int64]

    def whitened(self, noise: NoiseModel, side: int) -> tuple[Array, float]:
        """(n, 2, 1 + p) and the log determinant."""
        lower, upper = SIDES[side]
        pair = [lower, upper]
        variance = np.array(noise.noise_V)[pair] ** 2 / self.readings
        wave = np.array([noise.wave_V[lower], noise.wave_V[upper], noise.wave_s[side]])
        walk = np.array(noise.turbulence_cm_sqrt_s)[pair]
        white, logdet = whitened_side(self.columns, variance, self.decay, self.gain, self.ratio, self.step, walk, wave)
        return white, float(logdet)


def sides_of(records: Sequence[Linearisation], model: RigModel) -> tuple[SideData, SideData]:
    """Both sides of the records."""
    return _side(records, model, 0), _side(records, model, 1)


def _side(records: Sequence[Linearisation], model: RigModel, side: int) -> SideData:
    tanks = model.tanks
    pair = list(SIDES[side])
    area, outlet = np.array(tanks.area_cm2)[pair], np.array(tanks.outlet_cm2)[pair]
    datum = np.array(tanks.datum_cm)[pair]
    level = np.concatenate([record.level_cm[:, pair] for record in records])
    head = np.maximum(level + datum, 0.02)
    fade = np.where(level > EMPTY_CM, np.sqrt(tanks.gravity_cm_s2 / (2.0 * head)), 1e4)
    columns = [
        np.concatenate([record.residual_V[:, pair, None], record.sensitivity_V[:, pair]], axis=2) for record in records
    ]
    return SideData(
        columns=np.ascontiguousarray(np.concatenate(columns)),
        readings=np.concatenate([record.samples[:, pair] for record in records]),
        decay=outlet / area * fade,
        gain=np.array(model.sensors.gain_V_cm)[pair],
        ratio=float(area[1] / area[0]) * tanks.arriving[side],
        step=np.concatenate([np.diff(record.time_s, prepend=record.time_s[0]) for record in records]),
        record=np.concatenate([np.full(len(record.time_s), i) for i, record in enumerate(records)]),
    )


def whitened(records: Sequence[Linearisation], model: RigModel, noise: NoiseModel) -> Whitened:
    """White residuals of all records, and their sensitivities."""
    residuals, sensitivities, channels, blocks, logdet = [], [], [], [], 0.0
    for side, data in enumerate(sides_of(records, model)):
        white, part = data.whitened(noise, side)
        logdet += part
        known = np.isfinite(data.columns[:, :, 0])
        at, which = np.nonzero(known)
        residuals.append(white[at, which, 0])
        sensitivities.append(white[at, which, 1:])
        channels.append(np.array(SIDES[side])[which])
        blocks.append(at)
    return Whitened(
        np.concatenate(residuals),
        np.concatenate(sensitivities),
        np.concatenate(channels),
        np.concatenate(blocks),
        logdet,
    )


def bin_width(records: Sequence[Linearisation], width_s: float) -> float:
    """The width of the bins in s, larger for long records, so that there are at most `MAX_BINS` of them."""
    total_s = sum(float(record.time_s[-1] - record.time_s[0]) for record in records)
    return max(width_s, total_s / MAX_BINS)


def root_mean_square(residual_V: Array) -> float:
    """Of the values that are not NaN; NaN if none is."""
    known = residual_V[np.isfinite(residual_V)]
    return sqrt(float(np.mean(known**2))) if len(known) else float("nan")
