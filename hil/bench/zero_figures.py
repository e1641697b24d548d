"""A design beside the bounds of a zero in the right half plane: steps of the references, and the sensitivity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from hil.core import feedforward
from hil.core.eigenstructure import augment
from hil.core.feedforward import PathLimits
from hil.core.reachable import nearest_reachable
from hil.core.tanks import Array, LinearModel, TankModel, equilibrium, linearise
from hil.core.types import Pair
from hil.core.zero_bounds import ZeroBound, zero_bound
from hil.edge.config.rig_file import Rig
from hil.review.step_response import SETTLED_V

STEPS: Mapping[str, Pair] = {
    "output 1": (0.3, 0.0),
    "output 2": (0.0, 0.3),
    "both": (0.3, 0.3),
    "apart": (0.3, -0.3),
}
"""Steps of the references in V, by name."""

TOLERANCE_V = SETTLED_V
"""An output has settled when it stays so close to its reference."""

PERIOD_S = 0.5
LENGTH_ZEROS = 12.0
"""The responses last LENGTH_ZEROS/z."""

SMALL = 0.5
"""The sensitivity is called small up to the frequency at which it reaches this."""


@dataclass(frozen=True, slots=True)
class StepAgainstBound:
    """A step of the references as the model rig without noise takes it, and what the zero permits.

    Attributes
    ----------
    step_V : (2,) of the references.
    settled_s : after this time both outputs are within `TOLERANCE_V`, s; infinite if they are not at the end.
    least_settled_s : no controller settles sooner that lets the weighted output go the wrong way no further, s.
    wrong_way_V : how far the weighted output goes the wrong way, V.
    squared_error, least_squared_error : integral of the squared errors and its least value, V^2 s.

    """

    step_V: Pair
    settled_s: float
    least_settled_s: float
    wrong_way_V: float
    squared_error: float
    least_squared_error: float


@dataclass(frozen=True, eq=False)
class ZeroFigures:
    """A design and its bound.

    Attributes
    ----------
    bound : ZeroBound
        The zero and its direction.
    steps : mapping of str to StepAgainstBound
        For each of `STEPS`.
    peak, least_peak : float
        Peak of the sensitivity (largest singular value over all frequencies, references to errors of the feedback), and
        what it is at least for a feedback that makes the weighted sensitivity small up to the same frequency.

    """

    bound: ZeroBound
    steps: Mapping[str, StepAgainstBound]
    peak: float
    least_peak: float


def zero_figures(rig: Rig, K: Array, *, is_ahead: bool) -> ZeroFigures | None:
    """The figures of a stable feedback; None if both zeros of the rig are stable.

    K : (2, 6). is_ahead : whether the references are followed along a path (`hil.core.feedforward`), as designs that
    follow the reference do, or by the integrals alone.
    """
    model = rig.tank_model
    linear = linearise(model, equilibrium(model, rig.operating_drives))
    bound = zero_bound(linear)
    if bound is None:
        return None
    steps = {}
    for name, step_V in STEPS.items():
        outputs = _path(model, rig, step_V, bound) if is_ahead else _integral_response(linear, K, step_V, bound)
        steps[name] = _against(bound, step_V, outputs)
    peak, least = _peaks(linear, K, bound)
    return ZeroFigures(bound, steps, peak, least)


def _against(bound: ZeroBound, step_V: Pair, outputs_V: Array) -> StepAgainstBound:
    errors = np.array(step_V) - outputs_V
    late = np.flatnonzero(np.any(np.abs(errors) > TOLERANCE_V, axis=1))
    settled_s = (float(late[-1]) + 1.0) * PERIOD_S if late.size else 0.0
    wrong_way = bound.wrong_way_V(step_V, outputs_V)
    return StepAgainstBound(
        step_V,
        settled_s if late.size == 0 or late[-1] + 1 < len(errors) else float("inf"),
        bound.least_settling_s(step_V, wrong_way, TOLERANCE_V),
        wrong_way,
        float(np.sum(errors**2)) * PERIOD_S,
        bound.least_squared_error(step_V),
    )


def _path(model: TankModel, rig: Rig, step_V: Pair, bound: ZeroBound) -> Array:
    """(n, 2) outputs on the path, less those before the step; none if the pumps can't hold the end."""
    drives, k = rig.operating_drives, model.level_gain_V_cm
    before = equilibrium(model, drives)
    wanted_cm = (before[0] + step_V[0] / k, before[1] + step_V[1] / k)
    limits = _limits(rig)
    held_V = nearest_reachable(model, wanted_cm, (limits.drives_V[0][1], limits.drives_V[1][1])).holding_V
    target = feedforward.target_of(model, held_V)
    path = feedforward.at_rest(feedforward.target_of(model, drives), limits)
    outputs = []
    for _ in range(round(LENGTH_ZEROS / bound.zero_1_s / PERIOD_S)):
        path = feedforward.advance(model, limits, path, target, None)
        outputs.append([k * (path.level_cm[i] - before[i]) for i in (0, 1)])
    return np.array(outputs)


def _limits(rig: Rig) -> PathLimits:
    """What the pumps allow. Lags and delays are much shorter than PERIOD_S and than the zero's time."""
    rate = rig.pumps.rate_V_s
    return PathLimits(rig.pump_path.drive_ranges, (rate, rate), (0.0, 0.0), rig.safety.level_max_cm, PERIOD_S)


def _integral_response(linear: LinearModel, K: Array, step_V: Pair, bound: ZeroBound) -> Array:
    """(n, 2) outputs of the linear model after the step, to which only the integrals react."""
    A, B = augment(linear)
    whole = np.zeros((7, 7))
    whole[:6, :6] = A - B @ K
    whole[4:6, 6] = step_V
    over, state = expm(whole * PERIOD_S), np.array([0.0] * 6 + [1.0])
    outputs = []
    for _ in range(round(LENGTH_ZEROS / bound.zero_1_s / PERIOD_S)):
        state = over @ state
        outputs.append(linear.C @ state[:4])
    return np.array(outputs)


def _peaks(linear: LinearModel, K: Array, bound: ZeroBound) -> Pair:
    """Peak of the sensitivity, and the least one for where its weighted row is small."""
    A, B = augment(linear)
    reference = np.vstack([np.zeros((4, 2)), np.eye(2)])
    C = np.hstack([linear.C, np.zeros((2, 2))])
    frequencies = np.logspace(-3.0, 2.0, 300) * bound.zero_1_s
    shifted = 1j * frequencies[:, None, None] * np.eye(6) - (A - B @ K)
    S = np.eye(2) - C @ np.linalg.solve(shifted, np.broadcast_to(reference.astype(complex), (300, 6, 2)))
    weighted = np.linalg.norm(np.array(bound.direction) @ S, axis=1)
    large = np.flatnonzero(weighted > SMALL)
    up_to = float(frequencies[large[0]]) if large.size else float(frequencies[-1])
    return float(np.linalg.norm(S, 2, axis=(1, 2)).max()), bound.least_peak(SMALL, up_to)
