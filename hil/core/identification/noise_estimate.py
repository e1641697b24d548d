"""How large waves, turbulence and the noise of the sensors are: the most likely ones, given the residuals.

Restricted maximum likelihood (Patterson and Thompson, Biometrika 58, 1971) of the innovations of `whitening`, so that
what the parameters have taken out of the residuals is not counted as quiet. Each side of the rig has its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.noise_model import (
    SIDES,
    Linearisation,
    NoiseModel,
    SideData,
    bin_width,
    binned,
    sides_of,
)
from hil.core.identification.parameters import RigModel

Array = NDArray[np.float64]

NOISE_BIN_S = 1.0
WAVE_S = (0.7, 8.0)
TURBULENCE = (1e-6, 0.3)
WAVE_SHARE = (1e-3, 30.0)
WHITE_SHARE = (0.2, 1.5)
HOPELESS = 1e30
WHITE_SD = (0.02, 0.3)
"""How well differences of neighbouring readings give the white noise: as a share, and more for 1 s between them."""
LOUD_START = (log(0.3), log(0.3), log(1e-4), log(1e-4), log(3.0), 0.0, 0.0)
QUIET_START = (log(0.02), log(0.02), log(3e-3), log(3e-3), log(3.0), 0.0, 0.0)
"""Of `_SideLikelihood`: large waves and little turbulence, and the other way round."""


def estimate_noise(
    records: Sequence[Linearisation],
    model: RigModel,
    information: Array,
    score: Array,
    start: NoiseModel,
    *,
    is_first: bool,
) -> NoiseModel:
    """The noise model with the largest restricted likelihood.

    information, score : (p, p) and (p,) of what is known besides the readings: priors and readings by a ruler, as the
    normal equations information delta = score. is_first : waves and turbulence of the start are not used.
    """
    noise = start
    width_s = bin_width(records, NOISE_BIN_S)
    step_s = min(float(np.median(np.diff(record.time_s))) for record in records)
    white_sd = WHITE_SD[0] + WHITE_SD[1] * min(step_s, 1.0)
    sides = sides_of([binned(record, width_s) for record in records], model)
    normal = [_normal(*sides[side].whitened(noise, side)) for side in (0, 1)]
    for is_new in (is_first, False):
        for side in (0, 1):
            other = normal[1 - side]
            others = information + other[0], score + other[1]
            noise = _SideLikelihood(sides[side], side, noise, others, white_sd).best(is_first=is_new)
            normal[side] = _normal(*sides[side].whitened(noise, side))
    return noise


def _normal(white: Array, logdet: float) -> tuple[Array, Array, float, float]:
    rows = white.reshape(-1, white.shape[2])
    product = rows.T @ rows
    return product[1:, 1:], product[1:, 0], float(product[0, 0]), logdet


class _SideLikelihood:
    """The restricted likelihood of one side's noise.

    x : (7,) logarithms: both waves over the white noise, both turbulences, correlation time of the waves, and both
    white noises over those of `noise`. others : information (p, p) and score (p,) of all but this side's readings.
    white_sd : how well the white noises are known beforehand, as a share.
    """

    BOUNDS = tuple(
        (log(low), log(high)) for low, high in (*[WAVE_SHARE] * 2, *[TURBULENCE] * 2, WAVE_S, *[WHITE_SHARE] * 2)
    )

    def __init__(
        self, data: SideData, side: int, noise: NoiseModel, others: tuple[Array, Array], white_sd: float
    ) -> None:
        self._data, self._side, self._noise, self._white_sd = data, side, noise, white_sd
        self._information, self._score = others

    def best(self, *, is_first: bool) -> NoiseModel:
        """The most likely noise. is_first : waves and turbulence of `noise` are no place to begin."""
        from scipy.optimize import minimize  # here: a run that fits nothing need not load it

        starts = [LOUD_START, QUIET_START] if is_first else [self._known_start()]
        options = {"eps": 1e-3, "maxiter": 40, "ftol": 3e-7}
        tried = (minimize(self.cost, x, method="L-BFGS-B", bounds=self.BOUNDS, options=options) for x in starts)
        return self.noise_at(np.asarray(min(tried, key=lambda result: float(result.fun)).x))

    def _known_start(self) -> list[float]:
        noise, pair = self._noise, SIDES[self._side]
        waves = [max(noise.wave_V[i] / noise.noise_V[i], WAVE_SHARE[0]) for i in pair]
        walks = [max(noise.turbulence_cm_sqrt_s[i], TURBULENCE[0]) for i in pair]
        return [*map(log, waves), *map(log, walks), log(noise.wave_s[self._side]), 0.0, 0.0]

    def noise_at(self, x: Array) -> NoiseModel:
        """The noise model at x; the other side stays."""
        noise = self._noise
        white, wave, walk = list(noise.noise_V), list(noise.wave_V), list(noise.turbulence_cm_sqrt_s)
        wave_s = list(noise.wave_s)
        for at, i in enumerate(SIDES[self._side]):
            white[i] = noise.noise_V[i] * exp(x[5 + at])
            wave[i], walk[i] = noise.noise_V[i] * exp(x[at]), exp(x[2 + at])
        wave_s[self._side] = exp(x[4])
        return NoiseModel(tuple(white), tuple(wave), tuple(wave_s), tuple(walk))

    def cost(self, x: Array) -> float:
        """Minus the logarithm of the likelihood, but for a constant."""
        information, score, square, logdet = _normal(*self._data.whitened(self.noise_at(x), self._side))
        total, right = information + self._information, score + self._score
        scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-30))
        scaled = total * scale[:, None] * scale + 1e-10 * np.eye(len(scale))
        if not np.isfinite(scaled).all():
            return HOPELESS
        try:
            factor = np.linalg.cholesky(scaled)
        except np.linalg.LinAlgError:
            return HOPELESS
        half = np.linalg.solve(factor, right * scale)
        determinant = 2.0 * float(np.log(np.diag(factor)).sum())
        away = float(x[5:] @ x[5:]) / self._white_sd**2
        return 0.5 * (square + logdet - float(half @ half) + determinant - 2.0 * float(np.log(scale).sum()) + away)
