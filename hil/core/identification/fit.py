"""The fit of a rig's parameters to records, by least squares of the simulation error.

`fit` minimises the sum of a robust loss of the whitened residuals (`residuals`) over the unknowns (`unknowns`), with
scipy's trust-region method (`least_squares`, method "trf") and the derivatives of the simulation (`kernel`). The loss
is soft_l1 with its bend at `OUTLIER_SD` standard deviations; priors are plain squares.

The noise of each sensor is the scale of its own residuals: it is estimated and the fit repeated until it stays. First
all this is done with `COARSE_ROWS` rows of each record, from more than one start where need be (`starts`), then with
all.

Why so: `docs/decisions/0029-identification-fit.md`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.minimum import LeastSquares, Minimum, noise_of, soft_l1
from hil.core.identification.parameters import PARAMETERS, Choice, RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.residuals import WhiteResiduals, used_rows
from hil.core.identification.result import Prediction
from hil.core.identification.simulation import levels, prediction
from hil.core.identification.starts import MISFIT, SAME, misfit, other_starts, reading_noise, size_of
from hil.core.identification.unknowns import FIXED, unknowns
from hil.core.types import Pair, Quad

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

OUTLIER_SD = 3.0
MAX_STARTS = 5
COARSE_ROWS = 1500
NOISE_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class RecordFit:
    """One record after the fit: the r rows of it that have readings, or are next to a reading by the ruler.

    time_s : (r,). whitened : residuals and derivatives by all p unknowns. weight : (r, 4) by how much the loss counts
    each residual, 1 for small ones; ruler_weight : (m,). initial_cm : fitted or known.
    """

    name: str
    time_s: Array
    whitened: WhiteResiduals
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


@dataclass(frozen=True)
class _Stage:
    """How carefully to minimise.

    is_pooled : all sensors are as much noisier than at the start: far from the minimum the residuals of one sensor
    say little about its noise. noise_change : by a smaller share the noise has settled. tolerance : of the cost.
    """

    is_pooled: bool
    noise_change: float
    tolerance: float


COARSE = _Stage(is_pooled=True, noise_change=0.2, tolerance=1e-5)
FINE = _Stage(is_pooled=False, noise_change=0.02, tolerance=1e-9)


def fit(
    records: Sequence[LevelRecord],
    start: RigModel,
    choices: Mapping[str, Choice] | None = None,
    *,
    limits: Mapping[str, Pair] | None = None,
    outlier_sd: float = OUTLIER_SD,
    starts: int = MAX_STARTS,
) -> Fit:
    """Fit the parameters of a rig, and the initial levels of each record that are not known.

    choices : how parameters are treated, by name or group; without a choice gains, splits, outlets and lags are free,
    all else is fixed. A prior is centred on the start. limits : in place of `unknowns.LIMITS`, by name or group.
    outlier_sd : residuals beyond so many standard deviations count ever less. starts : at most so many are tried where
    the residuals stay much larger than the noise.

    Raises ValueError for no records, two of the same name, an unknown choice, or nothing to be fitted.
    """
    records = tuple(records)
    wanted = unknowns(records, start, choices or {}, limits)
    if not wanted.names:
        raise ValueError("nothing to fit: all parameters are fixed and all initial levels known")
    coarse = LeastSquares(tuple(_thinned(record) for record in records), start, wanted, start.noise_V, outlier_sd)
    minimum, problem, count = _from_afar(coarse, starts)
    minimum, problem, more = _with_noise(replace(problem, records=records), minimum.values, FINE)
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


def _from_afar(problem: LeastSquares, starts: int) -> tuple[Minimum, LeastSquares, int]:
    """The best minimum of several starts, with the noise there; only the first start where it fits the readings."""
    noise_V = reading_noise(problem.records)
    best, count, size = None, 0, inf
    for values in [problem.unknowns.start, *other_starts(problem.unknowns)][:starts]:
        minimum, there, more = _with_noise(problem, values, COARSE)
        residual_V = noise_of(there, minimum.values, is_pooled=False)
        own = size_of(residual_V)
        count += more
        is_same = abs(own - size) < SAME
        if best is None or own < size:
            best, size = (minimum, there), own
        if misfit(residual_V, noise_V) < MISFIT or is_same:
            break
    assert best is not None  # noqa: S101 - there is one start at least
    return (*best, count)


def _with_noise(problem: LeastSquares, values: Array, stage: _Stage) -> tuple[Minimum, LeastSquares, int]:
    """Minimise, with the noise estimated from the residuals; again until the noise stays."""
    count = 0
    minimum: Minimum | None = None
    for _ in range(NOISE_ROUNDS):
        noise_V = noise_of(problem, values, stage.is_pooled)
        changes = [abs(new / old - 1.0) for new, old in zip(noise_V, problem.noise_V, strict=True)]
        if minimum is not None and max(changes) < stage.noise_change:
            break
        problem = replace(problem, noise_V=noise_V)
        minimum = problem.minimum(values, stage.tolerance)
        count += minimum.evaluations
        values = minimum.values
    assert minimum is not None  # noqa: S101 - NOISE_ROUNDS is positive
    return minimum, problem, count


def _thinned(record: LevelRecord) -> LevelRecord:
    """The record with readings in `COARSE_ROWS` rows at most, evenly spaced, and no row that says nothing."""
    rows = np.flatnonzero(np.isfinite(record.reading_V).any(axis=1))
    every = max(-(-len(rows) // COARSE_ROWS), 1)
    reading_V = np.full_like(record.reading_V, np.nan)
    reading_V[rows[::every]] = record.reading_V[rows[::every]]
    thin = replace(record, reading_V=reading_V)
    is_kept = np.append(True, (np.diff(record.voltage_V, axis=0) != 0.0).any(axis=1))
    is_kept[used_rows(thin)] = True
    is_kept[-1] = True
    return replace(
        thin,
        time_s=record.time_s[is_kept],
        voltage_V=record.voltage_V[is_kept],
        reading_V=reading_V[is_kept],
        samples=None if record.samples is None else record.samples[is_kept],
    )


def _result(problem: LeastSquares, minimum: Minimum, evaluations: int) -> Fit:
    wanted, values = problem.unknowns, minimum.values
    model = replace(wanted.model(problem.start, values), noise_V=problem.noise_V)
    bend2 = problem.outlier_sd**2
    parts, predictions = [], []
    for at, (record, found) in enumerate(zip(problem.records, problem.whitened(values), strict=True)):
        initial_cm = wanted.initial(at, values)
        parts.append(
            RecordFit(
                name=record.name,
                time_s=record.time_s[found.rows],
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
