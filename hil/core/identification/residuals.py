"""Whitened residuals of a record and their derivatives.

A residual is (reading - prediction)/sd, with sd the noise of the sensor over the root of the number of readings whose
mean the value is. So at the true parameters residuals have unit variance, and the sum of their squares is -2 log
likelihood but for a constant.

A saturated reading says only that the sensor would show at least (or at most) the end of its range. Its probability is
Phi(z), with z = the number of standard deviations by which the prediction lies beyond that end; its residual is
sqrt(-2 log Phi(z)), which has the same meaning: 0 where the prediction lies far beyond the end, -z far inside. With it
the noise that an end cuts off does not move the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.simulation import Simulated
from hil.core.types import Quad

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class WhiteResiduals:
    """Residuals of one record and their derivatives by p columns; 0 where nothing was measured.

    rows : (r,) rows of the record that these are. residual : (r, 4). jacobian : (r, 4, p). is_used : (r, 4).
    ruler_residual : (m,). ruler_jacobian : (m, p).
    """

    rows: Ints
    residual: Array
    jacobian: Array
    is_used: Flags
    ruler_residual: Array
    ruler_jacobian: Array

    @property
    def flat(self) -> Array:
        """All residuals that are used, row by row, and the ruler's behind them."""
        return np.concatenate([self.residual[self.is_used], self.ruler_residual])

    @property
    def flat_jacobian(self) -> Array:
        """The derivatives of `flat`, (len(flat), p)."""
        width = self.jacobian.shape[2]
        by_row = self.jacobian.reshape(-1, width) if self.is_used.all() else self.jacobian[self.is_used]
        return np.concatenate([by_row, self.ruler_jacobian])


def used_rows(record: LevelRecord) -> Ints:
    """(r,) the rows of a record that have a reading, or are next to one by the ruler."""
    is_wanted: Flags = np.array(np.isfinite(record.reading_V).any(axis=1))
    for read in record.ruler:
        at = _row_after(record, read.time_s)
        is_wanted[at - 1 : at + 1] = True
    return np.flatnonzero(is_wanted)


def whitened(
    model: RigModel,
    record: LevelRecord,
    simulated: Simulated,
    noise_V: Quad,
    columns: Sequence[int],
    names: Sequence[str],
) -> WhiteResiduals:
    """The residuals of a record in the rows of the simulation's derivatives, with as many columns as there are names.

    names : of all columns, those of the sensors' parameters among them. columns : where the derivatives that the
    simulation has belong; the other columns are those of other records, or of the sensors.
    """
    rows, width = simulated.rows, len(names)
    level_cm, reading_V = simulated.level_cm[rows], record.reading_V[rows]
    gains, offsets = np.array(model.sensors.gain_V_cm), np.array(model.sensors.offset_V)
    samples = np.ones((len(rows), 4)) if record.samples is None else record.samples[rows]
    is_used = np.isfinite(reading_V) & (samples > 0.0)
    sd_V = np.array(noise_V) / np.sqrt(np.where(is_used, samples, 1.0))
    predicted_V = offsets + gains * level_cm
    residual = np.where(is_used, (reading_V - predicted_V) / sd_V, 0.0)
    factor = np.where(is_used, -1.0 / sd_V, 0.0)
    _saturate(record, reading_V, predicted_V, sd_V, residual, factor)
    jacobian = np.zeros((len(rows), 4, width))
    jacobian[:, :, columns] = simulated.by * (factor * gains)[:, :, None]
    for position, name in enumerate(names):
        if name.startswith("sensor_"):
            i = int(name[-1]) - 1
            jacobian[:, i, position] = factor[:, i] * (level_cm[:, i] if name.startswith("sensor_gain") else 1.0)
    ruler_residual, ruler_jacobian = _ruler(record, simulated, columns, width)
    return WhiteResiduals(rows, residual, jacobian, is_used, ruler_residual, ruler_jacobian)


def _saturate(
    record: LevelRecord, reading_V: Array, predicted_V: Array, sd_V: Array, residual: Array, factor: Array
) -> None:
    """Replace the residuals of saturated readings, and what their derivatives are multiplied by, in place."""
    low_V, high_V = record.ends
    with np.errstate(invalid="ignore"):
        ends = ((reading_V <= low_V, low_V, -1.0), (reading_V >= high_V, high_V, 1.0))
    for is_at_end, end_V, sign in ends:
        if not is_at_end.any():
            continue
        beyond = sign * (predicted_V[is_at_end] - end_V) / sd_V[is_at_end]
        log_p = log_ndtr(beyond)
        value = np.sqrt(np.maximum(-2.0 * log_p, 1e-300))
        density = np.exp(-0.5 * beyond**2 - log_p) / np.sqrt(2.0 * np.pi)
        slope = np.where(value > 1e-12, density / value, 0.0)  # -d value / d beyond
        residual[is_at_end] = sign * value
        factor[is_at_end] *= slope


def _row_after(record: LevelRecord, time_s: float) -> int:
    """The first row at or after this time that has one before it."""
    return int(np.clip(np.searchsorted(record.time_s, time_s), 1, len(record.time_s) - 1))


def _ruler(record: LevelRecord, simulated: Simulated, columns: Sequence[int], width: int) -> tuple[Array, Array]:
    """Residuals (m,) of the levels read by a ruler, and their derivatives (m, width)."""
    residual, jacobian = np.zeros(len(record.ruler)), np.zeros((len(record.ruler), width))
    for row, read in enumerate(record.ruler):
        at = _row_after(record, read.time_s)
        slot = int(np.searchsorted(simulated.rows, at))
        before_s, after_s = record.time_s[at - 1], record.time_s[at]
        part = float(np.clip((read.time_s - before_s) / (after_s - before_s), 0.0, 1.0))
        level_cm = (1.0 - part) * simulated.level_cm[at - 1, read.tank] + part * simulated.level_cm[at, read.tank]
        by = (1.0 - part) * simulated.by[slot - 1, read.tank] + part * simulated.by[slot, read.tank]
        residual[row] = (read.level_cm - level_cm) / read.sd_cm
        jacobian[row, columns] = -by / read.sd_cm
    return residual, jacobian
