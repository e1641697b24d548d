"""Filling watch: in a start phase a lower tank may be fuller than its sensor shows if too much water goes in.

A sensor that drifts downwards or reads too low while the tanks fill makes the controller send more water, and on a rig
that its file does not describe the diagnosis may take that for a matter of the pumps or the outlets. So the water is
counted: what comes in, by the upper levels, less what stays, by the lower reading, must leave through the outlet. Pumps
have no part in this balance, so that their gains, dead zones, curves and lags don't matter. What goes directly into a
lower tank is its valve's share of what goes into the upper tank across; the ratio of the two is learned from the first
centimetres, while hardly anything leaves, within what a healthy rig may be off its file.

The ratio of what leaves to the outflow of a clean outlet with that reading is 1 on a rig as its file says. A ratio that
no healthy rig reaches, or that has risen until the level behind it would be too high, ends the start phase.
Why: docs/decisions/0034-water-that-comes-in.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from hil.core.tanks import TankModel, clean_outflow, water_balance
from hil.core.types import Pair, Quad

SHARE_RANGE = (0.9, 1.8)
"""Direct water of a lower tank over what the file says. Upper outlets 10 % off give 0.9 to 1.1. A drift
downwards in the first centimetres is learned as a smaller share, and then hides, so that the lower limit is close. A
share that is larger, and limited, would hide one as well: splits 15 % off give up to 1.8."""

LEARN_BELOW_CM = 2.0
"""The share is learned until the reading has this level: so far most of the water stays in the tank."""

LEARN_FROM_CM = 0.5
"""It is used once water for this level has come in."""

JUDGE_FROM_CM = 1.5
"""The ratio counts from the time on when water for this level has come in, so that a reading of 0 is judged, too."""

SMOOTHING_S = 20.0
SETTLED_S = 10.0
"""The ratio is smoothed, and counts when it has been for this time."""

MIN_CLEAN_CM = 1.0
"""The outflow at a lower reading is that of this level: what little leaves there is known badly."""

MAX_RATIO, MAX_RATIO_UNLEARNED = 1.25, 1.5
"""A rig with outlets 10 % and sensors 2 % off reaches 1.15 with its share learned and 1.3 without; with splits 5 %
off as well, 1.24 and 1.45."""

MIN_RISE = 1.1
"""A smaller rise of the ratio is not judged."""

BALANCED_RATIO, BALANCED_RISE = 1.08, 1.06
"""Below both, the water speaks against a level that is not shown."""


@dataclass(frozen=True, slots=True)
class Filling:
    """The water of one lower tank.

    came_cm3 : what has come in. direct_cm3, needed_cm3 : while the share is learned, what came in directly by the file,
    and what must have come. surplus_cm3_s, clean_cm3_s : what leaves, by the balance and by a clean outlet, smoothed.
    age_s : how long the ratio has counted. least : the smallest ratio, inf before the first.
    """

    came_cm3: float = 0.0
    direct_cm3: float = 0.0
    needed_cm3: float = 0.0
    surplus_cm3_s: float = 0.0
    clean_cm3_s: float = 1.0
    age_s: float = 0.0
    least: float = inf

    @property
    def ratio(self) -> float:
        """What leaves, over the outflow of a clean outlet."""
        return self.surplus_cm3_s / self.clean_cm3_s

    @property
    def rise(self) -> float:
        """The ratio over the smallest that it has had; 1 before it counts."""
        return self.ratio / self.least if 0.0 < self.least < inf else 1.0

    def is_learned(self, area_cm2: float) -> bool:
        """Whether enough water has come in to know the share. area_cm2 : of the tank."""
        return self.direct_cm3 >= LEARN_FROM_CM * area_cm2

    def share(self, area_cm2: float) -> float:
        """What comes in directly, over what the file says."""
        if not self.is_learned(area_cm2):
            return 1.0
        low, high = SHARE_RANGE
        return min(max(self.needed_cm3 / self.direct_cm3, low), high)


@dataclass(frozen=True, slots=True)
class FillingWatch:
    """State of the watch for the two lower tanks. level_cm : (4,) levels at watched_ns, None at first."""

    tanks: tuple[Filling, Filling] = (Filling(), Filling())
    level_cm: Quad | None = None
    watched_ns: int = 0

    def rises(self) -> Pair:
        """(2,) the ratio over the smallest that it has had; 1 before it counts."""
        first, second = self.tanks
        return first.rise, second.rise

    def balanced(self, model: TankModel) -> tuple[bool, bool]:
        """(2,) whether nothing in a tank's water speaks for a level that its sensor does not show."""
        first, second = (
            one.age_s >= SETTLED_S
            and one.is_learned(area_cm2)
            and one.ratio < BALANCED_RATIO
            and one.rise < BALANCED_RISE
            for one, area_cm2 in zip(self.tanks, model.area_cm2[:2], strict=True)
        )
        return first, second

    def problem(self, model: TankModel, level_cm: Quad, trusted: tuple[bool, ...], level_max_cm: float) -> str:
        """Why a lower tank may be fuller than its sensor shows; "" if nothing says so. level_cm : (4,) readings."""
        for tank in (0, 1):
            one = self.tanks[tank]
            if not trusted[tank] or one.age_s < SETTLED_S:
                continue
            highest = MAX_RATIO if one.is_learned(model.area_cm2[tank]) else MAX_RATIO_UNLEARNED
            rise = one.rise
            datum_cm = model.datum_cm[tank]
            possible_cm = (max(level_cm[tank], 0.0) + datum_cm) * rise**2 - datum_cm
            if one.ratio > highest or (rise > MIN_RISE and possible_cm > level_max_cm):
                shown_cm = level_cm[tank]
                return (
                    f"tank {tank + 1} gets {one.ratio:.2f} times the water that its outlet lets out at the level shown"
                    f" ({shown_cm:.2f} cm): it leaks, or it is fuller than its sensor shows, or a valve's split is more"
                    " than 10 % off the rig file"
                )
        return ""


