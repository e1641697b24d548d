"""Peak levels: how high each tank still rises when both pumps are stopped now.

The upper tanks still drain: tank 3 into tank 1, tank 4 into tank 2. Without inflow,

    A_u h_u' = -a_u sqrt(2 g h_u)                      the upper tank: sqrt(h_u) falls at a constant rate
    A_l h_l' =  a_u sqrt(2 g h_u) - a_l sqrt(2 g h_l)  the lower tank: highest where a_l^2 h_l = a_u^2 h_u

An outlet at a datum has the head h + datum in place of h, and the upper tank stops draining when it is empty: the peak
of the equations above is then an upper bound, and so is all water of the upper tank in the lower one.

With w = sqrt(h_l/h_u), alpha = A_u/A_l, beta = a_l/a_u the second over the first is separable:

    d ln sqrt(h_u) = -w dw/(w^2 - alpha beta w + alpha),   peak at w = 1/beta

While its lag decays a pump still delivers a volume of k_j v_j times the lag. Outflow grows with level, so additional
water raises a tank, or the tank below it, by at most its own volume. Adding that volume gives an upper bound.

A blocked outlet drains less than eq. (1) says. The outflow of a lower tank is therefore measured: inflow minus the
change of its volume, as a share of a_l sqrt(2 g h_l), smoothed over SMOOTHING_S. An outlet that clogs goes on clogging
after the pumps have stopped: a share that falls is extrapolated over the time in which the tank above drains.
The interlock that uses it: docs/decisions/0011-interlocks.md.
"""

from __future__ import annotations

from cmath import log as complex_log
from cmath import sqrt as complex_sqrt
from math import exp, sqrt
from typing import NamedTuple

from hil.core.tanks import TankModel, clean_outflow, water_balance
from hil.core.types import Pair, Quad

MIN_ROOT_DISTANCE = 1e-6
"""The two roots of w^2 - alpha beta w + alpha are kept at least this far apart."""

SMOOTHING_S = 3.0
TREND_S = 10.0
"""The rate at which the share falls is that over about this time."""

MIN_SHARE = 0.02
"""Lower limit of the open share: an outlet that is almost shut. All water above then still arrives."""

SHARE_RANGE = (-1.0, 3.0)
"""Limits for what one step may contribute to the share; a level that jumps more is a sensor fault."""

MIN_LEVEL_CM = 1.0
"""The share is computed as if the level were at least this high: a nearly empty tank shows little of its outlet."""


class Outlets(NamedTuple):
    """State of the outlet monitor for the two lower tanks.

    share : (2,) measured outflow over that of eq. (1). level_cm : (4,) levels at watched_ns, None at first.
    earlier : (2,) the share smoothed once more, over TREND_S. drain_s : (2,) time in which the tank above drains.
    """

    share: Pair = (1.0, 1.0)
    level_cm: Quad | None = None
    watched_ns: int = 0
    earlier: Pair = (1.0, 1.0)
    drain_s: Pair = (0.0, 0.0)

    @property
    def open_share(self) -> Pair:
        """(2,) the share when the tank above has drained, within MIN_SHARE..1: never more than a clean outlet."""
        (first, second), (earlier1, earlier2), (drain1, drain2) = self.share, self.earlier, self.drain_s
        # a share that falls at a constant rate is SMOOTHING_S behind, and the earlier one TREND_S behind it
        first -= max(earlier1 - first, 0.0) / TREND_S * (SMOOTHING_S + drain1)
        second -= max(earlier2 - second, 0.0) / TREND_S * (SMOOTHING_S + drain2)
        return min(max(first, MIN_SHARE), 1.0), min(max(second, MIN_SHARE), 1.0)


def watch(model: TankModel, outlets: Outlets, level_cm: Quad, pump_V: Pair, now_ns: int) -> Outlets:
    """Update from the mass balance of each lower tank since the last step. pump_V : (2,) effective pump voltages, V."""
    period_s = (now_ns - outlets.watched_ns) * 1e-9
    if outlets.level_cm is None or period_s <= 0.0:
        return outlets._replace(level_cm=level_cm, watched_ns=now_ns)
    share1, share2 = outlets.share
    left1, left2 = water_balance(model, outlets.level_cm, level_cm, pump_V, period_s).lower_outflow
    seen1 = left1 / clean_outflow(model, 0, max(level_cm[0], MIN_LEVEL_CM))
    seen2 = left2 / clean_outflow(model, 1, max(level_cm[1], MIN_LEVEL_CM))
    low, high = SHARE_RANGE
    weight = min(period_s / SMOOTHING_S, 1.0)
    share1 += weight * (min(max(seen1, low), high) - share1)
    share2 += weight * (min(max(seen2, low), high) - share2)
    weight, (earlier1, earlier2) = min(period_s / TREND_S, 1.0), outlets.earlier
    return Outlets(
        share=(share1, share2),
        level_cm=level_cm,
        watched_ns=now_ns,
        earlier=(earlier1 + weight * (share1 - earlier1), earlier2 + weight * (share2 - earlier2)),
        drain_s=(_drain_s(model, 2, level_cm[2]), _drain_s(model, 3, level_cm[3])),
    )


