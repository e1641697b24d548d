"""The minimum of the robust cost of records, at a given noise: scipy's trust-region least squares.

What `robust_fit` calls, again and again with better estimates of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.residuals import WhiteResiduals, used_rows, whitened
from hil.core.identification.simulation import Simulated, levels
from hil.core.identification.unknowns import Unknowns
from hil.core.types import Quad

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_EVALUATIONS = 60
MIN_NOISE_V = 1e-5
CLIPPED_VARIANCE = 0.99501
"""Variance of a normal variable of variance 1 that is limited to +-3."""

ANCHOR = 20.0
"""The start counts as a prior with so many times the scale of each unknown as its sd: next to nothing, but what no
reading depends on stays where it was."""


def soft_l1(z: Array) -> Array:
    """(3, m) the loss 2 (sqrt(1 + z) - 1) of squared residuals z, with its first two derivatives."""
    root = np.sqrt(1.0 + z)
    return np.array([2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3])


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Records, the rig they start from, the unknowns and the noise that whitens the residuals."""

    records: tuple[LevelRecord, ...]
    start: RigModel
    unknowns: Unknowns
    noise_V: Quad
    outlier_sd: float

    @cached_property
    def rows(self) -> list[Ints]:
        """The rows of each record that have a reading."""
        return [used_rows(record) for record in self.records]

    def simulated(self, values: Array) -> list[Simulated]:
        """The simulation of each record at these values (p,)."""
        model = self.unknowns.model(self.start, values)
        return [
            levels(model, record, self.unknowns.initial(at, values), self.unknowns.places[at][0], self.rows[at])
            for at, record in enumerate(self.records)
        ]

    def whitened(self, values: Array) -> list[WhiteResiduals]:
        """The residuals of each record at these values (p,)."""
        model, wanted = self.unknowns.model(self.start, values), self.unknowns
        return [
            whitened(model, record, simulated, self.noise_V, wanted.places[at][1], wanted.names)
            for at, (record, simulated) in enumerate(zip(self.records, self.simulated(values), strict=True))
        ]

    def minimum(self, values: Array, tolerance: float) -> Minimum:
        """Minimise from these values on, until the cost falls by a smaller share than the tolerance."""
        from scipy.optimize import least_squares  # here: a run that fits nothing need not load it

        wanted, rows = self.unknowns, _ScaledRows(self)
        low, high = wanted.low / wanted.scale, wanted.high / wanted.scale
        margin = 1e-9 * np.minimum(high - low, 1.0)
        found = least_squares(
            lambda x: rows.at(x)[0],
            np.clip(values / wanted.scale, low + margin, high - margin),
            jac=lambda x: rows.at(x)[1],
            bounds=(low, high),
            method="trf",
            x_scale="jac",
            loss=rows.loss,
            f_scale=self.outlier_sd,
            ftol=tolerance,
            xtol=min(tolerance, 1e-6),
            gtol=1e-9,
            max_nfev=MAX_EVALUATIONS,
        )
        return Minimum(found.x * wanted.scale, float(found.cost), rows.count, found.status > 0, str(found.message))


class _ScaledRows:
    """Residuals and their derivatives by unknowns over their scales, as scipy takes them; the last ones are kept.

    After the rows of the readings come those of priors and anchor, which are squared whatever the loss.
    """

    def __init__(self, problem: LeastSquares) -> None:
        wanted = problem.unknowns
        self._problem, self.count = problem, 0
        self._priors = np.flatnonzero(np.isfinite(wanted.prior_sd))
        self._squared = len(self._priors) + len(wanted.names)
        self._jacobian = np.zeros((self._squared, len(wanted.names)))
        own = (wanted.scale / wanted.prior_sd)[self._priors]
        self._jacobian[np.arange(len(self._priors)), self._priors] = own
        self._jacobian[len(self._priors) :] = np.eye(len(wanted.names)) / ANCHOR
        self._key, self._last = b"", (np.zeros(0), np.zeros((0, 0)))

    def at(self, x: Array) -> tuple[Array, Array]:
        """(m,) and (m, p) at x, the values over their scales."""
        if x.tobytes() != self._key:
            self.count += 1
            wanted, values = self._problem.unknowns, x * self._problem.unknowns.scale
            found = self._problem.whitened(values)
            prior = ((values - wanted.start) / wanted.prior_sd)[self._priors]
            anchor = (values - wanted.start) / (ANCHOR * wanted.scale)
            self._last = (
                np.concatenate([*(one.flat for one in found), prior, anchor]),
                np.concatenate([*(one.flat_jacobian * wanted.scale for one in found), self._jacobian]),
            )
            self._key = x.tobytes()
        return self._last

    def loss(self, z: Array) -> Array:
        """(3, m) of squared residuals: `soft_l1` of the readings, the square itself of the rest."""
        out, plain = soft_l1(z), self._squared
        out[:, -plain:] = (z[-plain:], np.ones(plain), np.zeros(plain))
        return out


@dataclass(frozen=True, eq=False)
class Minimum:
    """Values (p,) of the unknowns at the minimum, its cost, and how it was reached."""

    values: Array
    cost: float
    evaluations: int
    is_converged: bool
    message: str


def noise_of(problem: LeastSquares, values: Array, is_pooled: bool) -> Quad:
    """(4,) scale of the residuals of each sensor, per single reading; of a sensor without readings what it was."""
    found = problem.whitened(values)
    residuals = [
        np.concatenate([_inside(one, record, i) for one, record in zip(found, problem.records, strict=True)])
        for i in range(4)
    ]
    if is_pooled:
        residuals = [np.concatenate(residuals)] * 4
    scales = [robust_scale(residual) if len(residual) > 8 else 1.0 for residual in residuals]
    n1, n2, n3, n4 = (max(old * scale, MIN_NOISE_V) for old, scale in zip(problem.noise_V, scales, strict=True))
    return n1, n2, n3, n4


def _inside(found: WhiteResiduals, record: LevelRecord, sensor: int) -> Array:
    """Residuals of a sensor's readings that are not saturated."""
    low_V, high_V = record.ends
    reading_V = record.reading_V[found.rows, sensor]
    with np.errstate(invalid="ignore"):
        is_inside = found.is_used[:, sensor] & (reading_V > low_V) & (reading_V < high_V)
    inside: Array = found.residual[is_inside, sensor]
    return inside


def robust_scale(residual: Array) -> float:
    """Standard deviation without outliers: residuals are limited to three times the result. 0 where most are 0."""
    scale = 1.4826 * float(np.median(np.abs(residual)))
    for _ in range(50):
        if scale <= 0.0:
            return 0.0
        limited = np.minimum(np.abs(residual), 3.0 * scale)
        new = float(np.sqrt(np.mean(limited**2) / CLIPPED_VARIANCE))
        if abs(new / scale - 1.0) < 1e-4:
            break
        scale = new
    return scale
