"""The filter that all diagnosis rests on: an extended Kalman filter of the four tanks.

State, N = 26 numbers (the constants below say where each stands):

    h   4  levels, cm                        k    2  pump gains over the rig file's, 1 when nominal
    p   2  voltages behind the pump lag, V   g    2  valve splits, likewise
    tau 2  pump lags, likewise               a    4  outlet areas, likewise
    leak 2  tanks 3, 4: what leaves to the floor over what the outlet passes on
    b   4  sensor biases, V                  d    4  sensor drifts, V/s

Parameters walk slowly about where they are. Leaks, biases and drifts have no variance, and so stay 0, until a fault
hypothesis gives them some; a leak of tank 1 or 2 is a wider outlet, by the very same equations.

A reading is the mean over the readings of one control period, so it is (w) of the way from the last step's level to
this one's. All matrices are dense and small; only six rows of the transition matrix differ from the identity's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from hil.core.tanks import TankModel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
F = TypeVar("F", bound=Callable[..., Any])

N = 26
LEVEL, PUMP, GAIN, SPLIT, LAG, OUTLET, LEAK, BIAS, DRIFT = 0, 4, 6, 8, 10, 12, 16, 18, 22

MOVING = 6
"""Levels and lagged voltages: the states whose rows of the transition matrix are not the identity's."""

NO_READING_V2 = 1e6
"""Variance of a reading that isn't there."""

LARGEST_SQUARE, LARGEST_SCALE = 9.0, 25.0
"""One innovation counts for no more than three standard deviations where noise is learned; how much it may learn."""

MISFIT_SLACK, MISFIT_MOST = 2.0, 15.0
"""What a step's readings may be off before it counts, and may count for at the most: one odd step says nothing."""

FIT_STEPS = 5
"""Between two steps kept as those at which a replay fits: what has just begun doesn't show in a step or two."""

LEAST_OUTLET = -0.02
"""What is estimated of an outlet that is shut may err to either side of nothing; cut off there it would look open."""

SHALLOW_CM = 0.05
"""Below this level sqrt(h) is not linearised any more."""


