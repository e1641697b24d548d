"""The estimate: least squares of the simulation error, then generalised least squares with the noise model.

From afar damped Gauss-Newton steps minimise the residuals as they are, with a noise so large that only the course of
the levels counts. There the noise model is estimated, and some more steps minimise the whitened residuals: the estimate
with the smallest variance, whose intervals are those of linear theory. Then both are repeated once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.intervals import NORMAL_95, covariance, scaled_inverse
from hil.core.identification.noise_model import (
    FIT_BIN_S,
    Linearisation,
    NoiseModel,
    Whitened,
    bin_width,
    binned,
    estimate_noise,
    white_noise,
    whitened,
    without_outliers,
)
from hil.core.identification.parameters import Choice, RigModel, values_of
from hil.core.identification.records import LevelRecord
from hil.core.identification.residuals import whitened as residuals_of
from hil.core.identification.simulation import levels
from hil.core.identification.unknowns import Unknowns, unknowns

Array = NDArray[np.float64]

CLIPPED_SD = 4.0
MAX_STEPS = 12
FAR_STEPS = 40
FAR_NOISE_V = 0.05
CONVERGED_GAIN = 0.01
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
    def cost_of_each(self) -> float:
        """The cost over the number of readings."""
        return self.cost / max(len(self.white.residual), 1)

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

    def linearised(self, values: Array, noise_V: Sequence[float]) -> tuple[list[Linearisation], Array, Array]:
        """Every record about its simulation, and the readings by rulers as rows (m,) and (m, p)."""
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
            margin_V = CLIPPED_SD * np.array(noise_V)
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

    def normal(self, values: Array, noise: NoiseModel) -> Normal:
        """The linearised problem at these values with this noise model."""
        linear, ruler, by_ruler = self.linearised(values, noise.noise_V)
        width_s = bin_width(linear, FIT_BIN_S)
        clean = [binned(without_outliers(record, noise.noise_V), width_s) for record in linear]
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


@dataclass(frozen=True, eq=False)
class Estimate:
    """Values of all unknowns with their covariance (p, p), and the linearised problem there."""

    problem: Problem
    values: Array
    covariance: Array
    noise: NoiseModel
    normal: Normal
    is_converged: bool

    @property
    def names(self) -> tuple[str, ...]:
        """(p,) of the unknowns."""
        return self.problem.names

    @property
    def model(self) -> RigModel:
        """The rig as estimated, with the noise of its sensors."""
        n1, n2, n3, n4 = self.noise.noise_V
        return replace(self.problem.model(self.values), noise_V=(n1, n2, n3, n4))

    def interval(self, name: str) -> tuple[float, float]:
        """The ends of the 95 % interval of an unknown, within its limits."""
        at = self.names.index(name)
        half = NORMAL_95 * float(np.sqrt(max(self.covariance[at, at], 0.0)))
        low, high = float(self.problem.unknowns.low[at]), float(self.problem.unknowns.high[at])
        value = float(self.values[at])
        return max(value - half, low), min(value + half, high)

    def initial(self, record: int) -> tuple[float, float, float, float]:
        """Initial levels of a record."""
        return self.problem.unknowns.initial(record, self.values)


def minimise(
    problem: Problem, values: Array, noise: NoiseModel, max_steps: int = MAX_STEPS
) -> tuple[Array, Normal, bool]:
    """Damped Gauss-Newton steps (Marquardt's) within the limits; values, the problem there, whether it has converged.

    The cost counts only readings away from the ends of their range; their number may change from step to step, so that
    costs are compared per reading.
    """
    low, high = problem.unknowns.low, problem.unknowns.high
    values = np.clip(values, low, high)
    normal, damping, gain = problem.normal(values, noise), 0.0, np.inf
    for _ in range(max_steps):
        gain = float(bounded_step(normal, values, low, high) @ normal.score)
        if gain < CONVERGED_GAIN:
            return values, normal, True
        tried = np.clip(values + bounded_step(normal, values, low, high, damping), low, high)
        at_tried = problem.normal(tried, noise)
        if at_tried.cost_of_each < normal.cost_of_each:
            values, normal, damping = tried, at_tried, 0.1 * damping if damping > 1e-4 else 0.0
        elif gain < 1.0:
            break
        else:
            damping = max(10.0 * damping, 1e-3)
    return values, normal, gain < 1.0


def bounded_step(normal: Normal, values: Array, low: Array, high: Array, damping: float = 0.0) -> Array:
    """The step; unknowns at a limit that it would cross are kept there. damping : share added to the diagonal."""
    free = np.ones(len(values), dtype=bool)
    information, score = normal.information, normal.score
    information = information + damping * np.diag(np.diag(information))
    span = 1e-9 * np.maximum(high - low, 1e-9)
    while True:
        step = np.zeros(len(values))
        step[free] = scaled_inverse(information[np.ix_(free, free)]) @ score[free]
        crossing = free & (((values <= low + span) & (step < 0.0)) | ((values >= high - span) & (step > 0.0)))
        if not crossing.any():
            return step
        free &= ~crossing


def estimate(
    records: Sequence[LevelRecord],
    start: RigModel,
    choices: Mapping[str, Choice],
    priors: Priors = NO_PRIORS,
    *,
    near: Mapping[str, float] | None = None,
    noise: NoiseModel | None = None,
    max_steps: int = MAX_STEPS,
) -> Estimate:
    """The estimate of what the choices leave free. priors : beside those of the choices.

    near : values of unknowns by name from which to go on, in place of steps from afar. noise : kept as it is.
    """
    wanted = unknowns(records, start, choices)
    own = values_of(start)
    given = {name: float(sd) for name, sd in zip(wanted.names, wanted.prior_sd, strict=True) if isfinite(sd)}
    merged = Priors({**{name: own[name] for name in given}, **priors.centre}, {**given, **priors.sd})
    problem = Problem(tuple(records), start, wanted, merged)
    if near is None:
        values, noise_V = wanted.start, (FAR_NOISE_V,) * 4
        values, normal, _ = minimise(problem, values, NoiseModel(noise_V), FAR_STEPS)
    else:
        values = np.array([near.get(name, value) for name, value in zip(wanted.names, wanted.start, strict=True)])
    known = noise or problem.noise(values)
    values, normal, is_done = minimise(problem, values, known, max_steps)
    if noise is None:
        known = problem.noise(values, known)
        values, normal, is_done = minimise(problem, values, known, max_steps)
    return Estimate(problem, values, covariance(normal.white, normal.besides), known, normal, is_done)
