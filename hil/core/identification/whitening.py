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
    state = np.zeros((4, c))
    P = np.zeros((4, 4))
    F = np.zeros((4, 4))
    PF = np.zeros((4, 4))
    logdet = 0.0
    for k in range(n):
        if step[k] <= 0.0:
            state[:] = 0.0
            P[:] = 0.0
            P[2, 2], P[3, 3] = wave[0] ** 2, wave[1] ** 2
        else:
            dt = step[k]
            lower, upper = min(decay[k - 1, 0] * dt, 4.0), min(decay[k - 1, 1] * dt, 4.0)
            kept = np.exp(-dt / wave[2])
            F[0, 0], F[1, 1] = np.exp(-lower), np.exp(-upper)
            F[0, 1] = ratio * upper * np.exp(-0.5 * (lower + upper))
            F[2, 2] = F[3, 3] = kept
            for j in range(c):
                state[0, j] = F[0, 0] * state[0, j] + F[0, 1] * state[1, j]
                state[1, j] *= F[1, 1]
                state[2, j] *= kept
                state[3, j] *= kept
            for i in range(4):
                PF[i, 0] = P[i, 0] * F[0, 0] + P[i, 1] * F[0, 1]
                PF[i, 1] = P[i, 1] * F[1, 1]
                PF[i, 2] = P[i, 2] * kept
                PF[i, 3] = P[i, 3] * kept
            for j in range(4):
                P[0, j] = F[0, 0] * PF[0, j] + F[0, 1] * PF[1, j]
                P[1, j] = F[1, 1] * PF[1, j]
                P[2, j] = kept * PF[2, j]
                P[3, j] = kept * PF[3, j]
            P[0, 0] += turbulence[0] ** 2 * dt
            P[1, 1] += turbulence[1] ** 2 * dt
            P[2, 2] += wave[0] ** 2 * (1.0 - kept * kept)
            P[3, 3] += wave[1] ** 2 * (1.0 - kept * kept)
        for s in range(2):
            if np.isnan(columns[k, s, 0]):
                continue
            H = gain[s]
            S = H * H * P[s, s] + 2.0 * H * P[s, 2 + s] + P[2 + s, 2 + s] + variance[k, s]
            root = np.sqrt(S)
            logdet += np.log(S)
            K = (H * P[:, s] + P[:, 2 + s]) / S
            for j in range(c):
                innovation = columns[k, s, j] - H * state[s, j] - state[2 + s, j]
                white[k, s, j] = innovation / root
                for i in range(4):
                    state[i, j] += K[i] * innovation
            for i in range(4):
                for j in range(4):
                    PF[i, j] = P[i, j] - K[i] * K[j] * S
            P[:] = PF
    return white, logdet
