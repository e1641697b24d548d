"""Feedforward: levels and drives that lead from the present operating point to the outputs wanted, by the model.

The path is the motion of a model rig without noise, eq. (1) with the pumps' lags and delays, from the levels where it
is to the target and then at rest there. Its drives keep what the pumps allow: range and rate, for the effectiveness
that is left. So state feedback has nothing to do but to correct what the rig does otherwise, and integrals that
integrate the deviation from the path don't learn a step of the reference.

Each output is moved by its own pump as fast as that pump can, and brought to its target without overshoot:

    S_i = (r_i - h_i) A_i / (g_i k_i) - what is still under way through lag and delay      in V s
    v_i = hold_i + S_i / approach time, within range and rate

hold_i keeps output i where it is. S_i is where the output would end if the drive went back to hold_i now, so lag and
delay cause no overshoot. Once an output is there, its drive follows the tank above it, which is slower. A pump's drive
is also limited so that the tank above neither overflows nor brings more or less water than the other output can be held
with.

With gamma1 + gamma2 < 1 the outputs can't be held while the upper tanks move: the zero is not stable. There the path is
that of a model rig under optimal state feedback (LQR, with a prescribed degree of stability) without noise, which is
as fast as the zero lets it be.

The model is up to some per cent wrong. While an output is on its way, the path's level follows the level estimate
(`FOLLOW_S`), by MAX_CORRECTION of its own movement at the most: so the movement ends where the true output arrives, and
a sensor that has failed can't prolong it by more. The upper levels follow too, by MAX_UPPER_CORRECTION of theirs.

Why: docs/decisions/0037-feedforward.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import exp, inf, sqrt
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_are

from hil.core.tanks import Array, TankModel, equilibrium, level_rates, linearise, outflows, transmission_zeros
from hil.core.types import Pair, Quad

APPROACH_S = 0.7
"""Time constant with which an output comes to its target in the end."""

FOLLOW_S = 0.5
"""Time constant with which the path's lower levels follow the estimate on their way."""

MAX_CORRECTION = 0.2
"""Largest correction of the path's levels, as a share of the movement that the model expects: gain errors of a rig."""

MAX_UPPER_CORRECTION = 0.4
"""The same for the upper tanks. What they bring is part of the drive that holds an output; they differ more from the
model, most when they are nearly empty: without it, a step of -1 V overshot by 1.7 % on one rig."""

ARRIVED_CM = 0.06
"""An output that is closer to its target has arrived: its path no longer follows the estimate."""

BARRIER_S = 1.0
"""Time constant with which the level of an upper tank may come close to its limit."""

RANGE_MARGIN = 0.015
"""Share of the drive range left to the feedback at either end, but for what holding the target needs."""

ROOM_SHARE = 0.05
"""That margin is at most this share of the room between limit and holding drive: a pump near its limit needs it all."""

RATE_SHARE = 0.9
"""Share of the largest rate of the drives that the path uses."""

UPPER_MARGIN_CM = 2.0
"""The path keeps the upper levels so far below the level that trips, but for what holding the target needs."""

MIN_DECOUPLED = 0.1
"""With g1 g2 - (1 - g1)(1 - g2) above it, that is gamma1 + gamma2 > 1.1, each output has its own pump."""

LQR_WEIGHT = 0.05
"""Weight of the drives in the optimal feedback, cm^2/V^2: small enough for the zero to be what limits the speed."""

ZERO_SPEED = 2.0
"""The slowest pole of that feedback, as a multiple of the mirror image -z of an unstable zero. At 1 the squared error
of a step is the least; at 2 it is a tenth more, the outputs settle in 60 % of the time, and deviate a third more."""

MIN_LINEARISED_CM = 0.2
MAX_PERIODS = 5

UPPER_OF_PUMP = (3, 2)
"""The upper tank that pump 1 and pump 2 feed."""

LqrGain = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class PathLimits:
    """What the pumps allow, for drives of healthy pumps, and the level that trips.

    drives_V : smallest and largest drive, of pump 1 and of pump 2. rate_V_s : (2,) largest rate of the drives. lag_s,
    delay_s : (2,) of the pumps. level_max_cm : of every tank. period_s : of the control. decay : (2,) what a lag leaves
    of a gap after a period, from the others: it is needed at every step.
    """

    drives_V: tuple[Pair, Pair]
    rate_V_s: Pair
    lag_s: Pair
    level_max_cm: float
    period_s: float
    delay_s: Pair = (0.0, 0.0)
    decay: Pair = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        first, second = (exp(-self.period_s / lag_s) if lag_s > 0.0 else 0.0 for lag_s in self.lag_s)
        object.__setattr__(self, "decay", (first, second))

    def with_effectiveness(self, effectiveness: Pair) -> PathLimits:
        """The limits in effective drives, for pumps that have lost gain."""
        (t1, t2), ((a1, b1), (a2, b2)), (r1, r2) = effectiveness, self.drives_V, self.rate_V_s
        return replace(self, drives_V=((t1 * a1, t1 * b1), (t2 * a2, t2 * b2)), rate_V_s=(t1 * r1, t2 * r2))

    def ranges_beside(self, feedback_V: Pair) -> tuple[Pair, Pair]:
        """What is left to the path of the drives' ranges, while feedback adds feedback_V (2,), effective."""
        (f1, f2), ((a1, b1), (a2, b2)) = feedback_V, self.drives_V
        return (a1 - f1, b1 - f1), (a2 - f2, b2 - f2)


