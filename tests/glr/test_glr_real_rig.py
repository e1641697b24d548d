"""The filter of the diagnosis on a rig as it is: datums, a lag each, sensors with a noise each, and its prior."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.diagnosis.glr import inflow_check
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, READING, VOLTAGE
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import GAIN, LAG, LEAK, LEVEL, MOVING, OUTLET, PUMP, SCALE, SPLIT, N, predict
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.sensors import LevelSensors
from hil.core.tanks import level_rates
from hil.core.types import Measurement
from hil.core.uncertainty import Uncertainty
from tests.glr.glr_bench import ALL, MODEL, PERIOD_S
from tests.glr.test_glr_filter import a_state
from tests.narrowing import quad

DEEP = replace(MODEL, datum_cm=(5.0, 4.0, 3.0, 2.0), height_cm=(20.0, 21.0, 22.0, 23.0))
MIXED = LevelSensors((-0.45, 0.5, 0.05, -0.05), (9.5, 0.1, -1.0, 10.34))
NOISE = (0.0045, 0.005, 0.0005, 0.001)
CONFIG = DetectorConfig.of(DEEP, (0.3, 0.6), MIXED.scaled(NOISE), Tuning(), sensors=MIXED)
PLAIN = DetectorConfig.of(MODEL, (0.2, 0.2), (0.005,) * 4, Tuning())


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_the_transition_matrix_is_the_derivative_of_the_prediction(seed: int) -> None:
    random = np.random.default_rng(seed)
    x, volts = a_state(random), random.uniform(0.8, 9.0, 2)  # nearer the dead zone's end the derivative is a mean
    A = np.zeros((MOVING, N))
    predict(CONFIG.model, x.copy(), np.zeros(2), volts, 1e-3, A)
    for j in range(N):
        ends = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[j] += sign * 1e-5
            predict(CONFIG.model, moved, np.zeros(2), volts, 1e-3, np.zeros((MOVING, N)))
            ends.append(moved[:MOVING])
        same = np.eye(MOVING, N)[:, j]
        assert (ends[0] - ends[1]) / 2e-5 - same == pytest.approx(A[:, j] - same, rel=0.01, abs=2e-7)


def healthy(level_cm: tuple[float, ...], volts: tuple[float, float]) -> np.ndarray:
    x = np.zeros(N)
    x[LEVEL : LEVEL + 4], x[PUMP : PUMP + 2], x[GAIN:LEAK], x[SCALE:] = level_cm, volts, 1.0, 1.0
    return x


@pytest.mark.parametrize("level_cm", [(9.0, 8.0, 3.0, 2.0), (9.0, 8.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
@pytest.mark.parametrize("volts", [(0.5, 0.5), (3.0, 3.0), (8.0, 8.0)])
def test_the_prediction_is_that_of_the_tanks_empty_ones_included(
    level_cm: tuple[float, float, float, float], volts: tuple[float, float]
) -> None:
    x, level = healthy(level_cm, volts), level_cm
    for _ in range(20):
        predict(CONFIG.model, x, np.zeros(2), np.array(volts), 0.001, np.zeros((MOVING, N)))
        rates = level_rates(DEEP, level, volts)
        level = quad(max(h + 0.001 * rate, 0.0) for h, rate in zip(level, rates, strict=True))
    assert x[LEVEL : LEVEL + 4] == pytest.approx(level, abs=2e-4)


@pytest.mark.parametrize("leak", [0.0, 0.3])
def test_what_an_empty_tank_passes_on_is_known_to_the_transition_matrix(leak: float) -> None:
    """The lower tanks' levels depend on the other pump's voltage, gain, split and lag, no more on the level above."""
    x, volts = healthy((9.0, 8.0, 0.0, 0.0), (1.0, 0.8)), np.array([1.5, 0.5])
    x[LEAK : LEAK + 2] = leak
    A = np.zeros((MOVING, N))
    predict(CONFIG.model, x.copy(), np.zeros(2), volts, 1e-3, A)
    for j in [*range(PUMP, OUTLET)]:
        ends = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[j] += sign * 1e-5
            predict(CONFIG.model, moved, np.zeros(2), volts, 1e-3, np.zeros((MOVING, N)))
            ends.append(moved[:PUMP])
        assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(A[:PUMP, j], rel=0.01, abs=2e-7)
    assert A[0, 2] == A[1, 3] == A[0, OUTLET + 2] == A[1, OUTLET + 3] == 0.0


def test_no_level_is_predicted_over_its_own_rim() -> None:
    x = healthy((19.99, 20.99, 21.99, 22.99), (10.0, 10.0))
    x[OUTLET : OUTLET + 4] = 0.0
    predict(CONFIG.model, x, np.zeros(2), np.array([10.0, 10.0]), 1.0, np.zeros((MOVING, N)))
    assert list(x[LEVEL : LEVEL + 4]) == [20.0, 21.0, 22.0, 23.0]


def test_each_pump_has_its_own_lag() -> None:
    x = healthy((5.0, 5.0, 5.0, 5.0), (0.0, 0.0))
    predict(CONFIG.model, x, np.zeros(2), np.array([4.0, 4.0]), 0.3, np.zeros((MOVING, N)))
    assert x[PUMP : PUMP + 2] == pytest.approx([4.0 * (1.0 - math.exp(-1.0)), 4.0 * (1.0 - math.exp(-0.5))])


def test_noise_floor_and_empty_level_are_those_of_each_sensor() -> None:
    """Sensor 3 leaves its range 1 V before its tank is empty, sensor 4 0.1 V; the noise of 1 and 2 is not cut off."""
    assert CONFIG.noise_V == pytest.approx((0.005, 0.005, 0.005, 0.01))
    floor = Tuning().reading_floor_V
    assert CONFIG.floor_V2 == pytest.approx([(floor * f) ** 2 for f in (0.5 / 0.45, 1.0, 10.0, 10.0)])
    low = [-0.74 * 0.5 / 0.45, -0.1, 10.0 * 1.0, 10.0 * 0.1]
    assert CONFIG.empty_V == pytest.approx([a + 6.0 * n for a, n in zip(low, CONFIG.noise_V, strict=True)])
    assert (PLAIN.noise_V, PLAIN.empty_V) == ((0.005,) * 4, (6.0 * 0.005,) * 4)
    assert PLAIN.floor_V2 == (floor**2,) * 4
    reading = Measurement((5.0, 5.0, 1.0, 1.0), ALL, 0.0, 5)
    memory = Memory.begin(CONFIG, 0.0, reading, (0.0, 0.0))
    assert [sensor.variance_V2 for sensor in memory.sensors] == pytest.approx([n**2 for n in CONFIG.noise_V])
    assert memory.P[3, 3] == pytest.approx((0.01**2 / 5 + 0.005**2) / 0.25)


def test_the_prior_is_what_the_rig_file_says_and_the_tunings_without_it() -> None:
    doubt = Uncertainty((0.01, 0.02), (0.03, 0.04), (0.05, 0.06, 0.07, 0.08), (0.9, 1.1))
    config = DetectorConfig.of(MODEL, (0.2, 0.2), (0.005,) * 4, Tuning(), uncertainty=doubt)
    reading = Measurement((5.0, 5.0, 1.0, 1.0), ALL, 0.0, 5)
    std = np.sqrt(np.diag(Memory.begin(config, 0.0, reading, (0.0, 0.0)).P))
    assert std[SCALE:] == pytest.approx([0.01, 0.02])
    assert std[SPLIT:LAG] == pytest.approx([0.03, 0.04])
    assert std[LAG:OUTLET] == pytest.approx([0.9, 1.1])
    assert std[OUTLET:LEAK] == pytest.approx([0.05, 0.06, 0.07, 0.08])
    usual = np.sqrt(np.diag(Memory.begin(PLAIN, 0.0, reading, (0.0, 0.0)).P))
    assert usual[SPLIT:LEAK] == pytest.approx([0.03] * 2 + [0.5] * 2 + [0.03] * 4)
    assert usual[SCALE:] == pytest.approx([0.03] * 2)
    assert not usual[LEAK:SCALE].any()
    assert not usual[GAIN:SPLIT].any()


@pytest.mark.parametrize(("share", "missing"), [(1.0, False), (0.1, True)])
def test_water_that_is_missing_is_missing_by_the_head(share: float, missing: bool) -> None:
    """Tank 4 stands still with this share of the outflow of its head; by the level alone it would look half empty."""
    level, volts = 2.0, 4.0
    flow = DEEP.outlet_cm2[3] * math.sqrt(2.0 * DEEP.gravity_cm_s2 * (level + DEEP.datum_cm[3]))
    model = replace(DEEP, pump_gain_cm3_Vs=(flow / (0.3 * volts) / share, 3.35))
    config = DetectorConfig.of(model, (0.2, 0.2), (0.005,) * 4, Tuning())
    m = Memory.begin(config, 0.0, Measurement((5.0, 5.0, 1.0, 1.0), ALL, 0.0, 5), (0.0, 0.0))
    for _ in range(20):
        m.now += 1
        m.entry[PERIOD], m.entry[VOLTAGE] = PERIOD_S, volts
        m.entry[READING : READING + 4] = (5.0, 5.0, 1.0, 0.5 * level)
    assert inflow_check.is_missing(config, m, 0) is missing
