"""The replay by itself: filters taken on by hand, one period at a time."""

import numpy as np
import pytest

from hil.core.diagnosis.glr.filter import PERIOD, READING, VARIANCE, VOLTAGE, WEIGHT
from hil.core.diagnosis.glr.growth import NO_GROWTH
from hil.core.diagnosis.glr.hypotheses import BIAS_PRIOR_V, JUMPS
from hil.core.diagnosis.glr.model import BIAS, GAIN, LEAK, SCALE, N
from hil.core.diagnosis.glr.refilter import History, Replays, catch_up
from tests.glr.glr_bench import DETECTOR, PERIOD_S

SENSOR = 2
BIAS_OF_SENSOR = next(i for i, jump in enumerate(JUMPS) if jump.state == BIAS + SENSOR)


def a_history(steps: int) -> History:
    """Readings of 5 V in every tank, the filter sure of all states."""
    history = History.empty()
    for step in range(1, steps + 1):
        entry = history.entries[step]
        entry[VOLTAGE : VOLTAGE + 2], entry[READING : READING + 4], entry[VARIANCE : VARIANCE + 4] = 3.0, 5.0, 1e-5
        entry[PERIOD], entry[WEIGHT] = PERIOD_S, 0.5
    history.x[0][0:4], history.x[0][GAIN:LEAK], history.x[0][SCALE:] = 10.0, 1.0, 1.0
    history.P[0] = 1e-8 * np.eye(N)
    return history


def test_the_period_in_which_a_bias_begins_teaches_nothing_of_its_size() -> None:
    """The mean of that period's readings holds only part of the bias, which would come out too small."""
    history, replays = a_history(2), Replays.empty()
    replays.begin(0, BIAS_OF_SENSOR, -1, history, 0, 0, np.zeros(8), NO_GROWTH)
    variances = []
    for step in (1, 2):
        assert catch_up(DETECTOR.config.model, history, replays, 1, step, 10) == 0
        variances.append(replays.P[0][BIAS + SENSOR, BIAS + SENSOR])
    assert variances[0] == pytest.approx(BIAS_PRIOR_V**2)
    assert variances[1] < 1e-3 * variances[0]


def test_it_is_the_first_period_in_which_the_sensor_is_read() -> None:
    """A bias of 0.62 V on the sensor of an empty tank, which is not read, was unknown, and the run stopped."""
    history, replays = a_history(4), Replays.empty()
    history.entries[1:3, READING + SENSOR] = np.nan
    replays.begin(0, BIAS_OF_SENSOR, -1, history, 0, 0, np.zeros(8), NO_GROWTH)
    variances = []
    for step in range(1, 5):
        assert catch_up(DETECTOR.config.model, history, replays, 1, step, 10) == 0
        variances.append(replays.P[0][BIAS + SENSOR, BIAS + SENSOR])
    assert variances[:3] == pytest.approx([BIAS_PRIOR_V**2] * 3)
    assert variances[3] < 1e-3 * variances[2]
