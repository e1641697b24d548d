"""One step of the filter that all diagnosis rests on: an extended Kalman filter of the four tanks (states: `model`).

A step predicts the state by one control period, compares with the readings and corrects. Its innovations are white as
long as the rig behaves as the model says. A reading is the mean over the readings of one period, so it belongs to a
moment within the period: at the share `WEIGHT` of the way from the last step to this one.

What a step sees is an *entry* of the history, (ENTRY,) numbers; the constants below are where each group begins.
All matrices are dense and small. Why this filter: `docs/decisions/0009-diagnosis-by-likelihood-ratios.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.core.diagnosis.glr.compiled import compiled
from hil.core.diagnosis.glr.model import (
    BIAS,
    DRIFT,
    LAG,
    LEVEL,
    MOVING,
    OUTLET,
    PUMP,
    SPLIT,
    ZONE,
    Array,
    FilterModel,
    N,
    predict,
)

ENTRY = 18
VOLTAGE, READING, VARIANCE, PERIOD, WEIGHT, DOUBT, WALK = 0, 2, 6, 10, 11, 12, 14
"""An entry: drives that arrived (2) V, readings (4) V (NaN: none), variances (4) V^2, period s, weight of its end, how
wrong the lagged voltages at the start of the period may be, because what was applied is not known (2) V, and the
variance of the levels' random walk in the period (4) cm^2."""

NO_READING_V2 = 1e6
"""Variance of a reading that isn't there."""

MIN_OUTLET = -0.02
"""The estimate of a shut outlet errs to either side of zero; a limit at zero would make it look open."""

MIN_LAG, MAX_LAG = 0.05, 75.0
MIN_SPLIT, MAX_SPLIT = 0.01, 0.99
"""Lags over the rig file's; splits: the lower limit over the rig file's, the upper one of the split itself."""

MIN_PIVOT = 1e-12


class StepResult(NamedTuple):
    """What a step computes besides the new state; its arrays are written by each step.

    A : (MOVING, N) moving rows of the transition matrix. K : (N, 4) Kalman gain. whitener : (4, 4) lower triangular,
    whitener S whitener' = I for the innovations' covariance S. innovation : (4,) V, 0 where there was no reading.
    variance : (4,) V^2, the diagonal of S.
    """

    A: Array
    K: Array
    whitener: Array
    innovation: Array
    variance: Array

    @classmethod
    def empty(cls) -> StepResult:
        """Room for the results of a step."""
        return cls(
            A=np.zeros((MOVING, N)),
            K=np.zeros((N, 4)),
            whitener=np.zeros((4, 4)),
            innovation=np.zeros(4),
            variance=np.zeros(4),
        )


@compiled
def filter_step(model: FilterModel, x: Array, P: Array, entry: Array, result: StepResult) -> float:
    """One control period, in place; the log-likelihood of the readings.

    x : (N,) state. P : (N, N) its covariance. entry : (ENTRY,). Writes `result`.
    """
    A, K, innovation = result.A, result.K, result.innovation
    dt, weight = entry[PERIOD], entry[WEIGHT]
    level_before, bias_before = x[LEVEL : LEVEL + 4].copy(), x[BIAS : BIAS + 4].copy()
    for j in range(2):
        P[PUMP + j, PUMP + j] += entry[DOUBT + j] ** 2
    zone_std_V = np.array([np.sqrt(max(P[ZONE + j, ZONE + j], 0.0)) for j in range(2)])
    predict(model, x, zone_std_V, entry[VOLTAGE : VOLTAGE + 2], dt, A)
    AP = _moved_covariance_rows(A, P)
    BP, S = _reading_covariance(model.level_gain_V_cm, dt, weight, A, P, AP)
    _innovate(model, entry, x, level_before, bias_before, S, innovation)
    for i in range(4):
        result.variance[i] = S[i, i]
    _whiten(S, result.whitener)
    log_likelihood = _log_likelihood(result.whitener, innovation)
    X = _state_reading_covariance(model.level_gain_V_cm, entry, A, BP)
    _kalman_gain(X, result.whitener, K)
    _move_covariance(P, A, AP, dt)
    for i in range(N):
        P[i, i] += model.walk[i]
    for i in range(4):
        P[LEVEL + i, LEVEL + i] += entry[WALK + i]
    _correct(x, P, K, X, innovation)
    _limit(model, x)
    return log_likelihood