@dataclass(frozen=True, slots=True)
class Target:
    """Where a path leads: what holds the lower levels wanted, by the model.

    level_cm : (4,) at rest. drive_V : (2,) effective drives that hold them. outflow_cm3_s : (2,) of the lower tanks at
    rest. gain : (2, 4) LQR gain in V/cm where the outputs can't be moved each by its own pump, otherwise None.
    """

    level_cm: Quad
    drive_V: Pair
    outflow_cm3_s: Pair
    gain: LqrGain | None = None


class FeedforwardPath(NamedTuple):
    """Where the path is at one step.

    level_cm : (4,). flow_V : (2,) effective drives after the lag. drive_V : (2,) effective drives from this step on.
    under_way : effective drives of earlier periods that have not arrived yet, the oldest first, for each pump.
    """

    level_cm: Quad
    flow_V: Pair
    drive_V: Pair
    under_way: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())


def is_decoupled(model: TankModel) -> bool:
    """Whether each output can be moved and held by its own pump: the zeros are stable, and not close to 0."""
    (g1, g2), (part3, part4) = model.valve_split, model.arriving
    return g1 * g2 - part3 * part4 * (1.0 - g1) * (1.0 - g2) >= MIN_DECOUPLED


def target_of(model: TankModel, drive_V: Pair) -> Target:
    """The target that these effective drives (2,) hold."""
    held_V = max(drive_V[0], 0.0), max(drive_V[1], 0.0)
    levels = equilibrium(model, held_V)
    return target_at(model, levels, held_V, coupled_gain(model, levels))


def target_at(model: TankModel, level_cm: Quad, drive_V: Pair, gain: LqrGain | None) -> Target:
    """The target at these levels (4,), which the effective drives (2,) hold."""
    (a1, a2, _, _), (h1, h2, _, _), (d1, d2, _, _) = model.outlet_cm2, level_cm, model.datum_cm
    squared = 2.0 * model.gravity_cm_s2
    return Target(level_cm, drive_V, (a1 * sqrt(squared * (h1 + d1)), a2 * sqrt(squared * (h2 + d2))), gain)


def at_rest(target: Target, limits: PathLimits) -> FeedforwardPath:
    """The path when it has arrived."""
    return _path(target.level_cm, target.drive_V, limits)


def taken_over(level_cm: Quad, drive_V: Pair, limits: PathLimits) -> FeedforwardPath:
    """A path that begins at these levels (4,), with pumps that run at these effective drives (2,)."""
    return _path(level_cm, drive_V, limits)


def _path(level_cm: Quad, drive_V: Pair, limits: PathLimits) -> FeedforwardPath:
    first, second = (round(delay_s / limits.period_s) for delay_s in limits.delay_s)
    return FeedforwardPath(level_cm, drive_V, drive_V, ((drive_V[0],) * first, (drive_V[1],) * second))


def advance(
    model: TankModel,
    limits: PathLimits,
    path: FeedforwardPath,
    target: Target,
    estimate_cm: Quad | None,
    rate_cm_s: Pair = (0.0, 0.0),
    periods: int = 1,
    feedback_V: Pair = (0.0, 0.0),
) -> FeedforwardPath:
    """The path at the next step, with the drives from then on.

    limits : in effective drives. estimate_cm : (4,) level estimate at the next step, None if the path is not to follow
    it. rate_cm_s : (2,) at which the target's lower levels move. periods : of the control since the last step.
    feedback_V : (2,) effective drives that feedback adds.
    """
    for _ in range(min(max(periods, 0), MAX_PERIODS)):
        path = moved(model, limits, path)
    if estimate_cm is not None:
        path = _following(model, limits, path, target, estimate_cm)
    wanted_V = _wanted(model, limits, path, target, rate_cm_s)
    drive_V = _limited(model, limits, limits.ranges_beside(feedback_V), path, target, wanted_V)
    return FeedforwardPath(path.level_cm, path.flow_V, drive_V, path.under_way)


