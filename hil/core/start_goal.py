"""The levels that a start phase has to lead to. The control law is asked, and not believed without a check.

A law aims at the reference, or at the nearest outputs that the pumps can hold, by the tanks of the file or as the
diagnosis has found them. Its target says which of these counts. If it is none of them the reference counts: a law must
not be able to declare a start phase successful by a target of its own.
"""

from __future__ import annotations

from hil.core.loop_state import LoopConfig, LoopState
from hil.core.reachable import nearest_reachable
from hil.core.reconfiguration import FAILURES, found_tanks
from hil.core.tanks import TankModel
from hil.core.types import Pair


def goal_cm(model: TankModel, config: LoopConfig, loop: LoopState) -> Pair:
    """(2,) levels of the lower tanks, cm: of these outputs the nearest to the law's target.

    Only if it lies within the tolerance of the start phase, otherwise the reference.
    """
    k, (y1, y2), (r1, r2) = model.level_gain_V_cm, loop.request.target_V, loop.inputs.requested_V
    said_cm, wanted_cm = (y1 / k, y2 / k), (r1 / k, r2 / k)
    goals = (wanted_cm, *_reachable_cm(model, config, loop, wanted_cm))
    nearest = min(goals, key=lambda goal: _distance_cm(goal, said_cm))
    return nearest if _distance_cm(nearest, said_cm) <= config.start.tolerance_cm else wanted_cm


def _reachable_cm(model: TankModel, config: LoopConfig, loop: LoopState, wanted_cm: Pair) -> list[Pair]:
    followed, (most1, most2) = loop.followed, config.pumps.max_drives
    limit_V = (followed.effectiveness[0] * most1, followed.effectiveness[1] * most2)
    found, _ = found_tanks(model, followed.valve_split, followed.waterways)
    reached = []
    for tanks in (model, found):
        try:
            reached.append(nearest_reachable(tanks, wanted_cm, limit_V, config.pumps).lower_cm)
        except FAILURES:
            continue
    return reached


def _distance_cm(first: Pair, second: Pair) -> float:
    return max(abs(first[0] - second[0]), abs(first[1] - second[1]))
