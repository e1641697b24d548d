"""What single readings show: sensors of any noise against their converter's steps."""

from math import isnan, nan

import numpy as np
import numpy.typing as npt
import pytest

from hil.core.diagnosis.glr.sensor_statistics import MAX_RUN, SensorStatistics
from hil.core.types import Measurement

STEP_V = 0.0025
READINGS = 5
FILE_NOISE_V = 0.005


class Sensor:
    """Readings of one sensor, period by period, as the wire would sum them up."""

    def __init__(self, noise_V: float, seed: int) -> None:
        self.noise_V, self.random = noise_V, np.random.default_rng(seed)
        self.last, self.repeats = nan, 0
        self.stuck_V: float | None = None

    def period(self, level_V: float) -> Measurement:
        noisy = (level_V + self.noise_V * self.random.normal(size=READINGS)).tolist()
        readings = [round(y / STEP_V) * STEP_V if self.stuck_V is None else self.stuck_V for y in noisy]
        steps = [
            0.0 if isnan(last) else (y - last) ** 2 for last, y in zip([self.last, *readings], readings, strict=False)
        ]
        for reading in readings:
            self.repeats = self.repeats + 1 if reading == self.last else 0
            self.last = reading
        jitter = (sum(steps) - max(steps)) / (2 * READINGS - 2)
        mean = sum(readings) / READINGS
        variance = sum((y - mean) ** 2 for y in readings) / (READINGS - 1)
        return Measurement((mean,) * 4, (True,) * 4, 0.0, READINGS, (variance,) * 4, (jitter,) * 4, (self.repeats,) * 4)


def watch(sensor: Sensor, statistics: SensorStatistics, levels_V: npt.NDArray[np.float64]) -> list[int]:
    """The periods in which the statistics calls the sensor stuck."""
    stuck = []
    for number, level_V in enumerate(levels_V):
        measurement = sensor.period(float(level_V))
        statistics.learn(measurement, 0, is_used=True)
        if statistics.is_stuck(measurement, 0):
            stuck.append(number)
    return stuck


def wandering(periods: int) -> npt.NDArray[np.float64]:
    """A level that creeps through a few codes and rests at each for a while, in the middle of them and between."""
    return 5.0 + 0.5 * STEP_V * np.floor(np.linspace(0.0, 8.0, periods))


@pytest.mark.parametrize("noise_V", [0.002, 0.005, 0.0075, 0.05])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_healthy_sensor_is_never_called_stuck(noise_V: float, seed: int) -> None:
    assert watch(Sensor(noise_V, seed), SensorStatistics(FILE_NOISE_V**2), wandering(20_000)) == []


@pytest.mark.parametrize(("noise_V", "within"), [(0.002, 14), (0.005, 4), (0.0075, 4), (0.05, 4)])
def test_a_stuck_one_is_found_within_some_periods(noise_V: float, within: int) -> None:
    sensor, statistics = Sensor(noise_V, 3), SensorStatistics(FILE_NOISE_V**2)
    assert watch(sensor, statistics, wandering(1000)) == []
    sensor.stuck_V = sensor.last
    found = watch(sensor, statistics, np.full(within, 5.0))
    assert found
    assert found[0] < within
    assert found == list(range(found[0], within)), "once found it stays"


def test_before_a_sensor_is_called_stuck_it_is_doubtful() -> None:
    sensor, statistics = Sensor(0.005, 4), SensorStatistics(FILE_NOISE_V**2)
    watch(sensor, statistics, wandering(500))
    sensor.stuck_V = sensor.last
    doubtful, stuck = [], []
    for number in range(4):
        measurement = sensor.period(5.0)
        statistics.learn(measurement, 0, is_used=True)
        doubtful.append(statistics.may_be_stuck(measurement, 0))
        stuck.append(statistics.is_stuck(measurement, 0))
        assert doubtful[number] or not stuck[number]
    assert doubtful.index(True) < stuck.index(True)


def test_a_sensor_without_noise_is_not_judged() -> None:
    sensor, statistics = Sensor(0.0, 5), SensorStatistics(FILE_NOISE_V**2)
    watch(sensor, statistics, np.linspace(5.0, 5.2, 400))
    stuck = watch(sensor, statistics, np.full(MAX_RUN, 5.2))
    assert stuck == []


def test_a_run_as_long_as_one_before_it_is_not_called_stuck() -> None:
    """A quiet signal repeats itself for as long as it lies in the middle of a code, however rarely it did before."""
    sensor, statistics = Sensor(0.005, 6), SensorStatistics(FILE_NOISE_V**2)
    watch(sensor, statistics, wandering(300))
    statistics.longest_run = 30
    sensor.stuck_V = sensor.last
    found = watch(sensor, statistics, np.full(20, 5.0))
    assert 2 * 30 <= READINGS * (found[0] + 1) < 2 * 30 + 2 * READINGS


@pytest.mark.parametrize(("readings", "periods"), [(2, 6), (3, 4), (4, 3), (5, 3), (10, 3)])
def test_a_sensor_is_noisy_after_three_periods_with_a_dozen_readings(readings: int, periods: int) -> None:
    """With a control period of 0.05 s, three of two or three readings are noisy by chance now and then."""
    statistics = SensorStatistics(FILE_NOISE_V**2)
    variance_V2 = 10.0 * FILE_NOISE_V**2
    noisy, calm = (
        Measurement((5.0,) * 4, (True,) * 4, 0.0, readings, (value,) * 4, (value,) * 4, (0,) * 4)
        for value in (variance_V2, FILE_NOISE_V**2)
    )
    found = []
    for measurement in (*[noisy] * (periods - 1), calm, *[noisy] * periods):
        statistics.learn(measurement, 0, is_used=True)
        found.append(statistics.is_noisy())
    assert found == [False] * (2 * periods - 1) + [True]
    statistics.accept_noise()
    statistics.learn(noisy, 0, is_used=True)
    assert not statistics.is_noisy()


@pytest.mark.parametrize("noise_V", [0.1, 0.2])
def test_a_sensor_known_for_its_noise_is_not_nonsense(noise_V: float) -> None:
    sensor, statistics = Sensor(noise_V, 7), SensorStatistics(FILE_NOISE_V**2)
    for _ in range(20):
        statistics.learn(sensor.period(5.0), 0, is_used=True)
        if statistics.is_noisy():
            statistics.accept_noise()
    for _ in range(5000):
        statistics.learn(sensor.period(5.0), 0, is_used=True)
        assert not statistics.is_garbage()
    sensor.noise_V = 3.0
    statistics.learn(sensor.period(5.0), 0, is_used=True)
    assert statistics.is_garbage()