def moved(model: TankModel, limits: PathLimits, path: FeedforwardPath) -> FeedforwardPath:
    """The model rig one period later: Heun's rule, with the mean of the lagged drives."""
    dt, h, (lag1, lag2), (flow1, flow2) = limits.period_s, path.level_cm, limits.lag_s, path.flow_V
    arriving1, queue1 = _arriving(path, 0)
    arriving2, queue2 = _arriving(path, 1)
    (decay1, decay2), gap1, gap2 = limits.decay, flow1 - arriving1, flow2 - arriving2
    flow1, mean1 = arriving1 + gap1 * decay1, arriving1 + gap1 * (1.0 - decay1) * lag1 / dt
    flow2, mean2 = arriving2 + gap2 * decay2, arriving2 + gap2 * (1.0 - decay2) * lag2 / dt
    drive = (mean1, mean2)
    first = level_rates(model, h, drive)
    second = level_rates(model, _shifted(model, h, first, dt), drive)
    (a1, a2, a3, a4), (b1, b2, b3, b4) = first, second
    mean = (0.5 * (a1 + b1), 0.5 * (a2 + b2), 0.5 * (a3 + b3), 0.5 * (a4 + b4))
    return FeedforwardPath(_shifted(model, h, mean, dt), (flow1, flow2), path.drive_V, (queue1, queue2))


def _arriving(path: FeedforwardPath, pump: int) -> tuple[float, tuple[float, ...]]:
    """The drive of a pump that arrives in the next period, and those that are under way after it."""
    waiting = path.under_way[pump]
    return (waiting[0], (*waiting[1:], path.drive_V[pump])) if waiting else (path.drive_V[pump], ())


def _shifted(model: TankModel, level_cm: Quad, rate_cm_s: Quad, dt: float) -> Quad:
    (h1, h2, h3, h4), (r1, r2, r3, r4), (t1, t2, t3, t4) = level_cm, rate_cm_s, model.height_cm
    h1, h2, h3, h4 = h1 + dt * r1, h2 + dt * r2, h3 + dt * r3, h4 + dt * r4
    return (
        0.0 if h1 < 0.0 else t1 if h1 > t1 else h1,
        0.0 if h2 < 0.0 else t2 if h2 > t2 else h2,
        0.0 if h3 < 0.0 else t3 if h3 > t3 else h3,
        0.0 if h4 < 0.0 else t4 if h4 > t4 else h4,
    )


def _following(
    model: TankModel, limits: PathLimits, path: FeedforwardPath, target: Target, estimate_cm: Quad
) -> FeedforwardPath:
    """The path with levels that follow the estimate: an output until it has arrived, an upper tank while it moves.

    Where the outputs can't be moved each by its own pump, the upper levels stay as they are.
    """
    levels, wanted_cm = list(path.level_cm), target.level_cm
    if abs(wanted_cm[0] - levels[0]) <= ARRIVED_CM and abs(wanted_cm[1] - levels[1]) <= ARRIVED_CM:
        return path
    share = min(limits.period_s / FOLLOW_S, 1.0)
    rates = level_rates(model, path.level_cm, path.flow_V)
    for tank in (0, 1) if target.gain is not None else (0, 1, 2, 3):
        if tank > 1 or abs(wanted_cm[tank] - levels[tank]) > ARRIVED_CM:
            most = (MAX_CORRECTION if tank < 2 else MAX_UPPER_CORRECTION) * abs(rates[tank]) * limits.period_s
            levels[tank] += min(max(share * (estimate_cm[tank] - levels[tank]), -most), most)
    return path._replace(level_cm=(levels[0], levels[1], levels[2], levels[3]))


def _wanted(model: TankModel, limits: PathLimits, path: FeedforwardPath, target: Target, rate_cm_s: Pair) -> Pair:
    """(2,) effective drives for the next period, before all limits."""
    if target.gain is None:
        return _decoupled(model, limits, path, target, rate_cm_s)
    x = [h - rest for h, rest in zip(path.level_cm, target.level_cm, strict=True)]
    first, second = (sum(k * value for k, value in zip(row, x, strict=True)) for row in target.gain)
    return target.drive_V[0] - first, target.drive_V[1] - second


def _decoupled(model: TankModel, limits: PathLimits, path: FeedforwardPath, target: Target, rate_cm_s: Pair) -> Pair:
    level_cm, flow_V, under_way = path.level_cm, path.flow_V, path.under_way
    out, approach_s = outflows(model, level_cm, flow_V), max(APPROACH_S, limits.period_s)
    wanted = []
    for i in (0, 1):
        effect, area = model.valve_split[i] * model.pump_gain_cm3_Vs[i], model.area_cm2[i]
        hold = (out[i] - model.arriving[i] * out[i + 2] + area * rate_cm_s[i]) / effect
        ahead = (target.level_cm[i] - level_cm[i]) * area / effect
        ahead -= limits.lag_s[i] * (flow_V[i] - hold)
        if under_way[i]:
            ahead -= limits.period_s * sum(drive - hold for drive in under_way[i])
        wanted.append(hold + ahead / approach_s)
    return wanted[0], wanted[1]


