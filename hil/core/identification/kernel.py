"""The compiled simulation: levels, and their derivatives by parameters and initial levels, from the voltages.

Model. With x = max(0, v - dead zone) each pump has the drive u = x (1 + curve x), which arrives after its delay and is
followed with its lag, lag w' = u - w. The tanks are those of `hil.core.tanks`, eq. (1), with rims: a level ends at
its tank's height; a share of what flows over the rim of tank 3 or 4 falls into the tank below.

Derivatives. The variational equations S' = (df/dh) S + df/dp are integrated together with the levels by the same
Runge-Kutta steps, so that S is the derivative of the computed levels, not of a continuous ideal. Voltages are constant
between two rows, so the lags are solved exactly, with their derivatives; by the delay the derivative is minus the slope
of w. A step never crosses a time at which an input changes.

Empty tanks and rims. Within a step the outlets follow the square root even below zero level. After the step what an
empty tank did not have is taken back from the tank below, what is above a rim is cut off, and S changes in the same
way. So the computed levels are continuous in every parameter. Below `SHALLOW_CM` of head the square root is replaced by
the parabola with the same value and slope there: its slope stays finite, and a step stays stable.

Before the first row the voltages are taken to be those of the first row, for long enough for pumps and hoses.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.core.diagnosis.glr.compiled import compiled
from hil.core.identification.pump_kernel import (
    DATUM,
    GAIN,
    INITIAL,
    LAG,
    OUTLET,
    OVERFLOW,
    SPLIT,
    PumpStates,
    follow_both,
    rest,
    take_arrived,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SHALLOW_CM = 4e-4
MAX_STEP_S = 0.1
MIN_STEP_S = 0.002


class Geometry(NamedTuple):
    """What is known of the tanks: (4,) areas and heights, sqrt(2 g), (2,) shares of what arrives from tanks 3, 4."""

    area_cm2: Array
    height_cm: Array
    speed: float
    arriving: Array


class Work(NamedTuple):
    """Memory for one step.

    drive : (2, 3, 5) of each pump at the start, middle and end of the step: w, and its derivatives by lag, dead zone,
    curve and delay. flow, slope : (4,) outflow over the tank's own area, and its derivative by the level. rate, stage,
    total : (4,) of the levels. s_rate, s_stage, s_total : (4, m) of their derivatives.
    """

    drive: Array
    flow: Array
    slope: Array
    rate: Array
    stage: Array
    total: Array
    s_rate: Array
    s_stage: Array
    s_total: Array


@compiled
def new_work(columns: int) -> Work:
    """Memory for a step with so many columns of derivatives."""
    return Work(
        np.zeros((2, 3, 5)),
        np.zeros(4),
        np.zeros(4),
        np.zeros(4),
        np.zeros(4),
        np.zeros(4),
        np.zeros((4, columns)),
        np.zeros((4, columns)),
        np.zeros((4, columns)),
    )


@compiled
def set_outflows(theta: Array, geometry: Geometry, level_cm: Array, work: Work) -> None:
    """Outflow of each tank over its own area, cm/s, and its derivative by the level, into work."""
    for i in range(4):
        c = theta[OUTLET + i] * geometry.speed / geometry.area_cm2[i]
        head = level_cm[i] + theta[DATUM + i]
        if head >= SHALLOW_CM:
            root = sqrt(head)
            work.flow[i] = c * root
            work.slope[i] = 0.5 * c / root
        elif head > 0.0:
            root = sqrt(SHALLOW_CM)
            z = head / SHALLOW_CM
            work.flow[i] = 0.5 * c * root * z * (3.0 - z)
            work.slope[i] = 0.5 * c / root * (3.0 - 2.0 * z)
        else:
            work.flow[i] = work.slope[i] = 0.0


@compiled
def set_rates(theta: Array, geometry: Geometry, level_cm: Array, s: Array, column: Ints, at: int, work: Work) -> None:
    """dh/dt and dS/dt at these levels (4,) and derivatives (4, m). at : 0 start, 1 middle, 2 end of the step."""
    set_outflows(theta, geometry, level_cm, work)
    A, flow, slope, rate, s_rate = geometry.area_cm2, work.flow, work.slope, work.rate, work.s_rate
    for i in range(2):
        gain, split, w = theta[GAIN + i], theta[SPLIT + i], work.drive[i, at, 0]
        below, upper = geometry.arriving[i] * A[2 + i] / A[i], 2 + i
        rate[i] = below * flow[upper] - flow[i] + split * gain * w / A[i]
        across = 3 - i
        rate[across] = (1.0 - split) * gain * w / A[across] - flow[across]
        from_above, from_own, from_upper = below * slope[upper], -slope[i], -slope[upper]
        for m in range(s.shape[1]):
            s_rate[i, m] = from_above * s[upper, m] + from_own * s[i, m]
            s_rate[upper, m] = from_upper * s[upper, m]
    if s.shape[1] > 0:
        add_pumps(theta, geometry, column, at, work)
        add_outlets(theta, geometry, column, work)


@compiled
def add_pumps(theta: Array, geometry: Geometry, column: Ints, at: int, work: Work) -> None:
    """Add the direct derivatives of dh/dt by the parameters of both pumps."""
    A, s_rate = geometry.area_cm2, work.s_rate
    for i in range(2):
        across = 3 - i
        gain, split, w = theta[GAIN + i], theta[SPLIT + i], work.drive[i, at, 0]
        m = column[GAIN + i]
        if m >= 0:
            s_rate[i, m] += split * w / A[i]
            s_rate[across, m] += (1.0 - split) * w / A[across]
        m = column[SPLIT + i]
        if m >= 0:
            s_rate[i, m] += gain * w / A[i]
            s_rate[across, m] -= gain * w / A[across]
        for kind in range(4):
            m = column[LAG + 2 * kind + i]
            if m >= 0:
                by = gain * work.drive[i, at, 1 + kind]
                s_rate[i, m] += split * by / A[i]
                s_rate[across, m] += (1.0 - split) * by / A[across]


@compiled
def add_outlets(theta: Array, geometry: Geometry, column: Ints, work: Work) -> None:
    """Add the direct derivatives of dh/dt by outlets and datums."""
    A, s_rate = geometry.area_cm2, work.s_rate
    for i in range(4):
        for code, by in ((OUTLET + i, work.flow[i] / theta[OUTLET + i]), (DATUM + i, work.slope[i])):
            m = column[code]
            if m >= 0:
                s_rate[i, m] -= by
                if i >= 2:
                    s_rate[i - 2, m] += geometry.arriving[i - 2] * A[i] / A[i - 2] * by


@compiled
def add_stage(level_cm: Array, s: Array, weight: float, ahead_s: float, work: Work) -> None:
    """Add the rates with this weight to the totals, and set the next stage ahead_s on from the start of the step."""
    s_total, s_stage, s_rate = work.s_total, work.s_stage, work.s_rate
    for i in range(4):
        work.total[i] += weight * work.rate[i]
        work.stage[i] = level_cm[i] + ahead_s * work.rate[i]
        for m in range(s.shape[1]):
            s_total[i, m] += weight * s_rate[i, m]
            s_stage[i, m] = s[i, m] + ahead_s * s_rate[i, m]


@compiled
def step(theta: Array, geometry: Geometry, level_cm: Array, s: Array, column: Ints, dt_s: float, work: Work) -> None:
    """One Runge-Kutta step of levels and derivatives, in place; the drives are in work."""
    for i in range(4):
        work.total[i] = 0.0
        for m in range(s.shape[1]):
            work.s_total[i, m] = 0.0
    set_rates(theta, geometry, level_cm, s, column, 0, work)
    add_stage(level_cm, s, 1.0, 0.5 * dt_s, work)
    set_rates(theta, geometry, work.stage, work.s_stage, column, 1, work)
    add_stage(level_cm, s, 2.0, 0.5 * dt_s, work)
    set_rates(theta, geometry, work.stage, work.s_stage, column, 1, work)
    add_stage(level_cm, s, 2.0, dt_s, work)
    set_rates(theta, geometry, work.stage, work.s_stage, column, 2, work)
    add_stage(level_cm, s, 1.0, 0.0, work)
    sixth_s = dt_s / 6.0
    for i in range(4):
        level_cm[i] += sixth_s * work.total[i]
        for m in range(s.shape[1]):
            s[i, m] += sixth_s * work.s_total[i, m]
    bound(theta, geometry, level_cm, s, column)


@compiled
def bound(theta: Array, geometry: Geometry, level_cm: Array, s: Array, column: Ints) -> None:
    """Keep the levels within 0 .. height, the derivatives with them: upper tanks first, then lower ones."""
    A = geometry.area_cm2
    for i in range(2, 4):
        top_cm, lower, ratio = geometry.height_cm[i], i - 2, A[i] / A[i - 2]
        if level_cm[i] < 0.0:
            share, end_cm = geometry.arriving[lower] * ratio, 0.0
        elif level_cm[i] > top_cm:
            share, end_cm = theta[OVERFLOW + lower] * ratio, top_cm
        else:
            continue
        beyond_cm = level_cm[i] - end_cm
        level_cm[lower] += share * beyond_cm
        level_cm[i] = end_cm
        for m in range(s.shape[1]):
            s[lower, m] += share * s[i, m]
            s[i, m] = 0.0
        if beyond_cm > 0.0 and column[OVERFLOW + lower] >= 0:
            s[lower, column[OVERFLOW + lower]] += ratio * beyond_cm
    for i in range(2):
        if level_cm[i] < 0.0 or level_cm[i] > geometry.height_cm[i]:
            level_cm[i] = min(max(level_cm[i], 0.0), geometry.height_cm[i])
            for m in range(s.shape[1]):
                s[i, m] = 0.0


@compiled
def longest_step(theta: Array, geometry: Geometry) -> float:
    """The longest step, in s, that is stable for nearly empty tanks."""
    quickest = 1e-9
    for i in range(4):
        quickest = max(quickest, theta[OUTLET + i] * geometry.speed / geometry.area_cm2[i])
    return min(MAX_STEP_S, sqrt(SHALLOW_CM) / quickest)


@compiled
def advance(
    theta: Array,
    geometry: Geometry,
    pumps: PumpStates,
    level_cm: Array,
    s: Array,
    column: Ints,
    now_s: float,
    until_s: float,
    limit_s: float,
    work: Work,
) -> None:
    """Levels and derivatives from now_s to until_s, between which no input changes."""
    for i in range(2):
        if now_s < pumps.calm_s[i] and theta[LAG + i] > 0.0:
            limit_s = min(limit_s, max(0.5 * theta[LAG + i], MIN_STEP_S))
    count = max(int(np.ceil((until_s - now_s) / limit_s - 1e-9)), 1)
    dt_s = (until_s - now_s) / count
    for _ in range(count):
        follow_both(theta, pumps, dt_s, work.drive)
        step(theta, geometry, level_cm, s, column, dt_s, work)


@compiled
def integrate(
    theta: Array,
    geometry: Geometry,
    time_s: Array,
    voltage_V: Array,
    initial_cm: Array,
    column: Ints,
    slot: Ints,
    levels_cm: Array,
    derivatives: Array,
) -> None:
    """Simulate one record.

    theta : (30,) parameters in the order of `PARAMETERS`. time_s : (n,). voltage_V : (n, 2). initial_cm : (4,).
    column : (34,) for each parameter and initial level the column of its derivatives, -1 where they are not wanted.
    slot : (n,) place of a row in the derivatives, -1 where they are not wanted. levels_cm : (n, 4), out. derivatives :
    (r, 4, m), out.
    """
    work = new_work(derivatives.shape[2])
    level_cm, s = initial_cm.copy(), np.zeros((4, derivatives.shape[2]))
    for i in range(4):
        if column[INITIAL + i] >= 0:
            s[i, column[INITIAL + i]] = 1.0
    pumps = rest(theta, time_s, voltage_V)
    limit_s = longest_step(theta, geometry)
    now_s = time_s[0]
    for k in range(len(time_s)):
        while now_s < time_s[k]:
            until_s = min(time_s[k], take_arrived(theta, time_s, voltage_V, now_s, pumps))
            advance(theta, geometry, pumps, level_cm, s, column, now_s, until_s, limit_s, work)
            now_s = until_s
        for i in range(4):
            levels_cm[k, i] = level_cm[i]
            if slot[k] >= 0:
                for m in range(s.shape[1]):
                    derivatives[slot[k], i, m] = s[i, m]
