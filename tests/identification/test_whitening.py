"""The filter that whitens residuals, and the noise model that it is given."""

import numpy as np
import pytest

from hil.core.identification.intervals import covariance, is_white
from hil.core.identification.noise_estimate import estimate_noise
from hil.core.identification.noise_model import (
    Array,
    Linearisation,
    NoiseModel,
    white_noise,
    whitened,
)
from hil.core.identification.parameters import RigModel

LEVELS_CM = (12.0, 12.0, 2.0, 2.0)


def coloured(seed: int, *, wave_V: float = 0.0, walk_cm: float = 0.0, n: int = 1200) -> Linearisation:
    """Residuals of n seconds with white noise of 2 mV, waves of 3 s and turbulence, at constant levels."""
    random = np.random.default_rng(seed)
    model = RigModel()
    residual = 0.002 * random.standard_normal((n, 4))
    kept = np.exp(-1.0 / 3.0)
    wave, error = wave_V * random.standard_normal(4), np.zeros(4)
    areas = np.array(model.tanks.area_cm2)
    decay = np.array(model.tanks.outlet_cm2) / areas * np.sqrt(981.0 / (2.0 * np.array(LEVELS_CM)))
    for k in range(n):
        residual[k] += wave + 0.5 * error
        wave = kept * wave + wave_V * np.sqrt(1.0 - kept**2) * random.standard_normal(4)
        passed = decay * error
        error = error - passed + walk_cm * random.standard_normal(4)
        error[:2] += areas[2:] / areas[:2] * passed[2:]
    time_s: Array = np.arange(float(n))
    slow = np.exp(-time_s / 60.0)[:, None] * np.ones(4)
    return Linearisation(
        time_s, residual, np.stack([slow, np.ones((n, 4))], axis=2), np.tile(LEVELS_CM, (n, 1)), np.ones((n, 4))
    )


def noise_of(record: Linearisation) -> NoiseModel:
    start = NoiseModel(white_noise([record], (0.005,) * 4))
    return estimate_noise([record], RigModel(), np.zeros((2, 2)), np.zeros(2), start, is_first=True)


def test_white_residuals_stay_as_they_are() -> None:
    record = coloured(1)
    noise = noise_of(record)
    assert np.allclose(noise.noise_V, 0.002, rtol=0.1)
    white = whitened([record], RigModel(), noise)
    plain = np.linalg.inv(np.einsum("nip,niq->pq", record.sensitivity_V, record.sensitivity_V) / 0.002**2)
    assert np.allclose(covariance(white, np.zeros((2, 2))), plain, rtol=0.2)


def test_waves_are_found_and_removed() -> None:
    record = coloured(2, wave_V=0.004)
    assert not is_white(record.residual_V[:, 0])
    noise = noise_of(record)
    assert np.allclose(noise.wave_V, 0.004, rtol=0.25)
    white = whitened([record], RigModel(), noise)
    assert abs(np.mean(white.residual**2) - 1.0) < 0.15  # differences over 1 s hold some waves, too
    assert all(is_white(white.residual[white.channel == i]) for i in range(4))


def test_turbulence_is_found_in_each_tank() -> None:
    noise = noise_of(coloured(3, walk_cm=0.004))
    assert np.allclose(noise.turbulence_cm_sqrt_s, 0.004, rtol=0.35)


@pytest.mark.long
def test_intervals_cover_under_waves_and_turbulence() -> None:
    """Least squares that took the residuals for white would cover in 3 of 10."""
    inside = []
    for seed in range(30):
        record = coloured(100 + seed, wave_V=0.003, walk_cm=0.002, n=500)
        white = whitened([record], RigModel(), noise_of(record))
        spread = covariance(white, np.zeros((2, 2)))
        error = np.linalg.solve(white.sensitivity.T @ white.sensitivity, white.sensitivity.T @ white.residual)
        inside += list(np.abs(error) < 1.96 * np.sqrt(np.diag(spread)))
    assert 0.87 <= np.mean(inside) <= 1.0


def test_the_sandwich_covers_what_no_filter_has_removed() -> None:
    """Residuals with a correlation that the noise model was not given: the sandwich makes up for it."""
    inside = []
    for seed in range(40):
        record = coloured(200 + seed, wave_V=0.004, n=1500)
        white = whitened([record], RigModel(), NoiseModel((0.0045,) * 4))
        spread = covariance(white, np.zeros((2, 2)))
        error = np.linalg.solve(white.sensitivity.T @ white.sensitivity, white.sensitivity.T @ white.residual)
        inside += list(np.abs(error) < 1.96 * np.sqrt(np.diag(spread)))
    assert np.mean(inside) >= 0.85
