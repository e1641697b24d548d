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

from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.core.diagnosis.glr.compiled import compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

GAIN, SPLIT, OUTLET, LAG, ZONE, BEND, DELAY, DATUM, SENSOR_GAIN, SENSOR_OFFSET, OVERFLOW, INITIAL = (
    0, 2, 4, 8, 10, 12, 14, 16, 20, 24, 28, 30,
)  # fmt: skip
"""Index of the first number of each group in the vector of parameters, the order of `parameters.PARAMETERS`; behind
them the initial levels."""

SHALLOW_CM = 4e-4
MAX_STEP_S = 0.1
MIN_STEP_S = 0.002
TRANSIENT_LAGS = 16.0
"""So many lags after a change of its voltage a pump counts as settled: e^-16 of the change is left."""


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
def set_input(theta: Array, pump: int, voltage_V: float, given: Array) -> None:
    """The drive of a pump for this voltage, and its derivatives by dead zone and curve, into given (3,)."""
    x = voltage_V - theta[ZONE + pump]
    bend = theta[BEND + pump]
    if x <= 0.0:
        given[0] = given[1] = given[2] = 0.0
    else:
        given[0] = x * (1.0 + bend * x)
        given[1] = -(1.0 + 2.0 * bend * x)
        given[2] = x * x


@compiled
def follow(lag_s: float, given: Array, at: Array, dt_s: float, out: Array) -> None:
    """The lagged drive and its derivatives (5,) after dt_s with constant input, from `at` (5,)."""
    if lag_s <= 0.0:
        out[0], out[1], out[2], out[3], out[4] = given[0], 0.0, given[1], given[2], 0.0
        return
    left = exp(-dt_s / lag_s)
    away = (at[0] - given[0]) * left
    out[0] = given[0] + away
    out[1] = at[1] * left + away * dt_s / (lag_s * lag_s)
    out[2] = given[1] + (at[2] - given[1]) * left
    out[3] = given[2] + (at[3] - given[2]) * left
    out[4] = away / lag_s


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
def next_change(time_s: Array, voltage_V: Array, pump: int, row: int) -> int:
    """The first row after this one at which the voltage of a pump changes; len(time_s) where none does."""
    n = len(time_s)
    k = row + 1
    while k < n and voltage_V[k, pump] == voltage_V[row, pump]:
        k += 1
    return k


class Pumps(NamedTuple):
    """Both pumps between two steps.

    given : (2, 3) drive that arrives now, and its derivatives by dead zone and curve. at : (2, 5) lagged drive and its
    derivatives, as in `Work.drive`. upcoming : (2,) row whose voltage arrives next. calm_s : (2,) when they settle.
    """

    given: Array
    at: Array
    upcoming: Ints
    calm_s: Array


@compiled
def rest(theta: Array, time_s: Array, voltage_V: Array) -> Pumps:
    """Both pumps settled at the voltages of the first row."""
    pumps = Pumps(np.zeros((2, 3)), np.zeros((2, 5)), np.zeros(2, dtype=np.int64), np.full(2, time_s[0]))
    for i in range(2):
        given, at = pumps.given[i], pumps.at[i]
        set_input(theta, i, voltage_V[0, i], given)
        at[0], at[2], at[3] = given[0], given[1], given[2]
        pumps.upcoming[i] = next_change(time_s, voltage_V, i, 0)
    return pumps


@compiled
def take_arrived(theta: Array, time_s: Array, voltage_V: Array, now_s: float, pumps: Pumps) -> float:
    """Let the pumps have what has arrived now; return when the next change arrives."""
    next_s = np.inf
    for i in range(2):
        row = pumps.upcoming[i]
        while row < len(time_s) and time_s[row] + theta[DELAY + i] <= now_s:
            set_input(theta, i, voltage_V[row, i], pumps.given[i])
            pumps.calm_s[i] = now_s + TRANSIENT_LAGS * theta[LAG + i]
            row = next_change(time_s, voltage_V, i, row)
        pumps.upcoming[i] = row
        if row < len(time_s):
            next_s = min(next_s, time_s[row] + theta[DELAY + i])
    return next_s


@compiled
def follow_both(theta: Array, pumps: Pumps, dt_s: float, work: Work) -> None:
    """The drives of both pumps at the start, middle and end of a step, into work; the pumps go on to its end."""
    for i in range(2):
        lag_s, given, at, drive = theta[LAG + i], pumps.given[i], pumps.at[i], work.drive[i]
        follow(lag_s, given, at, 0.0, drive[0])
        follow(lag_s, given, at, 0.5 * dt_s, drive[1])
        follow(lag_s, given, at, dt_s, drive[2])
        at[:] = drive[2]


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
    pumps: Pumps,
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
        follow_both(theta, pumps, dt_s, work)
        step(theta, geometry, level_cm, s, column, dt_s, work)


@compiled
def integrate(
    theta: Array,
    geometry: Geometry,
    time_s: Array,
    voltage_V: Array,
    initial_cm: Array,
    column: Ints,
    levels_cm: Array,
    derivatives: Array,
) -> None:
    """Simulate one record.

    theta : (30,) parameters in the order of `PARAMETERS`. time_s : (n,). voltage_V : (n, 2). initial_cm : (4,).
    column : (34,) for each parameter and initial level the column of its derivatives, -1 where they are not wanted.
    levels_cm : (n, 4), out. derivatives : (n, 4, m), out.
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
            for m in range(s.shape[1]):
                derivatives[k, i, m] = s[i, m]
