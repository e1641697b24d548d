"""The estimate: least squares of the simulation error, then generalised least squares with the noise model.

From afar damped Gauss-Newton steps minimise the residuals as they are, with a noise so large that only the course of
the levels counts. There the noise model is estimated, and some more steps minimise the whitened residuals: the estimate
with the smallest variance, whose intervals are those of linear theory. Then both are repeated once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, inf, isfinite

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
from hil.core.identification.parameters import BY_NAME, Choice, RigModel, values_of
from hil.core.identification.records import LevelRecord
from hil.core.identification.residuals import whitened as residuals_of
from hil.core.identification.simulation import levels
from hil.core.identification.unknowns import Unknowns, unknowns

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

CLIPPED_SD = 4.0
MAX_STEPS = 12
LAST_STEPS = 60
FAR_STEPS = 40
FAR_NOISE_V = 0.05
CONVERGED_GAIN = 0.01
USABLE_ROUNDS = 4
CHANGED_SHARE = 1e-4
IN_PROPORTION = ("k", "a", "datum", "sensor_gain", "level")
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

    Which readings count is decided before the steps, so that costs can be compared, and again after them unless there
    are to be few steps.
    """
    values = np.clip(values, problem.unknowns.low, problem.unknowns.high)
    usable = problem.usable(values, noise)
    for _ in range(USABLE_ROUNDS if max_steps >= MAX_STEPS else 1):
        values, normal, is_done = _steps(problem, values, noise, usable, max_steps)
        before, usable = usable, problem.usable(values, noise)
        changed = sum(int((one != other).sum()) for one, other in zip(before, usable, strict=True))
        if changed <= CHANGED_SHARE * sum(int(one.sum()) for one in usable):
            break
    return values, normal, is_done


def _steps(
    problem: Problem, values: Array, noise: NoiseModel, usable: Sequence[Flags], max_steps: int
) -> tuple[Array, Normal, bool]:
    low, high = problem.unknowns.low, problem.unknowns.high
    normal, damping, gain = problem.normal(values, noise, usable), 0.0, np.inf
    for _ in range(max_steps):
        gain = float(bounded_step(normal, values, low, high) @ normal.score)
        if gain < CONVERGED_GAIN:
            return values, normal, True
        step = bounded_step(normal, values, low, high, damping)
        tried = np.clip(moved(problem.names, values, step), low, high)
        at_tried = problem.normal(tried, noise, usable)
        if at_tried.cost < normal.cost:
            values, normal, damping = tried, at_tried, 0.1 * damping if damping > 1e-4 else 0.0
        elif gain < 1.0:
            break
        else:
            damping = max(10.0 * damping, 1e-3)
    gain = float(bounded_step(normal, values, low, high) @ normal.score)
    return values, normal, gain < 1.0


def moved(names: Sequence[str], values: Array, step: Array) -> Array:
    """The values after a step, along curves on which readings stay the same where sensor gains are not known.

    If all levels of a side are s times as large as believed, its sensor gains are 1/s, the flows into it s and its
    outlets the root of s times what they were. So gains, outlets, datums and levels move in proportion, and the two
    flows of a pump, gamma k and (1 - gamma) k, each in proportion. A straight step of some per cent would leave the
    curved valley of the cost, and steps become tiny.
    """
    result = values + step
    at = {name: i for i, name in enumerate(names)}
    for name, i in at.items():
        group = BY_NAME[name].group if name in BY_NAME else "level"
        if group in IN_PROPORTION and abs(step[i]) < 0.5 * abs(values[i]):
            result[i] = values[i] * exp(step[i] / values[i])
    for pump in ("1", "2"):
        if f"k{pump}" in at and f"gamma{pump}" in at:
            i, j = at[f"k{pump}"], at[f"gamma{pump}"]
            k, gamma = float(values[i]), float(values[j])
            by_k, by_gamma = float(step[i]) / k, float(step[j])
            if abs(by_k) < 0.5 and abs(by_gamma) < 0.5 * min(gamma, 1.0 - gamma):
                lower, upper = gamma * exp(by_k + by_gamma / gamma), (1 - gamma) * exp(by_k - by_gamma / (1 - gamma))
                result[i], result[j] = k * (lower + upper), lower / (lower + upper)
    return result


def _only(record: Linearisation, rows: Flags) -> Linearisation:
    """The record with these readings alone."""
    residual = np.where(rows, record.residual_V, np.nan)
    return replace(record, residual_V=residual)


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
    if not is_done and max_steps >= MAX_STEPS:
        values, normal, is_done = minimise(problem, values, known, LAST_STEPS)
    return Estimate(problem, values, covariance(normal.white, normal.besides), known, normal, is_done)
