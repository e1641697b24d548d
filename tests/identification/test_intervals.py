"""Covariances and tests of whiteness against their textbook formulas, written out plainly."""

import numpy as np
import pytest
from scipy.stats import chi2

from hil.core.identification.intervals import (
    NORMAL_95,
    Array,
    coloured_channels,
    covariance,
    is_white,
    newey_west,
    scaled_inverse,
)
from hil.core.identification.noise_model import Whitened


def correlated(seed: int, share: float, n: int = 400) -> Array:
    """A first-order process whose neighbours are correlated by this share, with variance 1."""
    white = np.random.default_rng(seed).standard_normal(n)
    found = white.copy()
    for k in range(1, n):
        found[k] = share * found[k - 1] + np.sqrt(1.0 - share**2) * white[k]
    return found


def whitened(residual: Array, sensitivity: Array, channel: Array) -> Whitened:
    block = np.concatenate([np.arange((channel == i).sum()) for i in np.unique(channel)])
    return Whitened(residual, sensitivity, channel.astype(np.int64), block.astype(np.int64), 0.0)


def test_a_95_percent_interval_is_1_96_standard_deviations_wide() -> None:
    assert pytest.approx(1.959964, abs=1e-6) == NORMAL_95


def test_whiteness_is_the_test_of_ljung_and_box_at_one_in_a_thousand() -> None:
    """Q = n (n + 2) sum r_l^2 / (n - l) over 20 lags, against chi-squared."""
    decisions = set()
    for seed in range(400):
        series = 1e-3 * correlated(seed, 0.4, 100) + 5.0
        n, centred = len(series), series - np.mean(series)
        r = [np.sum(centred[lag:] * centred[: n - lag]) / np.sum(centred * centred) for lag in range(1, 21)]
        q = n * (n + 2) * sum(one**2 / (n - lag) for lag, one in enumerate(r, 1))
        assert is_white(series) == (q < chi2.ppf(0.999, 20)), seed
        decisions.add(is_white(series))
    assert decisions == {True, False}, "the series are near the limit"


def test_what_can_not_be_tested_counts_as_white() -> None:
    assert is_white(correlated(1, 0.95, 99))
    assert not is_white(correlated(1, 0.95, 100))
    assert is_white(np.full(200, 3.0))


@pytest.mark.parametrize(("n", "lags"), [(30, 3), (4, 10)])
def test_the_long_run_covariance_is_newey_and_west_s(n: int, lags: int) -> None:
    """In the order of the bins, with weights 1 - l/(L + 1); also of fewer values than lags."""
    random = np.random.default_rng(4)
    values, order = random.standard_normal((n, 2)), random.permutation(n)
    expected = np.zeros((2, 2))
    for i in range(n):
        for j in range(n):
            if abs(i - j) <= lags:
                expected += (1.0 - abs(i - j) / (lags + 1.0)) * np.outer(values[i], values[j])
    assert newey_west(values[order], np.arange(n)[order], lags) == pytest.approx(expected, rel=1e-12)


def test_the_number_of_lags_grows_with_the_correlation_and_the_length() -> None:
    """Andrews' rule for a first-order process: 1.1447 (alpha n)^(1/3), alpha = 4 r^2 / ((1 - r)^2 (1 + r)^2)."""
    for share, n in ((0.0, 400), (0.6, 400), (0.9, 400), (0.6, 3000), (0.998, 400), (-0.9, 400)):
        values = correlated(7, share, n)[:, None]
        r = min(max(float(np.sum(values[1:] * values[:-1]) / np.sum(values**2)), 0.0), 0.97)
        alpha = 4.0 * r**2 / ((1.0 - r) ** 2 * (1.0 + r) ** 2)
        lags = max(5, int(np.ceil(1.1447 * (alpha * n) ** (1.0 / 3.0))))
        expected = newey_west(values, np.arange(n), lags)
        assert newey_west(values, np.arange(n)) == pytest.approx(expected, rel=1e-12), (share, lags)


def test_the_units_of_the_scores_do_not_matter() -> None:
    """Gains and offsets have scores of very different size: the small ones count as much for the number of lags."""
    values = np.stack([correlated(12, 0.9), correlated(13, 0.0)], axis=1)
    plain, bins = newey_west(values, np.arange(400)), np.arange(400)
    for units in (np.array([1e-3, 1e3]), np.array([1e3, 1e-3])):
        expected = plain * np.outer(units, units)
        assert newey_west(values * units, bins) == pytest.approx(expected, rel=1e-9)


def test_an_inverse_of_very_different_units() -> None:
    information = np.array([[4e12, 1e6], [1e6, 1.0]])
    assert scaled_inverse(information) @ information == pytest.approx(np.eye(2), abs=1e-6)


def test_without_correlation_the_covariance_is_the_inverse_of_the_information() -> None:
    """Residuals that are larger than their noise model says widen it; smaller ones do not make it narrower."""
    random = np.random.default_rng(5)
    channel = np.repeat([0, 1, 2, 3], 150)
    rows, besides = random.standard_normal((600, 2)), np.diag([3.0, 0.0])
    for size in (0.5, 1.0, 2.0):
        residual = size * random.standard_normal(600)
        white = whitened(residual, rows, channel)
        assert coloured_channels(white) == ()
        wider = max(float(np.mean(residual**2)), 1.0)
        expected = np.linalg.inv(rows.T @ rows / wider + besides)
        assert covariance(white, besides) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("which", [0, 3])
def test_each_channel_is_tested_for_itself(which: int) -> None:
    residual = np.random.default_rng(9).standard_normal(600)
    channel = np.repeat([0, 1, 2, 3], 150)
    residual[channel == which] = correlated(10, 0.8, 150)
    shuffled = np.random.default_rng(11).permutation(600)
    white = whitened(residual, np.zeros((600, 1)), channel)
    mixed = Whitened(residual[shuffled], white.sensitivity, channel[shuffled], white.block[shuffled], 0.0)
    assert coloured_channels(white) == coloured_channels(mixed) == (which,), "in the order of the bins"


def test_a_coloured_channel_has_the_sandwich_for_its_part() -> None:
    random = np.random.default_rng(6)
    channel = np.repeat([0, 1, 2, 3], 150)
    rows, besides = 1.0 + 0.1 * random.standard_normal((600, 2)), np.diag([3.0, 1.0])
    residual = random.standard_normal(600)
    residual[150:300] = correlated(8, 0.8, 150)
    white = whitened(residual, rows, channel)
    assert coloured_channels(white) == (1,)
    size = max(float(np.mean(residual**2)), 1.0)
    own = channel == 1
    middle = besides + size * rows[~own].T @ rows[~own]
    middle = middle + newey_west(rows[own] * residual[own, None], np.arange(150)) * 600 / 598
    inverse = np.linalg.inv(rows.T @ rows + besides)
    assert covariance(white, besides) == pytest.approx(inverse @ middle @ inverse, rel=1e-6)
