"""The robust fit from which an estimate starts: least squares of the simulation error, from afar.

Minimised is the sum of a robust loss of the residuals, each over the noise of its sensor (`minimum`), by scipy's
trust-region method (`least_squares`, method "trf") and the derivatives of the simulation (`kernel`). The loss is
soft_l1 with its bend at `OUTLIER_SD` standard deviations.

The noise of each sensor is the scale of its own residuals: it is estimated and the fit repeated until it stays. Where
the residuals of a sensor stay much larger than the noise of its readings, the fit begins again elsewhere (`starts`).

From afar it needs few readings: `COARSE_ROWS` rows of all records together. The noise model, the intervals and the last
digits are the business of `estimate`.

Why so: `docs/decisions/0029-identification-fit.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.minimum import LeastSquares, Minimum, noise_of
from hil.core.identification.parameters import PARAMETERS, RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.residuals import used_rows
from hil.core.identification.starts import MISFIT, SAME, misfit, other_starts, reading_noise, size_of
from hil.core.identification.unknowns import FIXED, Unknowns, unknowns
from hil.core.types import Quad

Array = NDArray[np.float64]

OUTLIER_SD = 3.0
MAX_STARTS = 5
COARSE_ROWS, MIN_COARSE_ROWS = 4000, 250
NOISE_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class RobustFit:
    """Values (p,) of the unknowns, the noise of each sensor, and how often the records were simulated."""

    values: Array
    noise_V: Quad
    evaluations: int
    is_converged: bool


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


def robust_fit(
    records: Sequence[LevelRecord], start: RigModel, wanted: Unknowns, *, outlier_sd: float = OUTLIER_SD
) -> RobustFit:
    """The best minimum of `MAX_STARTS` starts; only the first one where it fits the readings.

    outlier_sd : residuals beyond so many standard deviations count ever less. What no reading depends on stays where it
    was.
    """
    rows = max(COARSE_ROWS // len(records), MIN_COARSE_ROWS)
    thin = tuple(thinned(record, rows) for record in records)
    problem = LeastSquares(thin, start, wanted, start.noise_V, outlier_sd)
    noise_V = reading_noise(problem.records)
    best, count, size = None, 0, inf
    for values in [wanted.start, *other_starts(wanted)][:MAX_STARTS]:
        minimum, there, more = _with_noise(problem, values, COARSE)
        residual_V = noise_of(there, minimum.values, is_pooled=False)
        own = size_of(residual_V)
        count += more
        is_same = abs(own - size) < SAME
        if best is None or own < size:
            best, size = (minimum, residual_V), own
        if misfit(residual_V, noise_V) < MISFIT or is_same:
            break
    assert best is not None  # noqa: S101 - there is one start at least
    return RobustFit(best[0].values, best[1], count, best[0].is_converged)


def fit_initial(model: RigModel, record: LevelRecord, until_s: float | None = None) -> Quad:
    """The initial levels of a record that fit its readings best, with all parameters as they are.

    until_s : only readings before this time count; None: all. Known levels are kept.
    """
    if until_s is not None:
        early = np.where((record.time_s < until_s)[:, None], record.reading_V, np.nan)
        record = replace(record, reading_V=early)
    wanted = unknowns((record,), model, {row.group: FIXED for row in PARAMETERS})
    values = wanted.start
    if wanted.names:
        problem = LeastSquares((record,), model, wanted, model.noise_V, OUTLIER_SD)
        values = _with_noise(problem, values, FINE)[0].values
    return wanted.initial(0, values)


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


def thinned(record: LevelRecord, count: int) -> LevelRecord:
    """The record with readings in so many rows at most, evenly spaced, and no row that says nothing."""
    rows = np.flatnonzero(np.isfinite(record.reading_V).any(axis=1))
    every = max(-(-len(rows) // count), 1)
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
