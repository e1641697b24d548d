import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from hil.core.diagnosis.glr.filter import _limit
from hil.core.diagnosis.glr.model import (
    BEND,
    BIAS,
    DRIFT,
    GAIN,
    LAG,
    LEAK,
    MOVING,
    OUTLET,
    PUMP,
    RATE,
    SCALE,
    SPLIT,
    ZONE,
    N,
    flow_voltage,
    predict,
)
from tests.glr.glr_bench import DETECTOR, MODEL, NO_ESTIMATE, PERIOD_S, Plant

FILTER_MODEL = DETECTOR.config.model


def a_state(random: np.random.Generator) -> np.ndarray:
    x = np.zeros(N)
    x[0:4] = random.uniform(0.5, 18.0, 4)
    x[PUMP:GAIN] = random.uniform(0.0, 9.0, 2)
    x[GAIN:LEAK] = random.uniform(0.7, 1.3, LEAK - GAIN)
    x[LEAK:BIAS] = random.uniform(0.0, 0.4, 2)
    x[BIAS:DRIFT] = random.normal(0.0, 0.1, 4)
    x[DRIFT:RATE] = random.normal(0.0, 0.01, 4)
    x[ZONE:BEND] = random.uniform(-0.2, 0.5, 2)
    x[BEND:SCALE] = random.uniform(-0.03, 0.03, 2)
    x[SCALE:N] = random.uniform(0.7, 1.3, 2)
    return x


def derivative(x: npt.NDArray[np.float64], volts: npt.NDArray[np.float64], period_s: float, j: int) -> np.ndarray:
    """Of the predicted levels and lagged voltages by state j, central difference, (MOVING,)."""
    step, ends = 1e-5, []
    for sign in (1.0, -1.0):
        moved = x.copy()
        moved[j] += sign * step
        predict(FILTER_MODEL, moved, np.zeros(2), volts, period_s, np.zeros((MOVING, N)))
        ends.append(moved[:MOVING])
    return (ends[0] - ends[1]) / (2.0 * step)


@pytest.mark.parametrize("voltage_V", [0.05, 0.2, 0.29, 0.35, 0.6, 1.2, 3.0])
@pytest.mark.parametrize("std_V", [0.0, 0.05, 0.2])
def test_what_a_pump_gives_near_the_end_of_its_dead_zone_is_the_mean_over_where_that_may_be(
    voltage_V: float, std_V: float
) -> None:
    """With a corner, or a fixed width, a pump that gave nothing proved a dead zone that ended just there."""
    x = np.zeros(N)
    x[ZONE], x[SCALE] = 0.3, 1.0
    zones_V = 0.3 + std_V * norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    over_V = np.maximum(voltage_V - zones_V, 0.0)
    given_V, by_zone, by_bend = flow_voltage(x, 0, voltage_V, std_V)
    assert given_V == pytest.approx(over_V.mean(), abs=1e-5)
    assert by_bend == pytest.approx(over_V.mean() ** 2, abs=1e-5)
    assert by_zone == pytest.approx(-(voltage_V > zones_V).mean(), abs=1e-3)
    assert flow_voltage(x, 0, 0.0, std_V) == (0.0, 0.0, 0.0)


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_the_transition_matrix_is_the_derivative_of_the_prediction(seed: int) -> None:
    """A bound of 2e-3 alone, beside entries of 0.004, once let a coupling pass that was 20 % too large.

    Rows are those of an Euler step, the prediction is a midpoint's: they differ by the square of the period. So a short
    period shows each entry to a per cent, and one of the bench's length that nothing else differs.
    """
    random = np.random.default_rng(seed)
    x, volts = a_state(random), random.uniform(0.8, 9.0, 2)  # nearer the dead zone's end the derivative is a mean
    short_s = 1e-3
    for period_s, rel, at_least in ((short_s, 0.01, 2e-7), (PERIOD_S, 0.0, 2e-3)):
        A = np.zeros((MOVING, N))
        predict(FILTER_MODEL, x.copy(), np.zeros(2), volts, period_s, A)
        for j in range(N):
            same = np.eye(MOVING, N)[:, j]
            found = derivative(x, volts, period_s, j) - same
            assert found == pytest.approx(A[:, j] - same, rel=rel, abs=at_least)


