"""What of the diagnosis the control law follows, and how soon.

A large change of a pump changes the law at once; what may come and go, or is refined with time, waits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

from hil.core.types import Diagnosis, Pair, Waterways

HEALTHY = (1.0, 1.0)

LARGE_CHANGE = 0.2
"""A change of effectiveness of this size or more changes the law at once: the operating voltage is wrong by as much."""

REFINED_CHANGE, REFINING_S = 0.01, 5.0
"""For REFINING_S after a large change, while the estimate is refined, changes of REFINED_CHANGE are followed too."""

SMALL_CHANGE, DWELL_S = 0.005, 10.0
"""Any other change of this size changes the law at most once in DWELL_S: a fault may come and go."""

GROWN_CHANGE, GROWN_S = 0.01, 1.0
"""A change of this size in the direction of the last one changes the law at most once in GROWN_S: a pump fades."""

SPLIT_CHANGE, SPLIT_S = 0.01, 2.0
"""A change of a valve's split of this size is followed, at most once in SPLIT_S."""

WATERWAYS_CHANGE, WATERWAYS_S = 0.02, 2.0
"""A change of an outlet or a leak of this size is followed, at most once in WATERWAYS_S."""


@dataclass(frozen=True, slots=True)
class Followed:
    """What the law follows now: fields of `Diagnosis` as they were when it last followed them.

    changed_s : run time of the last change of effectiveness. change : (2,) by how much it changed then. told_s : run
    time of the last change of it that the record tells; those of a pump that fades are told every DWELL_S.
    refined_until_s : run time until which refinements of it are followed. split_s, waterways_s : run times of the last
    changes of these.
    """

    effectiveness: Pair = HEALTHY
    valve_split: Pair | None = None
    waterways: Waterways | None = None
    changed_s: float = -inf
    change: Pair = (0.0, 0.0)
    told_s: float = -inf
    refined_until_s: float = -inf
    split_s: float = -inf
    waterways_s: float = -inf


def follow(before: Followed, diagnosis: Diagnosis, t_s: float) -> Followed:
    """What the law follows at run time t_s; the same object if nothing has changed."""
    now = before
    if diagnosis.effectiveness != before.effectiveness:
        now = _with_effectiveness(now, diagnosis.effectiveness, t_s)
    if _is_new_split(before.valve_split, diagnosis.valve_split, t_s - before.split_s):
        now = replace(now, valve_split=diagnosis.valve_split, split_s=t_s)
    if _are_new_ways(before.waterways, diagnosis.waterways, t_s - before.waterways_s):
        now = replace(now, waterways=diagnosis.waterways, waterways_s=t_s)
    return now


def _with_effectiveness(before: Followed, effectiveness: Pair, t_s: float) -> Followed:
    change, age_s = _change(before.effectiveness, effectiveness), t_s - before.changed_s
    (a1, a2), (b1, b2) = before.effectiveness, effectiveness
    by = (b1 - a1, b2 - a2)
    is_due = age_s >= DWELL_S and change >= SMALL_CHANGE
    is_grown = age_s >= GROWN_S and change >= GROWN_CHANGE and _goes_on(before.change, by)
    if not change < LARGE_CHANGE or is_due or is_grown:
        until_s = t_s + REFINING_S if change >= LARGE_CHANGE else before.refined_until_s
        told_s = t_s if change >= LARGE_CHANGE or t_s - before.told_s >= DWELL_S else before.told_s
        new = replace(before, effectiveness=effectiveness, changed_s=t_s, change=by, told_s=told_s)
        return replace(new, refined_until_s=until_s)
    if t_s <= before.refined_until_s and change >= REFINED_CHANGE:
        return replace(before, effectiveness=effectiveness, told_s=t_s)
    return before


def _goes_on(last: Pair, by: Pair) -> bool:
    """Whether the pump that changes most goes on in the direction of its last change."""
    pump = 0 if abs(by[0]) >= abs(by[1]) else 1
    return by[pump] * last[pump] > 0.0


def _is_new_split(old: Pair | None, new: Pair | None, age_s: float) -> bool:
    """Whether the law follows other splits than those age_s old: they are refined for some time."""
    if old is None or new is None:
        return old is not new
    return age_s >= SPLIT_S and _change(old, new) >= SPLIT_CHANGE


def _are_new_ways(old: Waterways | None, new: Waterways | None, age_s: float) -> bool:
    """Whether the law follows other waterways than those age_s old."""
    if old is None or new is None:
        return old is not new
    pairs = zip((*old.outlet, *old.leak), (*new.outlet, *new.leak), strict=True)
    return age_s >= WATERWAYS_S and max(abs(b - a) for a, b in pairs) >= WATERWAYS_CHANGE


def _change(old: Pair, new: Pair) -> float:
    return max(abs(new[0] - old[0]), abs(new[1] - old[1]))