def rebase(model: TankModel, outlets: Outlets, level_cm: Quad, change_V: Pair) -> Outlets:
    """The shares as if the pumps' flow had been believed to be another one all along.

    A pump that turns out to give less than its file changes the shares, but no outlet: without this the fall of the
    share was extrapolated as an outlet that clogs. change_V : (2,) what is now believed of each pump's drive, less what
    was, V.
    """
    direct1, direct2 = (g * k * v for g, k, v in zip(model.valve_split, model.pump_gain_cm3_Vs, change_V, strict=True))
    change1 = direct1 / clean_outflow(model, 0, max(level_cm[0], MIN_LEVEL_CM))
    change2 = direct2 / clean_outflow(model, 1, max(level_cm[1], MIN_LEVEL_CM))
    (first, second), (earlier1, earlier2) = outlets.share, outlets.earlier
    return outlets._replace(share=(first + change1, second + change2), earlier=(earlier1 + change1, earlier2 + change2))


def _drain_s(model: TankModel, tank: int, level_cm: float) -> float:
    """Time in which a tank without inflow runs empty, s."""
    return 2.0 * model.area_cm2[tank] * _root(level_cm, model.datum_cm[tank]) / model.outlet_flow[tank]


def _root(level_cm: float, datum_cm: float) -> float:
    """By how much the root of the head falls until a tank is empty."""
    return sqrt(max(level_cm, 0.0) + datum_cm) - sqrt(datum_cm)


def peak_levels(model: TankModel, lag_s: Pair, level_cm: Quad, pump_V: Pair, open_share: Pair = (1.0, 1.0)) -> Quad:
    """(4,) the peak of each level, in cm, with the pumps stopped now.

    lag_s : (2,) lag and delay of each pump. pump_V : (2,) the most that each pump may still deliver, as a drive.
    open_share : (2,) of `Outlets`.
    """
    A1, A2, A3, A4 = model.area_cm2
    a1, a2, a3, a4 = model.outlet_cm2
    a1, a2 = open_share[0] * a1, open_share[1] * a2
    (k1, k2), (g1, g2) = model.pump_gain_cm3_Vs, model.valve_split
    (h1, h2, h3, h4), (d1, d2, d3, d4) = level_cm, model.datum_cm
    late1_cm3, late2_cm3 = k1 * pump_V[0] * lag_s[0], k2 * pump_V[1] * lag_s[1]
    late3_cm3, late4_cm3 = (1.0 - g2) * late2_cm3, (1.0 - g1) * late1_cm3
    head1, head2, head3, head4 = h1 + d1, h2 + d2, h3 + d3, h4 + d4
    peak1 = h1 if a3 * a3 * head3 <= a1 * a1 * head1 else drained_peak(A3 / A1, a1 / a3, head3, head1) - d1
    peak2 = h2 if a4 * a4 * head4 <= a2 * a2 * head2 else drained_peak(A4 / A2, a2 / a4, head4, head2) - d2
    if d3 > 0.0:
        peak1 = min(peak1, h1 + max(h3, 0.0) * A3 / A1)
    if d4 > 0.0:
        peak2 = min(peak2, h2 + max(h4, 0.0) * A4 / A2)
    return (
        peak1 + (g1 * late1_cm3 + late3_cm3) / A1,
        peak2 + (g2 * late2_cm3 + late4_cm3) / A2,
        h3 + late3_cm3 / A3,
        h4 + late4_cm3 / A4,
    )


def drained_peak(alpha: float, beta: float, upper_cm: float, lower_cm: float) -> float:
    """Peak level in cm of a lower tank while the tank above it drains into it.

    alpha : A_u/A_l. beta : a_l/a_u. The lower tank rises as long as beta^2 lower_cm < upper_cm.
    """
    half = 0.5 * alpha * beta
    root = complex_sqrt(half * half - alpha)
    if abs(root) < MIN_ROOT_DISTANCE:
        root = complex(MIN_ROOT_DISTANCE)
    first, second = half + root, half - root

    def integral(w: float) -> complex:
        return (first * complex_log(w - first) - second * complex_log(w - second)) / (first - second)

    start = (max(lower_cm, 0.0) / upper_cm) ** 0.5
    ratio = exp(-(integral(1.0 / beta) - integral(start)).real)
    return upper_cm * ratio * ratio / (beta * beta)