def test_the_prediction_is_eq_1() -> None:
    from scipy.integrate import solve_ivp

    x, volts = a_state(np.random.default_rng(3)), np.array([4.0, 2.0])
    area, speed = np.array(MODEL.area_cm2), np.sqrt(2.0 * MODEL.gravity_cm_s2)
    over = volts - x[ZONE:BEND]
    drive = over * (1.0 + x[BEND:SCALE] * over)

    def slope(_: float, z: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        h, p = z[:4], z[4:]
        pumped = np.array(MODEL.pump_gain_cm3_Vs) * x[GAIN:SPLIT] * x[SCALE:N] * p
        split = np.array(MODEL.valve_split) * x[SPLIT:LAG]
        out = np.array(MODEL.outlet_cm2) * x[OUTLET:LEAK] * speed * np.sqrt(h)
        lost = np.array(MODEL.outlet_cm2)[2:] * speed * np.sqrt(h[2:]) * x[LEAK:BIAS]
        inflow = np.concatenate([split * pumped + out[2:], ((1.0 - split) * pumped)[::-1]])
        rate = inflow - out
        rate[2:] -= lost
        return np.concatenate([rate / area, (drive - p) / (0.2 * x[LAG:OUTLET])])

    exact = solve_ivp(slope, (0.0, PERIOD_S), x[:6], rtol=1e-10, atol=1e-12).y[:, -1]
    predict(FILTER_MODEL, x, np.zeros(2), volts, PERIOD_S, np.zeros((MOVING, N)))
    assert x[:6] == pytest.approx(exact, abs=2e-5)


@pytest.mark.parametrize(
    "seed", [11, pytest.param(12, marks=pytest.mark.long), pytest.param(13, marks=pytest.mark.long)]
)
def test_innovations_are_white_and_as_large_as_the_filter_says(seed: int) -> None:
    plant, squares, products = Plant(seed), [], []
    memory, last = None, np.zeros(4)
    for number in range(3000):
        volts = (3.0 + 0.5 * np.sin(number / 90.0), 3.0 + 0.5 * np.cos(number / 130.0))
        memory, _ = DETECTOR.step(memory, number * PERIOD_S, plant.period(volts), NO_ESTIMATE, volts)
        if number > 300:
            white = memory.result.whitener @ memory.result.innovation
            squares.append(white**2)
            products.append(white * last)
            last = white
    assert np.mean(squares, axis=0) == pytest.approx(np.ones(4), abs=0.15)
    assert np.mean(products, axis=0) == pytest.approx(np.zeros(4), abs=0.08)


def test_parameters_of_the_rig_are_learned() -> None:
    plant, memory = Plant(5), None
    for number in range(4000):
        volts = (3.0 + 0.8 * np.sin(number / 150.0), 3.0 + 0.8 * np.cos(number / 200.0))
        memory, _ = DETECTOR.step(memory, number * PERIOD_S, plant.period(volts), NO_ESTIMATE, volts)
    inflow = plant.gain * plant.split / np.array(MODEL.pump_gain_cm3_Vs) / np.array(MODEL.valve_split)
    assert memory is not None
    given = np.array([flow_voltage(memory.x, pump, 3.0, 0.0)[0] / 3.0 for pump in (0, 1)])
    assert memory.x[SCALE:N] * given * memory.x[SPLIT:LAG] == pytest.approx(inflow, abs=0.006)
    assert memory.x[OUTLET:LEAK] == pytest.approx(plant.outlet / np.array(MODEL.outlet_cm2), abs=0.012)


def test_the_covariance_stays_symmetric_and_positive() -> None:
    plant, memory = Plant(6), None
    for number in range(2000):
        memory, _ = DETECTOR.step(memory, number * PERIOD_S, plant.period((3.0, 3.0)), NO_ESTIMATE, (3.0, 3.0))
    assert memory is not None
    active = np.flatnonzero(np.diag(memory.P))
    assert np.array_equal(memory.P, memory.P.T)
    assert np.linalg.eigvalsh(memory.P[np.ix_(active, active)]).min() > -1e-12
    assert not memory.P[BIAS:ZONE].any()
    assert not memory.P[GAIN:SPLIT].any()


def test_the_states_stay_within_their_limits() -> None:
    """A shut outlet may come out a little below zero, since its estimate errs to either side."""
    x = np.zeros(N)
    x[0:4] = -1.0, 5.0, 25.0, 0.0
    x[OUTLET : OUTLET + 4] = -1.0, -0.01, 0.0, 3.0
    x[LAG : LAG + 2], x[SPLIT : SPLIT + 2] = (0.0, 99.0), (-1.0, 9.0)
    _limit(FILTER_MODEL, x)
    assert list(x[0:4]) == [0.0, 5.0, MODEL.height_cm[2], 0.0]
    assert list(x[OUTLET : OUTLET + 4]) == [-0.02, -0.01, 0.0, 3.0]
    assert list(x[LAG : LAG + 2]) == [0.05, 75.0]
    assert list(x[SPLIT : SPLIT + 2] * MODEL.valve_split) == pytest.approx([0.01 * MODEL.valve_split[0], 0.99])