def watch_filling(
    model: TankModel, watch: FillingWatch, level_cm: Quad, pump_V: Pair, trusted: tuple[bool, ...], now_ns: int
) -> FillingWatch:
    """Update from the balance since the last step. pump_V : (2,) effective drives, for empty tanks with a datum."""
    period_s = (now_ns - watch.watched_ns) * 1e-9
    if watch.level_cm is None or period_s <= 0.0:
        return FillingWatch(tanks=watch.tanks, level_cm=level_cm, watched_ns=now_ns)
    balance = water_balance(model, watch.level_cm, level_cm, pump_V, period_s)
    tanks = []
    for tank, other in ((0, 1), (1, 0)):
        split = model.valve_split[tank]
        direct = split / max(1.0 - split, 1e-3) * balance.upper_inflow[other]  # this pump's other tank
        above = model.arriving[tank] * balance.outflow[2 + tank]
        if not trusted[tank]:
            tanks.append(Filling())
        else:
            kept = above - balance.growth[tank]
            tanks.append(_next(model, tank, watch.tanks[tank], level_cm[tank], direct, above, kept, period_s))
    return FillingWatch(tanks=(tanks[0], tanks[1]), level_cm=level_cm, watched_ns=now_ns)


def _next(
    model: TankModel,
    tank: int,
    one: Filling,
    level_cm: float,
    direct: float,
    above: float,
    kept: float,
    period_s: float,
) -> Filling:
    """The water of a tank after a period. direct, above : inflows by the file. kept : above less the growth. cm3/s."""
    area_cm2 = model.area_cm2[tank]
    direct_cm3, needed_cm3 = one.direct_cm3, one.needed_cm3
    if level_cm < LEARN_BELOW_CM:
        direct_cm3 += direct * period_s
        needed_cm3 += (clean_outflow(model, tank, max(level_cm, 0.0)) - kept) * period_s
    came_cm3 = one.came_cm3 + (direct + above) * period_s
    now = Filling(came_cm3, direct_cm3, needed_cm3)
    if came_cm3 < JUDGE_FROM_CM * area_cm2:
        return now
    age_s = one.age_s + period_s
    weight = min(period_s / min(age_s, SMOOTHING_S), 1.0)
    surplus = now.share(area_cm2) * direct + kept
    clean = clean_outflow(model, tank, max(level_cm, MIN_CLEAN_CM))
    surplus_cm3_s = one.surplus_cm3_s + weight * (surplus - one.surplus_cm3_s)
    clean_cm3_s = one.clean_cm3_s + weight * (clean - one.clean_cm3_s)
    ratio = surplus_cm3_s / clean_cm3_s
    least = min(one.least, ratio) if age_s >= SETTLED_S else inf
    return Filling(came_cm3, direct_cm3, needed_cm3, surplus_cm3_s, clean_cm3_s, age_s, least)
