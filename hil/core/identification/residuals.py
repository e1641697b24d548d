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


@dataclass(frozen=True, eq=False)
class Whitened:
    """Residuals of one record and their derivatives by p columns; 0 where nothing was measured.

    residual : (n, 4). jacobian : (n, 4, p). is_used : (n, 4). ruler_residual : (m,). ruler_jacobian : (m, p).
    """

    residual: Array
    jacobian: Array
    is_used: Flags
    ruler_residual: Array
    ruler_jacobian: Array

    @property
    def flat(self) -> Array:
        """All residuals that are used, sensor by sensor and the ruler's behind them."""
        return np.concatenate([self.residual.T[self.is_used.T], self.ruler_residual])

    @property
    def flat_jacobian(self) -> Array:
        """The derivatives of `flat`, (len(flat), p)."""
        by_sensor = self.jacobian.transpose(1, 0, 2)[self.is_used.T]
        return np.concatenate([by_sensor, self.ruler_jacobian])


def whitened(
    model: RigModel,
    record: LevelRecord,
    simulated: Simulated,
    noise_V: Quad,
    columns: Sequence[int],
    names: Sequence[str],
) -> Whitened:
    """The residuals of a record, with derivatives in as many columns as there are names.

    names : of all columns, those of the sensors' parameters among them. columns : where the derivatives that the
    simulation has belong; the other columns are those of other records, or of the sensors.
    """
    level_cm, n, width = simulated.level_cm, len(record.time_s), len(names)
    gains, offsets = np.array(model.sensors.gain_V_cm), np.array(model.sensors.offset_V)
    samples = np.ones((n, 4)) if record.samples is None else np.where(record.samples > 0, record.samples, np.nan)
    is_used = np.isfinite(record.reading_V) & np.isfinite(samples)
    sd_V = np.array(noise_V) / np.sqrt(np.where(is_used, samples, 1.0))
    predicted_V = offsets + gains * level_cm
    jacobian = np.zeros((n, 4, width))
    jacobian[:, :, columns] = simulated.by * gains[None, :, None]
    for position, name in enumerate(names):
        for i in range(4):
            if name == f"sensor_gain{i + 1}":
                jacobian[:, i, position] = level_cm[:, i]
            elif name == f"sensor_offset{i + 1}":
                jacobian[:, i, position] = 1.0
    jacobian /= -sd_V[:, :, None]
    residual = np.where(is_used, (record.reading_V - predicted_V) / sd_V, 0.0)
    _saturate(record, predicted_V, sd_V, residual, jacobian)
    jacobian[~is_used] = 0.0
    ruler_residual, ruler_jacobian = _ruler(record, simulated, columns, width)
    return Whitened(residual, jacobian, is_used, ruler_residual, ruler_jacobian)


def _saturate(record: LevelRecord, predicted_V: Array, sd_V: Array, residual: Array, jacobian: Array) -> None:
    """Replace the residuals of saturated readings, in place."""
    low_V, high_V = record.saturation_V
    with np.errstate(invalid="ignore"):
        ends = ((record.reading_V <= low_V, low_V, -1.0), (record.reading_V >= high_V, high_V, 1.0))
    for is_at_end, end_V, sign in ends:
        if not is_at_end.any():
            continue
        beyond = sign * (predicted_V[is_at_end] - end_V) / sd_V[is_at_end]
        log_p = log_ndtr(beyond)
        value = np.sqrt(np.maximum(-2.0 * log_p, 1e-300))
        density = np.exp(-0.5 * beyond**2 - log_p) / np.sqrt(2.0 * np.pi)
        slope = np.where(value > 1e-12, density / value, 0.0)  # -d value / d beyond
        residual[is_at_end] = sign * value
        jacobian[is_at_end] *= slope[:, None]


def _ruler(record: LevelRecord, simulated: Simulated, columns: Sequence[int], width: int) -> tuple[Array, Array]:
    """Residuals (m,) of the levels read by a ruler, and their derivatives (m, width)."""
    residual, jacobian = np.zeros(len(record.ruler)), np.zeros((len(record.ruler), width))
    for row, read in enumerate(record.ruler):
        at = int(np.clip(np.searchsorted(record.time_s, read.time_s), 1, len(record.time_s) - 1))
        before_s, after_s = record.time_s[at - 1], record.time_s[at]
        part = float(np.clip((read.time_s - before_s) / (after_s - before_s), 0.0, 1.0))
        level_cm = (1.0 - part) * simulated.level_cm[at - 1, read.tank] + part * simulated.level_cm[at, read.tank]
        by = (1.0 - part) * simulated.by[at - 1, read.tank] + part * simulated.by[at, read.tank]
        residual[row] = (read.level_cm - level_cm) / read.sd_cm
        jacobian[row, columns] = -by / read.sd_cm
    return residual, jacobian
