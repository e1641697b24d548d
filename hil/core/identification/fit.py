"""The fit of a rig's parameters to records, by least squares of the simulation error.

`fit` minimises the sum of a robust loss of the whitened residuals (`residuals`) over the unknowns (`unknowns`), with
scipy's trust-region method (`least_squares`, method "trf") and the derivatives of the simulation (`kernel`). The loss
is soft_l1 with its bend at `OUTLIER_SD` standard deviations; priors are plain squares.

The noise of each sensor is the scale of its own residuals: it is estimated and the fit repeated until it stays. First
all this is done with `COARSE_ROWS` rows of each record, then with all.

Why so: `docs/decisions/0029-identification-fit.md`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from hil.core.identification.parameters import PARAMETERS, Choice, RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.residuals import Whitened, whitened
from hil.core.identification.result import Prediction
from hil.core.identification.simulation import Simulated, levels, prediction
from hil.core.identification.unknowns import FIXED, Unknowns, unknowns
from hil.core.types import Pair, Quad

Array = NDArray[np.float64]

OUTLIER_SD = 3.0
COARSE_ROWS = 1500
NOISE_ROUNDS = 6
MIN_NOISE_V = 1e-5
CLIPPED_VARIANCE = 0.99501
"""Variance of a normal variable of variance 1 that is limited to +-3."""


@dataclass(frozen=True, eq=False)
class RecordFit:
    """One record after the fit. whitened : residuals and derivatives by all p unknowns.

    weight : (n, 4) by how much the loss counts each residual, 1 for small ones; ruler_weight : (m,).
    """

    name: str
    time_s: Array
    whitened: Whitened
    weight: Array
    ruler_weight: Array
    initial_cm: Quad


@dataclass(frozen=True, eq=False)
class Fit:
    """The result of a fit of p unknowns.

    names : (p,) parameters of the rig, then initial levels ("h1 of NAME"). values, start, low, high : (p,) with the
    limits. prior_sd : (p,) inf without a prior. model : the rig with the values and the noise. cost : half of the sum
    of losses. evaluations : how often all records were simulated.
    """

    names: tuple[str, ...]
    parameters: tuple[str, ...]
    values: Array
    start: Array
    low: Array
    high: Array
    prior_sd: Array
    model: RigModel
    records: tuple[RecordFit, ...]
    predictions: tuple[Prediction, ...]
    noise_V: Quad
    cost: float
    evaluations: int
    is_converged: bool
    message: str

    def __getitem__(self, name: str) -> float:
        """The value of one unknown."""
        return float(self.values[self.names.index(name)])

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Unknowns at one of their limits: no interval by linear theory is right there."""
        span = np.maximum(1e-6 * (self.high - self.low), 1e-12)
        is_at = (self.values <= self.low + span) | (self.values >= self.high - span)
        return tuple(name for name, at in zip(self.names, is_at, strict=True) if at)

    @property
    def information(self) -> Array:
        """(p, p) J' W J of all residuals, and of the priors."""
        total: Array = np.diag(self.prior_sd**-2.0)
        for record in self.records:
            jacobian = record.whitened.jacobian.reshape(-1, len(self.names))
            total = total + jacobian.T @ (record.weight.reshape(-1, 1) * jacobian)
            ruler = record.whitened.ruler_jacobian
            total = total + ruler.T @ (record.ruler_weight[:, None] * ruler)
        return total

    def covariance(self) -> Array:
        """(p, p) for white residuals: pseudo-inverse of `information`; no variance in null directions."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        inverse: Array = np.linalg.pinv(self.information * np.outer(scale, scale), hermitian=True) * np.outer(
            scale, scale
        )
        return inverse


def soft_l1(z: Array) -> Array:
    """(3, m) the loss 2 (sqrt(1 + z) - 1) of squared residuals z, with its first two derivatives."""
    root = np.sqrt(1.0 + z)
    return np.array([2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3])


@dataclass(frozen=True, eq=False)
class _Problem:
    """Records, the rig they start from, the unknowns and the noise that whitens the residuals."""

    records: tuple[LevelRecord, ...]
    start: RigModel
    unknowns: Unknowns
    noise_V: Quad
    outlier_sd: float

    def simulated(self, values: Array) -> list[Simulated]:
        model = self.unknowns.model(self.start, values)
        return [
            levels(model, record, self.unknowns.initial(at, values), self.unknowns.places[at][0])
            for at, record in enumerate(self.records)
        ]

    def whitened(self, values: Array) -> list[Whitened]:
        model, wanted = self.unknowns.model(self.start, values), self.unknowns
        return [
            whitened(model, record, simulated, self.noise_V, wanted.places[at][1], wanted.names)
            for at, (record, simulated) in enumerate(zip(self.records, self.simulated(values), strict=True))
        ]

    def minimum(self, values: Array) -> _Minimum:
        """Minimise from these values on."""
        wanted = self.unknowns
        priors = np.flatnonzero(np.isfinite(wanted.prior_sd))
        prior_jacobian = np.zeros((len(priors), len(wanted.names)))
        prior_jacobian[np.arange(len(priors)), priors] = (wanted.scale / wanted.prior_sd)[priors]
        last: dict[bytes, tuple[Array, Array]] = {}
        count = 0

        def at(x: Array) -> tuple[Array, Array]:
            nonlocal count
            key = x.tobytes()
            if key not in last:
                count += 1
                values = x * wanted.scale
                found = self.whitened(values)
                prior = ((values - wanted.start) / wanted.prior_sd)[priors]
                last.clear()
                last[key] = (
                    np.concatenate([*(one.flat for one in found), prior]),
                    np.concatenate([*(one.flat_jacobian * wanted.scale for one in found), prior_jacobian]),
                )
            return last[key]

        def loss(z: Array) -> Array:
            out = soft_l1(z)
            if len(priors):
                plain = z[-len(priors) :]
                out[:, -len(priors) :] = (plain, np.ones_like(plain), np.zeros_like(plain))
            return out

        low, high = wanted.low / wanted.scale, wanted.high / wanted.scale
        margin = 1e-9 * np.minimum(high - low, 1.0)
        found = least_squares(
            lambda x: at(x)[0],
            np.clip(values / wanted.scale, low + margin, high - margin),
            jac=lambda x: at(x)[1],
            bounds=(low, high),
            method="trf",
            x_scale="jac",
            loss=loss,
            f_scale=self.outlier_sd,
            ftol=1e-9,
            xtol=1e-9,
            gtol=1e-9,
            max_nfev=60,
        )
        return _Minimum(found.x * wanted.scale, float(found.cost), count, found.status > 0, str(found.message))


@dataclass(frozen=True, eq=False)
class _Minimum:
    values: Array
    cost: float
    evaluations: int
    is_converged: bool
    message: str


def fit(
    records: Sequence[LevelRecord],
    start: RigModel,
    choices: Mapping[str, Choice] | None = None,
    *,
    limits: Mapping[str, Pair] | None = None,
    outlier_sd: float = OUTLIER_SD,
) -> Fit:
    """Fit the parameters of a rig, and the initial levels of each record that are not known.

    choices : how parameters are treated, by name or group; without a choice gains, splits, outlets and lags are free,
    all else is fixed. A prior is centred on the start. limits : in place of `unknowns.LIMITS`, by name or group.
    outlier_sd : residuals beyond so many standard deviations count ever less.

    Raises ValueError for no records, two of the same name, an unknown choice, or nothing to be fitted.
    """
    records = tuple(records)
    wanted = unknowns(records, start, choices or {}, limits)
    if not wanted.names:
        raise ValueError("nothing to fit: all parameters are fixed and all initial levels known")
    coarse = _Problem(tuple(_thinned(record) for record in records), start, wanted, start.noise_V, outlier_sd)
    minimum, problem, count = _with_noise(coarse, wanted.start)
    minimum, problem, more = _with_noise(replace(problem, records=records), minimum.values)
    return _result(problem, minimum, count + more)


def fit_initial(model: RigModel, record: LevelRecord, until_s: float | None = None) -> Quad:
    """The initial levels of a record that fit its readings best, with all parameters as they are.

    until_s : only readings before this time count; None: all. Known levels are kept.
    """
    if until_s is not None:
        early = np.where((record.time_s < until_s)[:, None], record.reading_V, np.nan)
        record = replace(record, reading_V=early)
    fixed = {row.group: FIXED for row in PARAMETERS}
    if not unknowns((record,), model, fixed).names:
        first, second, third, fourth = record.initial_cm
        return first, second, third, fourth
    return fit((record,), model, fixed).records[0].initial_cm


def _with_noise(problem: _Problem, values: Array) -> tuple[_Minimum, _Problem, int]:
    """Minimise, with the noise estimated from the residuals; again until the noise stays."""
    count = 0
    minimum: _Minimum | None = None
    for _ in range(NOISE_ROUNDS):
        noise_V = _noise(problem, values)
        is_settled = all(abs(new / old - 1.0) < 0.01 for new, old in zip(noise_V, problem.noise_V, strict=True))
        if minimum is not None and is_settled:
            break
        problem = replace(problem, noise_V=noise_V)
        minimum = problem.minimum(values)
        count += minimum.evaluations
        values = minimum.values
    assert minimum is not None  # noqa: S101 - NOISE_ROUNDS is positive
    return minimum, problem, count


def _noise(problem: _Problem, values: Array) -> Quad:
    """(4,) scale of the residuals of each sensor, per single reading; of a sensor without readings what it was."""
    found = problem.whitened(values)
    noise_V = []
    for i in range(4):
        residual = np.concatenate([_inside(one, record, i) for one, record in zip(found, problem.records, strict=True)])
        noise_V.append(problem.noise_V[i] * _scale(residual) if len(residual) > 8 else problem.noise_V[i])
    n1, n2, n3, n4 = (max(noise, MIN_NOISE_V) for noise in noise_V)
    return n1, n2, n3, n4


def _inside(found: Whitened, record: LevelRecord, sensor: int) -> Array:
    """Residuals of a sensor's readings that are not saturated."""
    low_V, high_V = record.saturation_V
    reading_V = record.reading_V[:, sensor]
    with np.errstate(invalid="ignore"):
        is_inside = found.is_used[:, sensor] & (reading_V > low_V) & (reading_V < high_V)
    inside: Array = found.residual[is_inside, sensor]
    return inside


