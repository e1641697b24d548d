"""Gain and offset of a level sensor from known levels: intervals, refusals, and the verdict on a reading."""

from math import sqrt

import numpy as np
import pytest

from hil.core.identification.calibration import CalibrationError, LevelPoint, check_point, fit_line, fit_sensors
from hil.core.identification.steady_reading import judge


def points_of(
    gain: float, offset: float, levels: tuple[float, ...], errors_cm: tuple[float, ...] = (), tank: int = 0
) -> list[LevelPoint]:
    """Points whose levels the ruler shows with these errors."""
    errors = errors_cm or (0.0,) * len(levels)
    return [
        LevelPoint(tank, level + error, offset + gain * level, reading_sd_V=0.001)
        for level, error in zip(levels, errors, strict=True)
    ]


@pytest.mark.parametrize(("gain", "offset"), [(0.5, 0.0), (0.47, 0.12), (-0.1348, 5.851)])
def test_a_rising_and_a_falling_sensor_are_found(gain: float, offset: float) -> None:
    line = fit_line(points_of(gain, offset, (3.0, 10.0, 18.0)))
    assert line.gain_V_cm == pytest.approx(gain, rel=1e-9)
    assert line.offset_V == pytest.approx(offset, abs=1e-9)
    assert line.misses_cm == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_two_points_give_the_uncertainty_that_the_ruler_has() -> None:
    line = fit_line(points_of(0.5, 0.0, (2.0, 18.0)))
    assert line.gain_sd_V_cm == pytest.approx(sqrt(2.0) * sqrt(0.05**2 + 0.001**2) / 16.0, rel=1e-6)


def test_the_intervals_cover_in_95_of_100_drawn_calibrations() -> None:
    random = np.random.default_rng(5)
    gain, offset, levels = -0.14, 5.8, (2.0, 12.0, 30.0)
    errors = [tuple(random.normal(0.0, 0.1, 3)) for _ in range(400)]
    lines = [fit_line(points_of(gain, offset, levels, error)) for error in errors if max(map(abs, error)) < 0.25]
    inside = [
        (abs(line.gain_V_cm - gain) < 1.96 * line.gain_sd_V_cm, abs(line.offset_V - offset) < 1.96 * line.offset_sd_V)
        for line in lines
    ]
    shares = np.mean(inside, axis=0)
    assert (shares > 0.92).all(), shares


def test_one_level_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"tank 1: 2 points at one level"):
        fit_line(points_of(0.5, 0.0, (5.0, 5.0)))
    with pytest.raises(CalibrationError, match="no points"):
        fit_sensors([])


def test_levels_that_are_too_close_are_refused_with_the_distance_that_would_do() -> None:
    with pytest.raises(CalibrationError, match=r"from 5 to 6 cm are too close: .*14 %.*4\.7 cm apart would do"):
        fit_line(points_of(0.5, 0.0, (5.0, 6.0)))
    assert fit_line(points_of(0.5, 0.0, (5.0, 9.8))).gain_V_cm == pytest.approx(0.5)


def test_points_beside_the_line_are_refused_and_the_distance_is_named() -> None:
    points = points_of(0.5, 0.0, (2.0, 6.0, 10.0, 14.0, 18.0), (0.0, 0.0, 1.0, 0.0, 0.0))
    with pytest.raises(
        CalibrationError, match=r"5 V at 11 cm is 1\.01 cm off the line through the others, allowed 0\.39"
    ):
        fit_line(points)


def test_with_three_points_any_may_be_the_wrong_one() -> None:
    with pytest.raises(CalibrationError, match="any of the three may be wrong"):
        fit_line(points_of(0.5, 0.0, (2.0, 10.0, 18.0), (0.0, 1.0, 0.0)))


def test_a_sensor_that_does_not_follow_the_level_is_refused() -> None:
    points = [LevelPoint(2, level, 3.0, reading_sd_V=0.001) for level in (2.0, 18.0)]
    with pytest.raises(CalibrationError, match=r"tank 3: the reading does not follow the level.*another tank"):
        fit_line(points)


@pytest.mark.parametrize(
    ("level", "reading", "why"),
    [
        (21.0, 5.0, r"level 21 cm is outside 0\.\.20 cm"),
        (-0.5, 5.0, r"level -0.5 cm is outside"),
        (10.0, 11.0, r"reading 11 V at 10 cm is outside sensors\.range_V 0\.\.10\.24 V"),
        (0.0, 0.003, r"reading 0\.003 V at 0 cm is at the end of sensors\.range_V"),
        (20.0, 10.235, r"may be saturated"),
    ],
)
def test_levels_and_readings_out_of_range_are_refused(level: float, reading: float, why: str) -> None:
    with pytest.raises(CalibrationError, match=why):
        check_point(LevelPoint(1, level, reading), 20.0, (0.0, 10.24), 0.005)


def readings(drift_V_s: float, *, seconds: float = 3.0, waves_V: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    t = np.arange(0.0, seconds, 0.02)
    return t, 5.0 + drift_V_s * t + waves_V * np.sin(4.0 * t) + random.normal(0.0, 0.005, len(t))


def test_a_resting_level_has_settled_and_its_noise_is_found() -> None:
    state = judge(*readings(0.0), 0.5)
    assert state.is_settled
    assert state.noise_V == pytest.approx(0.005, rel=0.15)
    assert state.mean_V == pytest.approx(5.0, abs=4.0 * state.mean_sd_V)


@pytest.mark.parametrize(("gain", "word"), [(0.5, "falls"), (-0.14, "rises")])
def test_a_tank_that_drains_has_not_settled(gain: float, word: str) -> None:
    state = judge(*readings(-0.05), gain)
    assert not state.is_settled
    assert word in state.lacks
    assert state.noise_V == pytest.approx(0.005, rel=0.15), "the drift adds no noise"


def test_waves_make_the_mean_less_certain() -> None:
    assert judge(*readings(0.0, waves_V=0.02), 0.5).mean_sd_V > 3.0 * judge(*readings(0.0), 0.5).mean_sd_V


def test_a_short_time_is_no_verdict() -> None:
    assert judge(*readings(0.0, seconds=1.0), 0.5).lacks == "wait"
    assert judge(np.zeros(0), np.zeros(0), 0.5).lacks == "no reading"
