"""Intervals that cover: the covariance of the estimate, whatever colours the residuals.

The filter of `whitening` makes the residuals of a simulation white as far as waves and turbulence colour them. Each
channel is then tested (Ljung and Box, Biometrika 65, 1978). Where all are white, the covariance is the inverse of the
information. Where a channel is not, its part in the middle of the sandwich

    C = N^-1 M N^-1,     N = J' J,     M = sum over lags l of w_l (s_t s_(t-l)' + its transpose),    s_t = J_t' r_t

is that of Newey and West (Econometrica 55, 1987) with Bartlett weights w_l; that of a white channel is its share of N.
The residuals were fitted, so M is enlarged by m/(m - p).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from hil.core.identification.noise_model import Whitened

Array = NDArray[np.float64]

NORMAL_95 = 1.959964
TEST_LAGS = 20
TEST_LEVEL = 0.001
MIN_TESTED = 100


def scaled_inverse(information: Array) -> Array:
    """The inverse of a symmetric matrix of very different units; the pseudo-inverse where it has none."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse: Array = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-14, hermitian=True) * np.outer(
        scale, scale
    )
    return inverse


def is_white(residual: Array) -> bool:
    """Whether residuals in order of time show no correlation over the first `TEST_LAGS` lags."""
    n = len(residual)
    if n < MIN_TESTED:
        return True
    centred = residual - residual.mean()
    square = float(centred @ centred)
    if square <= 0.0:
        return True
    shares = np.array([float(centred[lag:] @ centred[:-lag]) / square for lag in range(1, TEST_LAGS + 1)])
    statistic = n * (n + 2.0) * float(np.sum(shares**2 / (n - np.arange(1, TEST_LAGS + 1))))
    return statistic < 2.0 * float(gammaincinv(TEST_LAGS / 2.0, 1.0 - TEST_LEVEL))  # the quantile of chi2


def coloured_channels(white: Whitened) -> tuple[int, ...]:
    """The channels, 0..3, whose whitened residuals are still correlated."""
    found = []
    for channel in range(4):
        own = white.channel == channel
        order = np.argsort(white.block[own], kind="stable")
        if not is_white(white.residual[own][order]):
            found.append(channel)
    return tuple(found)


def covariance(white: Whitened, besides: Array) -> Array:
    """(p, p) of the estimate. besides : (p, p) information of priors and of readings by a ruler."""
    information = white.sensitivity.T @ white.sensitivity + besides
    inverse = scaled_inverse(information)
    coloured = coloured_channels(white)
    size = max(float(np.mean(white.residual**2)), 1.0) if len(white.residual) else 1.0
    if not coloured:
        return scaled_inverse(white.sensitivity.T @ white.sensitivity / size + besides)
    middle = besides.copy()
    m, p = white.sensitivity.shape
    for channel in range(4):
        own = white.channel == channel
        rows = white.sensitivity[own]
        if channel in coloured:
            middle += newey_west(rows * white.residual[own, None], white.block[own]) * (m / max(m - p, 1))
        else:
            middle += size * rows.T @ rows
    return inverse @ middle @ inverse


def newey_west(scores: Array, block: NDArray[np.int64], lags: int | None = None) -> Array:
    """(p, p) long-run covariance of scores (m, p) in order of their time bins, summed over all of them.

    lags : of the Bartlett weights; None: by the correlation of the scores' largest direction (Andrews, Econometrica 59,
    1991, for a first-order process).
    """
    order = np.argsort(block, kind="stable")
    values = scores[order]
    n = len(values)
    if lags is None:
        lags = _lags(values)
    total: Array = values.T @ values
    for lag in range(1, min(lags, n - 1) + 1):
        product = values[lag:].T @ values[:-lag]
        total = total + (1.0 - lag / (lags + 1.0)) * (product + product.T)
    return total


def _lags(values: Array) -> int:
    scale = np.sqrt(np.maximum((values**2).mean(axis=0), 1e-300))
    scaled = values / scale
    share = float(np.sum(scaled[1:] * scaled[:-1]) / max(float(np.sum(scaled**2)), 1e-300))
    share = min(max(share, 0.0), 0.97)
    rate = 4.0 * share**2 / ((1.0 - share) ** 2 * (1.0 + share) ** 2)
    return max(5, int(np.ceil(1.1447 * (rate * len(values)) ** (1.0 / 3.0))))