def _scale(residual: Array) -> float:
    """Standard deviation without outliers: residuals are limited to three times the result."""
    scale = 1.4826 * float(np.median(np.abs(residual))) or float(np.std(residual)) or 1e-9
    for _ in range(50):
        limited = np.minimum(np.abs(residual), 3.0 * scale)
        new = float(np.sqrt(np.mean(limited**2) / CLIPPED_VARIANCE))
        if abs(new / scale - 1.0) < 1e-4:
            break
        scale = new
    return scale


def _thinned(record: LevelRecord) -> LevelRecord:
    """The record with readings in `COARSE_ROWS` rows at most, evenly spaced."""
    every = -(-len(record.time_s) // COARSE_ROWS)
    if every == 1:
        return record
    reading_V = np.full_like(record.reading_V, np.nan)
    reading_V[::every] = record.reading_V[::every]
    return replace(record, reading_V=reading_V)


def _result(problem: _Problem, minimum: _Minimum, evaluations: int) -> Fit:
    wanted, values = problem.unknowns, minimum.values
    model = replace(wanted.model(problem.start, values), noise_V=problem.noise_V)
    bend2 = problem.outlier_sd**2
    parts, predictions = [], []
    for at, (record, found) in enumerate(zip(problem.records, problem.whitened(values), strict=True)):
        initial_cm = wanted.initial(at, values)
        parts.append(
            RecordFit(
                name=record.name,
                time_s=record.time_s,
                whitened=found,
                weight=np.where(found.is_used, soft_l1(found.residual**2 / bend2)[1], 0.0),
                ruler_weight=soft_l1(found.ruler_residual**2 / bend2)[1],
                initial_cm=initial_cm,
            )
        )
        predictions.append(prediction(model, record, levels(model, record, initial_cm).level_cm))
    return Fit(
        names=wanted.names,
        parameters=wanted.parameters,
        values=values,
        start=wanted.start,
        low=wanted.low,
        high=wanted.high,
        prior_sd=wanted.prior_sd,
        model=model,
        records=tuple(parts),
        predictions=tuple(predictions),
        noise_V=problem.noise_V,
        cost=minimum.cost,
        evaluations=evaluations,
        is_converged=minimum.is_converged,
        message=minimum.message,
    )
