"""Gains of the pumps from the flows that are missing in the four tanks.

A pump that gives only theta_j of its flow leaves (1 - theta_j) b_ij v_j missing in the two tanks i that it feeds, with
b the columns of eq. (1). The least-squares gain of pump j is 1 + sum_i b_ij d_i / (v_j sum_i b_ij^2) for unknown
inflows d_i.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.core.tanks import TankModel
from hil.core.types import Pair

MIN_DRIVE_V = 0.3
"""Of a pump that gets less than this nothing can be said."""

FED = ((0, 3), (1, 2))
"""Tanks that each pump feeds."""


def pump_gains(model: TankModel, inflow_cm_s: Sequence[float], drive_V: Pair, before: Pair) -> Pair:
    """(2,) gains over the healthy ones. inflow_cm_s : (4,) unknown inflows. before : kept for a pump that rests."""
    (k1, k2), (g1, g2), A = model.pump_gain_cm3_Vs, model.valve_split, model.area_cm2
    columns = ((g1 * k1 / A[0], (1.0 - g1) * k1 / A[3]), (g2 * k2 / A[1], (1.0 - g2) * k2 / A[2]))
    gains = []
    for pump, (tanks, column) in enumerate(zip(FED, columns, strict=True)):
        v = drive_V[pump]
        if v < MIN_DRIVE_V:
            gains.append(before[pump])
            continue
        missing = sum(b * inflow_cm_s[tank] for tank, b in zip(tanks, column, strict=True))
        gains.append(1.0 + missing / (v * sum(b * b for b in column)))
    return gains[0], gains[1]
