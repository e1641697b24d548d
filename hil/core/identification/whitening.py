"""White residuals from coloured ones: a Kalman filter of what the model's simulation can't know.

The simulation of a record leaves residuals r = reading - prediction. Beyond the white noise of the sensors they hold

- waves: sloshing adds to each reading a first-order process of standard deviation w and correlation time tau;
- turbulence: a white noise on the flow into each tank. Its volume stays in the tank and drains with it, into the tank
  below, so that the error of a simulated level fades as slowly as the level itself.

Tanks 1, 3 and tanks 2, 4 do not share any water but that of the pumps, which is known. So each side has a filter of its
own, with the errors e of its two levels and its two waves as states:

    e_upper' = -d_upper e_upper + noise,    e_lower' = -d_lower e_lower + A_upper/A_lower d_upper e_upper + noise

with d = a/A sqrt(g/2 (h + datum)) along the simulated levels. The filter is linear in the readings. Given to r and to
every column of the sensitivities it turns generalised least squares into ordinary least squares (Durbin and Koopman,
Time Series Analysis by State Space Methods, 2012, section 6.2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.core.diagnosis.glr.compiled import compiled

Array = NDArray[np.float64]


@compiled
def predict(
    state: Array, P: Array, scratch: Array, fade: Array, ratio: float, dt: float, turbulence: Array, wave: Array
) -> None:
    """State (4, c) and covariance P (4, 4) after dt, in place. fade : (2,) d of both tanks, 1/s. scratch : (4, 4)."""
    lower, upper = min(fade[0] * dt, 4.0), min(fade[1] * dt, 4.0)
    f00, f11, kept = np.exp(-lower), np.exp(-upper), np.exp(-dt / wave[2])
    f01 = ratio * upper * np.exp(-0.5 * (lower + upper))
    for j in range(state.shape[1]):
        state[0, j] = f00 * state[0, j] + f01 * state[1, j]
        state[1, j] *= f11
        state[2, j] *= kept
        state[3, j] *= kept
    for i in range(4):
        scratch[i, 0] = P[i, 0] * f00 + P[i, 1] * f01
        scratch[i, 1] = P[i, 1] * f11
        scratch[i, 2] = P[i, 2] * kept
        scratch[i, 3] = P[i, 3] * kept
    for j in range(4):
        P[0, j] = f00 * scratch[0, j] + f01 * scratch[1, j]
        P[1, j] = f11 * scratch[1, j]
        P[2, j] = kept * scratch[2, j]
        P[3, j] = kept * scratch[3, j]
    for i in range(2):
        P[i, i] += turbulence[i] ** 2 * dt
        P[2 + i, 2 + i] += wave[i] ** 2 * (1.0 - kept * kept)


@compiled
def update(state: Array, P: Array, columns: Array, sensor: int, gain: float, variance: float, white: Array) -> float:
    """Take one reading of a sensor (0 lower, 1 upper) into state and covariance, in place; returns log S.

    columns : (c,) residual and sensitivities. white : (c,) gets the innovations over the root of their variance S.
    """
    S = gain * gain * P[sensor, sensor] + 2.0 * gain * P[sensor, 2 + sensor] + P[2 + sensor, 2 + sensor] + variance
    root = np.sqrt(S)
    K = (gain * P[:, sensor] + P[:, 2 + sensor]) / S
    for j in range(state.shape[1]):
        innovation = columns[j] - gain * state[sensor, j] - state[2 + sensor, j]
        white[j] = innovation / root
        for i in range(4):
            state[i, j] += K[i] * innovation
    for i in range(4):
        for j in range(4):
            P[i, j] -= K[i] * K[j] * S
    return float(np.log(S))


@compiled
def whitened_side(
    columns: Array,
    variance: Array,
    decay: Array,
    gain: Array,
    ratio: float,
    step: Array,
    turbulence: Array,
    wave: Array,
) -> tuple[Array, float]:
    """The innovations of one side, each over its standard deviation, and the log determinant of their covariance.

    columns : (n, 2, c) residuals and sensitivities of the lower and the upper sensor, V; NaN in column 0 where there is
    no reading. variance : (n, 2) of the white noise of each value, V2. decay : (n, 2) d of both tanks, 1/s. gain : (2,)
    of the sensors, V/cm. ratio : A_upper/A_lower. step : (n,) time from the row before, s; 0 in a record's first row,
    at which the filter starts again. turbulence : (2,) random walk of each level, cm/sqrt(s). wave : (3,) standard
    deviations of both waves, V, and their correlation time, s.
    Returns (n, 2, c), with zeros where there is no reading.
    """
    n, _, c = columns.shape
    white = np.zeros((n, 2, c))
    state, P, scratch = np.zeros((4, c)), np.zeros((4, 4)), np.zeros((4, 4))
    logdet = 0.0
    for k in range(n):
        if step[k] <= 0.0:
            state[:], P[:] = 0.0, 0.0
            P[2, 2], P[3, 3] = wave[0] ** 2, wave[1] ** 2
        else:
            predict(state, P, scratch, decay[k - 1], ratio, step[k], turbulence, wave)
        for s in range(2):
            if not np.isnan(columns[k, s, 0]):
                logdet += update(state, P, columns[k, s], s, gain[s], variance[k, s], white[k, s])
    return white, logdet
