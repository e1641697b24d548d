"""The linearised problem: records, unknowns and priors, and at given values the whitened rows of the equations.

Readings at an end of their range, and those whose prediction lies within four standard deviations of one, do not count:
their noise is cut off on one side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.noise_estimate import estimate_noise
from hil.core.identification.noise_model import (
    FIT_BIN_S,
    Linearisation,
    NoiseModel,
    Whitened,
    bin_width,
    binned,
    white_noise,
    whitened,
    without_outliers,
)
from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.residuals import whitened as residuals_of
from hil.core.identification.simulation import levels
from hil.core.identification.unknowns import Unknowns

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

CLIPPED_SD = 4.0
UNLIMITED_V = (-inf, inf)


@dataclass(frozen=True, eq=False)
class Priors:
    """Priors of parameters by name: centre and one standard deviation."""

    centre: Mapping[str, float]
    sd: Mapping[str, float]

    def rows(self, names: Sequence[str], values: Array) -> tuple[Array, Array]:
        """(p,) information of each unknown, and its pull: the score at these values."""
        information = np.array([self.sd[name] ** -2.0 if name in self.sd else 0.0 for name in names])
        away = np.array([self.centre.get(name, value) - value for name, value in zip(names, values, strict=True)])
        return information, information * away


NO_PRIORS = Priors({}, {})


@dataclass(frozen=True, eq=False)
class Normal:
    """The linearised problem at some values: whitened rows, and the rulers' and priors' part of the equations.

    ruler : (p, p), ruler_score : (p,), ruler_square : sum of squares; prior : (p,) diagonal, prior_score : (p,).
    """

    white: Whitened
    ruler: Array
    ruler_score: Array
    ruler_square: float
    prior: Array
    prior_score: Array
    prior_square: float

    @property
    def besides(self) -> Array:
        """(p, p) information besides the readings."""
        total: Array = self.ruler + np.diag(self.prior)
        return total

    @property
    def information(self) -> Array:
        """(p, p) of everything."""
        total: Array = self.white.sensitivity.T @ self.white.sensitivity + self.besides
        return total

    @property
    def score(self) -> Array:
        """(p,) half of the descent of the cost."""
        total: Array = self.white.sensitivity.T @ self.white.residual + self.ruler_score + self.prior_score
        return total

    @property
    def cost(self) -> float:
        """Sum of squares of everything."""
        return float(self.white.residual @ self.white.residual) + self.ruler_square + self.prior_square


@dataclass(frozen=True, eq=False)
class Problem:
    """Records and unknowns; what is fixed is as in base."""

    records: tuple[LevelRecord, ...]
    base: RigModel
    unknowns: Unknowns
    priors: Priors

    @property
    def names(self) -> tuple[str, ...]:
        """(p,) of the unknowns."""
        return self.unknowns.names

    def model(self, values: Array) -> RigModel:
        """The rig at these values."""
        return self.unknowns.model(self.base, values)

    def linearised(self, values: Array, noise_V: Sequence[float] | None) -> tuple[list[Linearisation], Array, Array]:
        """Every record about its simulation, and the readings by rulers as rows (m,) and (m, p).

        noise_V : leave out readings predicted so near to an end of their range; None: none.
        """
        model, found, rulers, by_rulers = self.model(values), [], [], []
        unit = (1.0, 1.0, 1.0, 1.0)
        for at, record in enumerate(self.records):
            wanted, columns = self.unknowns.places[at]
            simulated = levels(model, record, self.unknowns.initial(at, values), wanted)
            plain = replace(record, samples=None, saturation_V=UNLIMITED_V)
            rows = residuals_of(model, plain, simulated, unit, columns, self.names)
            n = len(record.time_s)
            samples = np.ones((n, 4)) if record.samples is None else np.maximum(record.samples, 1.0)
            predicted_V = np.array(model.sensors.offset_V) + np.array(model.sensors.gain_V_cm) * simulated.level_cm
            margin_V = -inf if noise_V is None else CLIPPED_SD * np.array(noise_V)
            low_V, high_V = record.saturation_V
            is_free = (predicted_V > low_V + margin_V) & (predicted_V < high_V - margin_V) & rows.is_used
            found.append(
                Linearisation(
                    time_s=record.time_s,
                    residual_V=np.where(is_free, rows.residual, np.nan),
                    sensitivity_V=-rows.jacobian,
                    level_cm=simulated.level_cm,
                    samples=samples,
                )
            )
            rulers.append(rows.ruler_residual)
            by_rulers.append(-rows.ruler_jacobian)
        return found, np.concatenate(rulers), np.concatenate(by_rulers)

    def usable(self, values: Array, noise: NoiseModel) -> list[Flags]:
        """For each record the readings (n, 4) that count: away from the ends of their range, and no outliers."""
        linear, _, _ = self.linearised(values, noise.noise_V)
        return [np.isfinite(without_outliers(record, noise.noise_V).residual_V) for record in linear]

    def normal(self, values: Array, noise: NoiseModel, usable: Sequence[Flags] | None = None) -> Normal:
        """The linearised problem at these values with this noise model. usable : as of `usable`; None: here."""
        chosen = self.usable(values, noise) if usable is None else usable
        linear, ruler, by_ruler = self.linearised(values, None)
        width_s = bin_width(linear, FIT_BIN_S)
        clean = [binned(_only(record, rows), width_s) for record, rows in zip(linear, chosen, strict=True)]
        prior, pull = self.priors.rows(self.names, values)
        with np.errstate(divide="ignore", invalid="ignore"):
            prior_square = float(np.sum(np.where(prior > 0.0, pull**2 / prior, 0.0)))
        return Normal(
            white=whitened(clean, self.model(values), noise),
            ruler=by_ruler.T @ by_ruler,
            ruler_score=by_ruler.T @ ruler,
            ruler_square=float(ruler @ ruler),
            prior=prior,
            prior_score=pull,
            prior_square=prior_square,
        )

    def noise(self, values: Array, start: NoiseModel | None = None) -> NoiseModel:
        """The noise model at these values."""
        linear, ruler, by_ruler = self.linearised(values, self.base.noise_V)
        noise_V = white_noise(linear, self.base.noise_V)
        known = NoiseModel(noise_V) if start is None else replace(start, noise_V=noise_V)
        clean = [without_outliers(record, noise_V) for record in linear]
        prior, pull = self.priors.rows(self.names, values)
        information, score = by_ruler.T @ by_ruler + np.diag(prior), by_ruler.T @ ruler + pull
        return estimate_noise(clean, self.model(values), information, score, known, is_first=start is None)


def _only(record: Linearisation, rows: Flags) -> Linearisation:
    """The record with these readings alone."""
    residual = np.where(rows, record.residual_V, np.nan)
    return replace(record, residual_V=residual)