def _limited(
    model: TankModel,
    limits: PathLimits,
    ranges_V: tuple[Pair, Pair],
    path: FeedforwardPath,
    target: Target,
    wanted_V: Pair,
) -> Pair:
    """(2,) the drives within range, rate, and what the tanks above may take."""
    (low1, high1), (low2, high2) = ranges_V
    margins = (RANGE_MARGIN * (high1 - low1), RANGE_MARGIN * (high2 - low2))
    drives = []
    for pump in (0, 1):
        (low, high), margin, held = ranges_V[pump], margins[pump], target.drive_V[pump]
        room_below = ROOM_SHARE * (held - low if held > low else 0.0)
        room_above = ROOM_SHARE * (high - held if high > held else 0.0)
        least = low + (margin if margin < room_below else room_below)
        most = high - (margin if margin < room_above else room_above)
        floor, ceiling = _upper_bounds(model, limits, ranges_V, margins, path, target, pump)
        step, before = RATE_SHARE * limits.rate_V_s[pump] * limits.period_s, path.drive_V[pump]
        drive = min(max(wanted_V[pump], floor), ceiling)
        drive = min(max(drive, before - step), before + step)
        drives.append(min(max(drive, least), most))
    return drives[0], drives[1]


def _upper_bounds(
    model: TankModel,
    limits: PathLimits,
    ranges_V: tuple[Pair, Pair],
    margins: Pair,
    path: FeedforwardPath,
    target: Target,
    pump: int,
) -> Pair:
    """Smallest and largest drive of a pump for the tank above, so that the output below it can be held at its target.

    The output below needs hold = (outflow - what arrives from above) / effect of its own pump, within its range.
    """
    upper, below = UPPER_OF_PUMP[pump], 1 - pump
    area, datum, per_root = model.area_cm2[upper], model.datum_cm[upper], model.outlet_flow[upper]
    per_drive = (1.0 - model.valve_split[pump]) * model.pump_gain_cm3_Vs[pump]
    if per_drive <= 0.0:
        return -inf, inf
    level, rest = path.level_cm[upper], target.level_cm[upper]
    highest, lowest = max(limits.level_max_cm - UPPER_MARGIN_CM, rest), 0.0
    arriving = model.arriving[upper - 2]
    if target.gain is None and arriving > 0.0:
        (low, high), margin, out_below = ranges_V[below], margins[below], target.outflow_cm3_s[below]
        own_effect = model.valve_split[below] * model.pump_gain_cm3_Vs[below]
        most_out = max((out_below - own_effect * (low + margin)) / arriving, 0.0)
        highest = min(highest, max((most_out / per_root) ** 2 - datum, rest))
        if target.drive_V[below] < high - margin:  # a pump that is dead or too weak can't hold its output anyway
            least_out = max((out_below - own_effect * (high - margin)) / arriving, 0.0)
            lowest = min(max((least_out / per_root) ** 2 - datum, 0.0), rest)
    head = level + datum
    out = per_root * sqrt(head) if head > 0.0 else 0.0
    ceiling = (out + area * (highest - level) / BARRIER_S) / per_drive
    floor = (out + area * (lowest - level) / BARRIER_S) / per_drive
    floor = min(floor, target.drive_V[pump])  # the tank above never has this pump give more than at rest
    return floor, max(ceiling, floor)


def coupled_gain(model: TankModel, level_cm: Quad) -> LqrGain | None:
    """LQR gain (2, 4), V/cm, at these levels (4,), for the lower levels' squared errors.

    None where each output can be moved by its own pump.
    """
    if is_decoupled(model):
        return None
    h1, h2, h3, h4 = (max(h, MIN_LINEARISED_CM) for h in level_cm)
    linear = linearise(model, (h1, h2, h3, h4))
    Q = np.diag([1.0, 1.0, 0.0, 0.0])
    zero = max(float(transmission_zeros(linear).max()), 0.0)
    hurried = linear.A + 0.5 * (ZERO_SPEED - 1.0) * zero * np.eye(4)
    P: Array = solve_continuous_are(hurried, linear.B, Q, LQR_WEIGHT * np.eye(2))
    first, second = (linear.B.T @ P / LQR_WEIGHT).tolist()
    return tuple(first), tuple(second)
