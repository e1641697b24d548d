"""The compiled simulation of the pumps: drives at any time, and their derivatives; see `kernel`."""

from __future__ import annotations

from math import exp
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

TRANSIENT_LAGS = 16.0
"""So many lags after a change of its voltage a pump counts as settled: e^-16 of the change is left."""


@compiled
def next_change(time_s: Array, voltage_V: Array, pump: int, row: int) -> int:
    """The first row after this one at which the voltage of a pump changes; len(time_s) where none does."""
    n = len(time_s)
    k = row + 1
    while k < n and voltage_V[k, pump] == voltage_V[row, pump]:
        k += 1
    return k


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


class PumpStates(NamedTuple):
    """Both pumps between two steps.

    given : (2, 3) drive that arrives now, and its derivatives by dead zone and curve. at : (2, 5) lagged drive and
    its derivatives, as in `kernel.Work.drive`. upcoming : (2,) row whose voltage arrives next. calm_s : (2,) when they
    settle.
    """

    given: Array
    at: Array
    upcoming: Ints
    calm_s: Array


@compiled
def rest(theta: Array, time_s: Array, voltage_V: Array) -> PumpStates:
    """Both pumps settled at the voltages of the first row."""
    pumps = PumpStates(np.zeros((2, 3)), np.zeros((2, 5)), np.zeros(2, dtype=np.int64), np.full(2, time_s[0]))
    for i in range(2):
        given, at = pumps.given[i], pumps.at[i]
        set_input(theta, i, voltage_V[0, i], given)
        at[0], at[2], at[3] = given[0], given[1], given[2]
        pumps.upcoming[i] = next_change(time_s, voltage_V, i, 0)
    return pumps


@compiled
def take_arrived(theta: Array, time_s: Array, voltage_V: Array, now_s: float, pumps: PumpStates) -> float:
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
def follow_both(theta: Array, pumps: PumpStates, dt_s: float, drives: Array) -> None:
    """The drives (2, 3, 5) of both pumps at the start, middle and end of a step; the pumps go on to its end."""
    for i in range(2):
        lag_s, given, at, drive = theta[LAG + i], pumps.given[i], pumps.at[i], drives[i]
        follow(lag_s, given, at, 0.0, drive[0])
        follow(lag_s, given, at, 0.5 * dt_s, drive[1])
        follow(lag_s, given, at, dt_s, drive[2])
        at[:] = drive[2]