def compiled(function: F) -> F:
    """Compile with numba, keeping the result on disk for the next process where there is a place for it.

    numba looks for changes in the file of the function alone: what is compiled into another stands in the same file.
    """
    try:
        return cast(F, numba.njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # no folder that can be written to
        return cast(F, numba.njit(error_model="numpy")(function))


def constants(model: TankModel, lag_s: float) -> Array:
    """The rig file's numbers as the compiled filter wants them, (16,)."""
    speed = float(np.sqrt(2.0 * model.gravity_cm_s2))
    outlets = [a * speed for a in model.outlet_cm2]
    return np.array(
        [
            *model.area_cm2,
            *outlets,
            *model.pump_gain_cm3_Vs,
            *model.valve_split,
            max(lag_s, 1e-3),
            model.level_gain_V_cm,
            model.height_cm,
            0.0,
        ]
    )


@compiled
def predict(c: Array, x: Array, v: Array, dt: float, A: Array) -> None:
    """Move x (N,) on by dt with the pumps at v (2,) V; write the six rows of the transition matrix to A (6, N)."""
    A[:, :] = 0.0
    area1, area2, area3, area4 = c[0], c[1], c[2], c[3]
    mean = np.empty(2)
    mean_by_p = np.empty(2)
    mean_by_lag = np.empty(2)
    for j in range(2):
        tau = c[12] * x[LAG + j]
        decay = np.exp(-dt / tau)
        share = (1.0 - decay) * tau / dt
        gap = x[PUMP + j] - v[j]
        mean[j] = v[j] + gap * share
        mean_by_p[j] = share
        mean_by_lag[j] = gap * c[12] * ((1.0 - decay) / dt - decay / tau)
        x[PUMP + j] = v[j] + gap * decay
        A[PUMP + j, PUMP + j] = decay
        A[PUMP + j, LAG + j] = gap * decay * dt / (tau * tau) * c[12]
    out = np.empty(4)
    slope = np.empty(4)
    for i in range(4):
        h = max(x[LEVEL + i], 0.0)
        out[i] = c[4 + i] * np.sqrt(h)
        slope[i] = 0.5 * c[4 + i] / np.sqrt(max(h, SHALLOW_CM))
    # flows, cm3/s, at the middle of the step for the levels, at its start for the derivatives
    q1, q2 = c[8] * x[GAIN] * mean[0], c[9] * x[GAIN + 1] * mean[1]
    g1, g2 = c[10] * x[SPLIT], c[11] * x[SPLIT + 1]
    rate = np.empty(4)
    half = np.empty(4)
    for turn in range(2):
        o1, o2, o3, o4 = x[OUTLET] * out[0], x[OUTLET + 1] * out[1], x[OUTLET + 2] * out[2], x[OUTLET + 3] * out[3]
        rate[0] = (o3 - o1 + g1 * q1) / area1
        rate[1] = (o4 - o2 + g2 * q2) / area2
        rate[2] = ((1.0 - g2) * q2 - o3 - x[LEAK] * out[2]) / area3
        rate[3] = ((1.0 - g1) * q1 - o4 - x[LEAK + 1] * out[3]) / area4
        if turn == 0:
            _flow_rows(c, x, dt, A, out, slope, mean, mean_by_p, mean_by_lag)
            for i in range(4):
                half[i] = max(x[LEVEL + i] + 0.5 * dt * rate[i], 0.0)
                out[i] = c[4 + i] * np.sqrt(half[i])
    for i in range(4):
        x[LEVEL + i] = min(max(x[LEVEL + i] + dt * rate[i], 0.0), c[14])
        x[BIAS + i] += dt * x[DRIFT + i]


@compiled
def _flow_rows(
    c: Array,
    x: Array,
    dt: float,
    A: Array,
    out: Array,
    slope: Array,
    mean: Array,
    mean_by_p: Array,
    mean_by_lag: Array,
) -> None:
    """Rows of the four levels: 1 + dt d(rate)/dx."""
    for i in range(4):
        over = dt / c[i]
        own = x[OUTLET + i] + (x[LEAK + i - 2] if i >= 2 else 0.0)
        A[i, i] = 1.0 - over * own * slope[i]
        A[i, OUTLET + i] = -over * out[i]
    for lower in range(2):
        upper = lower + 2
        over = dt / c[lower]
        A[lower, upper] = over * x[OUTLET + upper] * slope[upper]
        A[lower, OUTLET + upper] = over * out[upper]
        A[upper, LEAK + lower] = -dt / c[upper] * out[upper]
    for j in range(2):
        split = c[10 + j] * x[SPLIT + j]
        far = 3 - j
        for i, share, sign in ((j, split, 1.0), (far, 1.0 - split, -1.0)):
            flow = dt / c[i] * c[8 + j]
            A[i, PUMP + j] = flow * share * x[GAIN + j] * mean_by_p[j]
            A[i, LAG + j] = flow * share * x[GAIN + j] * mean_by_lag[j]
            A[i, GAIN + j] = flow * share * mean[j]
            A[i, SPLIT + j] = sign * flow * c[10 + j] * x[GAIN + j] * mean[j]


@compiled
def step(
    c: Array,
    walk: Array,
    x: Array,
    P: Array,
    entry: Array,
    A: Array,
    K: Array,
    white: Array,
    innovation: Array,
) -> float:
    """One control period, in place; the log-likelihood of the readings.

    c : (16,) `constants`. walk : (N,) variance that each state gains in a period. x : (N,). P : (N, N).
    entry : (12,) of the history: v (2) V, y (4) V (NaN: no reading), r (4) V^2, dt s, w.
    Written: A (6, N), K (N, 4), white (4, 4) lower triangular with white S white' = I, innovation (4,) V.
    """
    dt, w, gain = entry[10], entry[11], c[13]
    before = x[LEVEL : LEVEL + 4].copy()
    bias_before = x[BIAS : BIAS + 4].copy()
    predict(c, x, entry[0:2], dt, A)
    AP = np.zeros((MOVING, N))
    for i in range(MOVING):
        for m in range(N):
            value = A[i, m]
            if value != 0.0:
                for j in range(N):
                    AP[i, j] += value * P[m, j]
    # readings against the state before the step: B (4, N), BP = B P
    BP = np.empty((4, N))
    B = np.zeros((4, N))
    for i in range(4):
        for j in range(N):
            BP[i, j] = gain * ((1.0 - w) * P[i, j] + w * AP[i, j]) + P[BIAS + i, j] + w * dt * P[DRIFT + i, j]
            B[i, j] = gain * w * A[i, j]
        B[i, i] += gain * (1.0 - w)
        B[i, BIAS + i] += 1.0
        B[i, DRIFT + i] += w * dt
    S = np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            value = 0.0
            for m in range(N):
                value += BP[i, m] * B[j, m]
            S[i, j] = value
    log_det, square = 0.0, 0.0
    for i in range(4):
        y = entry[2 + i]
        if np.isfinite(y):
            expected = gain * (before[i] + w * (x[i] - before[i])) + bias_before[i] + w * (x[BIAS + i] - bias_before[i])
            innovation[i] = y - expected
            S[i, i] += entry[6 + i] + gain * gain * walk[i]
        else:
            innovation[i] = 0.0
            S[i, i] += NO_READING_V2
    _whitener(S, white)
    for i in range(4):
        value = 0.0
        for j in range(i + 1):
            value += white[i, j] * innovation[j]
        square += value * value
        log_det -= 2.0 * np.log(white[i, i])
    # cross covariance of the predicted state with the readings, (N, 4)
    X = np.empty((N, 4))
    for i in range(4):
        for j in range(N):
            X[j, i] = BP[i, j]
        for m in range(MOVING):
            value = 0.0
            for j in range(N):
                value += A[m, j] * BP[i, j]
            X[m, i] = value
        for m in range(4):
            X[BIAS + m, i] += dt * BP[i, DRIFT + m]
        X[i, i] += gain * walk[i]
    for j in range(N):
        t = np.zeros(4)
        for i in range(4):
            for m in range(i + 1):
                t[i] += white[i, m] * X[j, m]
        for i in range(4):
            value = 0.0
            for m in range(i, 4):
                value += white[m, i] * t[m]
            K[j, i] = value
    _move_covariance(P, A, AP, walk, dt)
    for i in range(N):
        for j in range(i + 1):
            value = P[i, j] - (K[i, 0] * X[j, 0] + K[i, 1] * X[j, 1] + K[i, 2] * X[j, 2] + K[i, 3] * X[j, 3])
            P[i, j] = value
            P[j, i] = value
        x[i] += K[i, 0] * innovation[0] + K[i, 1] * innovation[1] + K[i, 2] * innovation[2] + K[i, 3] * innovation[3]
    for i in range(4):
        x[i] = min(max(x[i], 0.0), c[14])
        x[OUTLET + i] = max(x[OUTLET + i], LEAST_OUTLET)
    for j in range(2):
        x[LAG + j] = min(max(x[LAG + j], 0.05), 20.0)
        x[SPLIT + j] = min(max(x[SPLIT + j], 0.01), 0.99 / c[10 + j])
    return -0.5 * (log_det + square)


@compiled
def _move_covariance(P: Array, A: Array, AP: Array, walk: Array, dt: float) -> None:
    """P <- F P F' + Q for the transition whose top rows are A and in which biases follow drifts."""
    top = np.empty((MOVING, MOVING))
    for i in range(MOVING):
        for j in range(MOVING):
            value = 0.0
            for m in range(N):
                value += AP[i, m] * A[j, m]
            top[i, j] = value
    for i in range(MOVING):
        for j in range(MOVING, N):
            P[i, j] = AP[i, j]
            P[j, i] = AP[i, j]
        for j in range(MOVING):
            P[i, j] = top[i, j]
    for i in range(4):
        if P[DRIFT + i, DRIFT + i] > 0.0:
            for j in range(N):
                P[BIAS + i, j] += dt * P[DRIFT + i, j]
            for j in range(N):
                P[j, BIAS + i] += dt * P[j, DRIFT + i]
    for i in range(N):
        P[i, i] += walk[i]


@compiled
def _whitener(S: Array, white: Array) -> None:
    """Inverse of the Cholesky factor of S (4, 4), lower triangular."""
    L = np.zeros((4, 4))
    for i in range(4):
        for j in range(i + 1):
            value = S[i, j]
            for m in range(j):
                value -= L[i, m] * L[j, m]
            if i == j:
                L[i, i] = np.sqrt(max(value, 1e-12))
            else:
                L[i, j] = value / L[j, j]
    white[:, :] = 0.0
    for j in range(4):
        white[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, 4):
            value = 0.0
            for m in range(j, i):
                value -= L[i, m] * white[m, j]
            white[i, j] = value / L[i, i]


@compiled
def learn_scale(entry: Array, white: Array, innovation: Array, scale: Array, pace: float) -> float:
    """Mean square of the whitened innovations, -1 without readings; scale (4,) follows each where it exceeds 1."""
    total, count = 0.0, 0
    for i in range(4):
        if np.isfinite(entry[2 + i]):
            value = 0.0
            for j in range(i + 1):
                value += white[i, j] * innovation[j]
            square = value * value
            total += square
            count += 1
            grown = scale[i] * np.exp(pace * (min(square, LARGEST_SQUARE) - 1.0))
            scale[i] = min(max(grown, 1.0), LARGEST_SCALE)
    return total / count if count > 0 else -1.0


@compiled
def _excess(entry: Array, white: Array, innovation: Array) -> float:
    """Half of the squared whitened innovations, less what is expected of it."""
    excess = 0.0
    for i in range(4):
        if np.isfinite(entry[2 + i]):
            value = 0.0
            for j in range(i + 1):
                value += white[i, j] * innovation[j]
            excess += 0.5 * (value * value - 1.0)
    return excess


@compiled
def catch_up(
    c: Array,
    walk: Array,
    entries: Array,
    none: Array,
    x: Array,
    P: Array,
    evidence: Array,
    seen: Ints,
    onset: Ints,
    now: int,
    budget: int,
    jumping_bias: Ints,
    dropped: Ints,
    misfit: Array,
    fit: Ints,
    x_fit: Array,
    P_fit: Array,
    rows: int,
    bias_variance: float,
) -> int:
    """Take the first `rows` filters on towards step `now`, by at most `budget` filter steps; how many are still to do.

    entries, none : the history's, see `replay.History`; the others those of `replay.Replays`.

    `misfit` is the cumulative sum (Page 1954) of half the squared whitened innovations in excess of what is expected,
    less a slack; `fit`, `x_fit` and `P_fit` keep a late step, and the filter at it, at which the sum was nought.

    In the period in which a bias begins, the mean of that sensor's readings holds part of it only: what is learned of
    the bias there is forgotten.
    """
    A = np.zeros((MOVING, x.shape[1]))
    K = np.zeros((x.shape[1], 4))
    white = np.zeros((4, 4))
    innovation = np.zeros(4)
    left = 0
    for j in range(rows):
        if dropped[j]:
            continue
        while seen[j] < now and budget > 0:
            seen[j] += 1
            budget -= 1
            at = seen[j] % entries.shape[0]
            entry = entries[at]
            evidence[j] += step(c, walk, x[j], P[j], entry, A, K, white, innovation) - none[at]
            excess = _excess(entry, white, innovation) - MISFIT_SLACK
            misfit[j] = max(misfit[j] + min(excess, MISFIT_MOST), 0.0)
            if misfit[j] == 0.0 and seen[j] - fit[j] >= FIT_STEPS:
                fit[j] = seen[j]
                x_fit[j] = x[j]
                P_fit[j] = P[j]
            if jumping_bias[j] >= 0 and seen[j] == onset[j] + 1:
                state = BIAS + jumping_bias[j]
                P[j, state, :] = 0.0
                P[j, :, state] = 0.0
                P[j, state, state] = bias_variance
        left += now - seen[j]
    return left