@compiled
def _moved_covariance_rows(A: Array, P: Array) -> Array:
    """A P, (MOVING, N)."""
    AP = np.zeros((MOVING, N))
    for i in range(MOVING):
        for m in range(N):
            value = A[i, m]
            if value != 0.0:
                for j in range(N):
                    AP[i, j] += value * P[m, j]
    return AP


@compiled
def _reading_covariance(
    level_gain: float, dt: float, weight: float, A: Array, P: Array, AP: Array
) -> tuple[Array, Array]:
    """B P (4, N) and S = B P B' (4, 4), where B (4, N) maps the state before the step to the expected readings.

    S is symmetric: only its lower triangle is computed.
    """
    BP = np.empty((4, N))
    B = np.zeros((4, N))
    for i in range(4):
        for j in range(N):
            BP[i, j] = (
                level_gain * ((1.0 - weight) * P[i, j] + weight * AP[i, j])
                + P[BIAS + i, j]
                + weight * dt * P[DRIFT + i, j]
            )
            B[i, j] = level_gain * weight * A[i, j]
        B[i, i] += level_gain * (1.0 - weight)
        B[i, BIAS + i] += 1.0
        B[i, DRIFT + i] += weight * dt
    S = np.zeros((4, 4))
    for j in range(4):
        for m in range(N):
            value = B[j, m]
            if value != 0.0:
                for i in range(j, 4):
                    S[i, j] += BP[i, m] * value
    return BP, S


@compiled
def _innovate(
    model: FilterModel,
    entry: Array,
    x: Array,
    level_before: Array,
    bias_before: Array,
    S: Array,
    innovation: Array,
) -> None:
    """Innovations (4,) V of the readings; their noise is added to the diagonal of S (4, 4)."""
    gain, weight = model.level_gain_V_cm, entry[WEIGHT]
    walk_seen = weight * (1.0 + 2.0 * weight) / 3.0  # of the mean of evenly spaced readings
    for i in range(4):
        reading = entry[READING + i]
        if np.isfinite(reading):
            level = level_before[i] + weight * (x[LEVEL + i] - level_before[i])
            innovation[i] = reading - (gain * level + bias_before[i] + weight * (x[BIAS + i] - bias_before[i]))
            S[i, i] += entry[VARIANCE + i] + gain * gain * walk_seen * entry[WALK + i]
        else:
            innovation[i] = 0.0
            S[i, i] += NO_READING_V2


@compiled
def _whiten(S: Array, whitener: Array) -> None:
    """Inverse of the Cholesky factor of S (4, 4), lower triangular."""
    L = np.zeros((4, 4))
    for i in range(4):
        for j in range(i + 1):
            value = S[i, j]
            for m in range(j):
                value -= L[i, m] * L[j, m]
            if i == j:
                L[i, i] = np.sqrt(max(value, MIN_PIVOT))
            else:
                L[i, j] = value / L[j, j]
    whitener[:, :] = 0.0
    for j in range(4):
        whitener[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, 4):
            value = 0.0
            for m in range(j, i):
                value -= L[i, m] * whitener[m, j]
            whitener[i, j] = value / L[i, i]


@compiled
def _log_likelihood(whitener: Array, innovation: Array) -> float:
    """Of Gaussian innovations, but for a constant."""
    log_det, square = 0.0, 0.0
    for i in range(4):
        value = whitened(whitener, innovation, i)
        square += value * value
        log_det -= 2.0 * np.log(whitener[i, i])
    return -0.5 * (log_det + square)


