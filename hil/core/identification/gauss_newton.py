"""Damped Gauss-Newton steps to the minimum of the whitened residuals, within the limits of the unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.intervals import scaled_inverse
from hil.core.identification.noise_model import NoiseModel
from hil.core.identification.parameters import BY_NAME
from hil.core.identification.problem import Normal, Problem

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MAX_STEPS = 12
CONVERGED_GAIN = 0.01
SETTLED_GAIN, SETTLED_SD = 4.0, 0.2
"""A step that promises less, and moves no parameter by more than so many standard deviations, is the last one."""
USABLE_ROUNDS = 4
CHANGED_SHARE = 1e-4
IN_PROPORTION = ("k", "a", "datum", "sensor_gain", "level")


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
    step = bounded_step(normal, values, low, high)
    return values, normal, is_settled(problem.names, normal, step)


def is_settled(names: Sequence[str], normal: Normal, step: Array) -> bool:
    """Whether a further step (p,) would lower the cost by less than 1, or move no parameter of the rig noticeably.

    The level in a tank that is nearly empty when its record begins has a kink at zero, on which steps may go to and fro
    without an end, though everything else stands.
    """
    gain = float(step @ normal.score)
    if gain < 1.0:
        return True
    sd = np.sqrt(np.maximum(np.diag(scaled_inverse(normal.information)), 0.0))
    at = [i for i, name in enumerate(names) if name in BY_NAME]
    return gain < SETTLED_GAIN and bool(np.all(np.abs(step[at]) <= SETTLED_SD * sd[at]))


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
