"""Levels and unknown inflows of the four tanks, from readings and drives: what makes predictive control free of offset.

h' = eq. (1) + d, d' = 0, with one unknown inflow d_i (cm/s) for each measured level. As many disturbances as measured
outputs are what offset-free control of all of them needs: G. Pannocchia and J. B. Rawlings, Disturbance models for
offset-free model-predictive control, AIChE Journal 49(2), 2003. Ours: the nonlinear model predicts, and each tank's two
poles are placed at exp(-T / observer_s).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np

from hil.core.laws.law_plant import LawPlant
from hil.core.tanks import level_rates, through_flow_matrix
from hil.core.types import Pair, Quad


@dataclass(frozen=True, slots=True)
class Disturbed:
    """level_cm : (4,). inflow_cm_s : (4,) d. lagged_V : (2,) drives after the lag."""

    level_cm: Quad
    inflow_cm_s: Quad
    lagged_V: Pair


def begin(level_cm: Quad, given_V: Pair) -> Disturbed:
    """Levels as read, no unknown inflow."""
    return Disturbed(level_cm, (0.0, 0.0, 0.0, 0.0), given_V)


def observe(
    plant: LawPlant,
    before: Disturbed,
    level_cm: Quad,
    given_V: Pair,
    effectiveness: Pair,
    period_s: float,
    observer_s: float,
) -> Disturbed:
    """After a period with these drives (2,), given from its start on, and pumps of this effectiveness (2,)."""
    if period_s <= 0.0:
        return before
    lagged, mean = zip(
        *(_lagged(p, v, lag, period_s) for p, v, lag in zip(before.lagged_V, given_V, plant.lag_s, strict=True)),
        strict=True,
    )
    rates = level_rates(plant.model, before.level_cm, (effectiveness[0] * mean[0], effectiveness[1] * mean[1]))
    left = exp(-period_s / observer_s)
    share, learned = 1.0 - left**2, (1.0 - left) ** 2 / period_s
    levels, inflows = [], []
    for h, rate, d, reading in zip(before.level_cm, rates, before.inflow_cm_s, level_cm, strict=True):
        predicted = h + period_s * (rate + d)
        innovation = reading - predicted
        levels.append(max(predicted + share * innovation, 0.0))
        inflows.append(d + learned * innovation)
    return Disturbed(_quad(levels), _quad(inflows), (lagged[0], lagged[1]))


def disturbed_rest(plant: LawPlant, seen: Disturbed, lower_cm: Pair, limit_V: Pair) -> tuple[Quad, Pair]:
    """Levels (4,) and effective drives (2,) within 0..limit_V that hold the lower levels with these inflows.

    Where a drive is at its limit, the levels are those that the drives hold.
    """
    model, d = plant.model, np.array(seen.inflow_cm_s) * np.array(plant.model.area_cm2)
    a, datum, s = np.array(model.outlet_cm2), np.array(model.datum_cm), np.sqrt(2.0 * model.gravity_cm_s2)
    through = through_flow_matrix(model)
    arriving = np.array([d[0] + model.arriving[0] * d[2], d[1] + model.arriving[1] * d[3], d[2], d[3]])
    wanted = a[:2] * s * np.sqrt(np.array(lower_cm) + datum[:2])
    drives = np.clip(np.linalg.solve(through[:2], wanted - arriving[:2]), 0.0, limit_V)
    flows = np.maximum(through @ drives + arriving, 0.0)
    h1, h2, h3, h4 = np.maximum((flows / (a * s)) ** 2 - datum, 0.0).tolist()
    v1, v2 = drives.tolist()
    return (h1, h2, h3, h4), (v1, v2)


def _lagged(before_V: float, given_V: float, lag_s: float, period_s: float) -> Pair:
    """The drive after the lag at the end of the period, and its mean."""
    if lag_s <= 0.0:
        return given_V, given_V
    decay = exp(-period_s / lag_s)
    gap = before_V - given_V
    return given_V + gap * decay, given_V + gap * (1.0 - decay) * lag_s / period_s


def _quad(values: list[float]) -> Quad:
    a, b, c, d = values
    return a, b, c, d