@compiled
def whitened(whitener: Array, innovation: Array, i: int) -> float:
    """Whitened innovation i: standard normal as long as the model holds."""
    value = 0.0
    for j in range(i + 1):
        value += whitener[i, j] * innovation[j]
    return value


@compiled
def _state_reading_covariance(level_gain: float, entry: Array, A: Array, BP: Array) -> Array:
    """Cross covariance of the predicted state with the readings, (N, 4)."""
    dt, weight = entry[PERIOD], entry[WEIGHT]
    X = np.empty((N, 4))
    for i in range(4):
        for j in range(N):
            X[j, i] = BP[i, j]
        for m in range(4):
            X[BIAS + m, i] += dt * BP[i, DRIFT + m]
    X[:MOVING] = 0.0
    for m in range(MOVING):
        for j in range(N):
            value = A[m, j]
            if value != 0.0:
                for i in range(4):
                    X[m, i] += value * BP[i, j]
    for i in range(4):
        X[i, i] += level_gain * weight * entry[WALK + i]
    return X


@compiled
def _kalman_gain(X: Array, whitener: Array, K: Array) -> None:
    """K = X S^-1 with S^-1 = whitener' whitener, (N, 4)."""
    t = np.empty(4)
    for j in range(N):
        for i in range(4):
            value = 0.0
            for m in range(i + 1):
                value += whitener[i, m] * X[j, m]
            t[i] = value
        for i in range(4):
            value = 0.0
            for m in range(i, 4):
                value += whitener[m, i] * t[m]
            K[j, i] = value


@compiled
def _move_covariance(P: Array, A: Array, AP: Array, dt: float) -> None:
    """P <- F P F' for the transition F whose top rows are A and in which biases follow drifts.

    The block of the moving states is computed in its lower triangle only; `_correct` reads that and writes both.
    """
    for i in range(MOVING):
        for j in range(MOVING, N):
            P[i, j] = AP[i, j]
            P[j, i] = AP[i, j]
        for j in range(i + 1):
            P[i, j] = 0.0
    for j in range(MOVING):
        for m in range(N):
            value = A[j, m]
            if value != 0.0:
                for i in range(j, MOVING):
                    P[i, j] += AP[i, m] * value
    for i in range(4):
        if P[DRIFT + i, DRIFT + i] > 0.0:
            for j in range(N):
                P[BIAS + i, j] += dt * P[DRIFT + i, j]
            for j in range(N):
                P[j, BIAS + i] += dt * P[j, DRIFT + i]


@compiled
def _correct(x: Array, P: Array, K: Array, X: Array, innovation: Array) -> None:
    """Take the readings in: x <- x + K innovation, P <- P - K X'."""
    for i in range(N):
        for j in range(i + 1):
            value = P[i, j] - (K[i, 0] * X[j, 0] + K[i, 1] * X[j, 1] + K[i, 2] * X[j, 2] + K[i, 3] * X[j, 3])
            P[i, j] = value
            P[j, i] = value
        x[i] += K[i, 0] * innovation[0] + K[i, 1] * innovation[1] + K[i, 2] * innovation[2] + K[i, 3] * innovation[3]


@compiled
def _limit(model: FilterModel, x: Array) -> None:
    """Keep levels, outlets, lags and splits where eq. (1) has a meaning."""
    for i in range(4):
        x[LEVEL + i] = min(max(x[LEVEL + i], 0.0), model.height_cm[i])
        x[OUTLET + i] = max(x[OUTLET + i], MIN_OUTLET)
    for j in range(2):
        x[LAG + j] = min(max(x[LAG + j], MIN_LAG), MAX_LAG)
        x[SPLIT + j] = min(max(x[SPLIT + j], MIN_SPLIT), MAX_SPLIT / model.valve_split[j])
