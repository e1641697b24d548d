"""The estimate: a robust fit of the simulation error, then generalised least squares with the noise model.

From afar a robust fit (`robust_fit`), from more than one start where need be. There the noise model is estimated, and
damped Gauss-Newton steps minimise the whitened residuals: the estimate with the smallest variance, whose intervals are
those of linear theory. Outliers are left out. Then both are repeated once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.gauss_newton import MAX_STEPS, minimise
from hil.core.identification.intervals import NORMAL_95, covariance
from hil.core.identification.minimum import ANCHOR
from hil.core.identification.noise_model import NoiseModel
from hil.core.identification.parameters import Choice, RigModel, values_of
from hil.core.identification.problem import NO_PRIORS, Normal, Priors, Problem
from hil.core.identification.records import LevelRecord
from hil.core.identification.robust_fit import robust_fit
from hil.core.identification.unknowns import unknowns
from hil.core.types import Pair

Array = NDArray[np.float64]

LAST_STEPS = 60


@dataclass(frozen=True, eq=False)
class RigEstimate:
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

    def __getitem__(self, name: str) -> float:
        """The value of an unknown."""
        return float(self.values[self.names.index(name)])

    @property
    def parameters(self) -> tuple[str, ...]:
        """Those of the unknowns that are parameters of the rig."""
        return self.problem.unknowns.parameters

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


def estimate(
    records: Sequence[LevelRecord],
    start: RigModel,
    choices: Mapping[str, Choice] | None = None,
    priors: Priors = NO_PRIORS,
    *,
    near: Mapping[str, float] | None = None,
    noise: NoiseModel | None = None,
    max_steps: int = MAX_STEPS,
    limits: Mapping[str, Pair] | None = None,
) -> RigEstimate:
    """The estimate of what the choices leave free, and of the initial levels of each record that are not known.

    choices : how parameters are treated, by name or group; without a choice gains, splits, outlets and lags are free,
    all else is fixed. priors : beside those of the choices. near : values of unknowns by name from which to go on, in
    place of the robust fit from afar. noise : kept as it is. limits : in place of `unknowns.LIMITS`, by name or group.

    Raises ValueError for no records, two of the same name, an unknown choice, or nothing to be estimated.
    """
    wanted = unknowns(records, start, choices or {}, limits)
    if not wanted.names:
        raise ValueError("nothing to estimate: all parameters are fixed and all initial levels known")
    own = values_of(start)
    anchor = Priors(
        dict(zip(wanted.names, wanted.start.tolist(), strict=True)),
        dict(zip(wanted.names, (ANCHOR * wanted.scale).tolist(), strict=True)),
    )
    given = {name: float(sd) for name, sd in zip(wanted.names, wanted.prior_sd, strict=True) if isfinite(sd)}
    merged = Priors(
        {**anchor.centre, **{name: own[name] for name in given}, **priors.centre},
        {**anchor.sd, **given, **priors.sd},
    )
    problem = Problem(tuple(records), start, wanted, merged)
    if near is None:
        values = robust_fit(problem.records, start, wanted).values
    else:
        values = np.array([near.get(name, value) for name, value in zip(wanted.names, wanted.start, strict=True)])
    known = noise or problem.noise(values)
    values, normal, is_done = minimise(problem, values, known, max_steps)
    if noise is None:
        known = problem.noise(values, known)
        values, normal, is_done = minimise(problem, values, known, max_steps)
    if not is_done and max_steps >= MAX_STEPS:
        values, normal, is_done = minimise(problem, values, known, LAST_STEPS)
    return RigEstimate(problem, values, covariance(normal.white, normal.besides), known, normal, is_done)
