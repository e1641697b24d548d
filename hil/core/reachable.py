"""The lower levels nearest to wanted ones that the pumps can hold."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from hil.core.pumps import STRAIGHT, PumpPath
from hil.core.tanks import TankModel, equilibrium, holding_voltages, through_flow_matrix
from hil.core.types import Pair


@dataclass(frozen=True, slots=True)
class ReachableTarget:
    """The lower levels in force, the effective voltages that hold them, and why they are not the wanted ones.

    reason : "" when they are the wanted ones.
    """

    lower_cm: Pair
    holding_V: Pair
    reason: str


def nearest_reachable(model: TankModel, lower_cm: Pair, limit_V: Pair, pumps: PumpPath = STRAIGHT) -> ReachableTarget:
    """The lower levels nearest to the wanted ones that effective voltages within 0..limit_V can hold.

    The reachable set is the image of a rectangle of voltages. A wanted point outside is nearest to the image of
    one of its four edges; along an edge the squared distance is a quartic in the free voltage, so the candidates
    are the roots of a cubic and the corners: exact, no iteration. Where a datum would leave a lower tank empty, the
    distance is that of the level below zero that its equation gives. pumps : to say drives as voltages.
    """
    v1, v2 = holding_voltages(model, lower_cm)
    tolerance = 1e-9
    too = []
    shown, shown_limit = pumps.voltage((v1, v2)), pumps.voltage(limit_V)
    for pump, drive, voltage in ((0, v1, shown[0]), (1, v2, shown[1])):
        if drive > limit_V[pump] + tolerance:
            too.append(f"pump {pump + 1} would need {voltage:.2f} V of {shown_limit[pump]:.2f} V")
        elif drive < -tolerance:
            too.append(f"pump {pump + 1} would need {voltage:.2f} V, below 0 V")
    if not too:
        return ReachableTarget(lower_cm=lower_cm, holding_V=(v1, v2), reason="")
    flow = through_flow_matrix(model)[:2] / (np.array(model.outlet_cm2[:2])[:, None] * sqrt(2.0 * model.gravity_cm_s2))
    heads_cm = (lower_cm[0] + model.datum_cm[0], lower_cm[1] + model.datum_cm[1])
    best, best_distance = (0.0, 0.0), float("inf")
    for fixed in (0, 1):
        free = 1 - fixed
        for edge in (0.0, limit_V[fixed]):
            lines = [(float(flow[i, fixed] * edge), float(flow[i, free]), heads_cm[i]) for i in (0, 1)]
            for candidate in (0.0, limit_V[free], *_stationary(lines, limit_V[free])):
                value = sum(((p + q * candidate) ** 2 - h) ** 2 for p, q, h in lines)
                if value < best_distance:
                    best_distance = value
                    best = (edge, candidate) if fixed == 0 else (candidate, edge)
    reached = equilibrium(model, best)
    return ReachableTarget(lower_cm=(reached[0], reached[1]), holding_V=best, reason="; ".join(too))


def _stationary(lines: list[tuple[float, float, float]], limit: float) -> list[float]:
    """Where in (0, limit) the sum of ((p + q t)^2 - h)^2 over the (p, q, h) has no slope: real roots of a cubic."""
    cubic = np.zeros(4)
    for p, q, h in lines:
        cubic += (q**4, 3.0 * p * q**3, 3.0 * p**2 * q**2 - h * q**2, p**3 * q - h * p * q)
    return [float(root.real) for root in np.roots(cubic) if abs(root.imag) < 1e-9 and 0.0 < root.real < limit]
