"""Bounds of a zero in the right half plane, against responses that obey them and one that reaches them."""

from math import exp, log

import numpy as np
import pytest
from scipy.linalg import expm

from hil.core.eigenstructure import augment
from hil.core.nonminimum_phase import NonMinimumPhaseDesign
from hil.core.tanks import Array, TankModel, transmission_zeros
from hil.core.types import Pair
from hil.core.zero_bounds import ZeroBound, zero_bound
from tests.core.core_bench import at

LINEAR = at((3.15, 3.15), TankModel(pump_gain_cm3_Vs=(3.14, 3.29), valve_split=(0.43, 0.34)))
BOUND = zero_bound(LINEAR) or ZeroBound(0.0, (0.0, 0.0))
STEP_S = 0.2
STEPS = [(0.3, 0.0), (0.0, 0.3), (0.3, 0.3), (0.3, -0.3)]


def response(weight: float, reference: Pair, length_s: float = 900.0) -> Array:
    """(n, 2) outputs of the quadratic design from rest, every STEP_S after the step."""
    A, B = augment(LINEAR)
    whole = np.zeros((7, 7))
    whole[:6, :6] = A - B @ NonMinimumPhaseDesign(weight).feedback(LINEAR)
    whole[4:6, 6] = reference
    state, over = np.array([0.0] * 6 + [1.0]), expm(whole * STEP_S)
    outputs = []
    for _ in range(round(length_s / STEP_S)):
        outputs.append(0.5 * state[:2])
        state = over @ state
    return np.array(outputs)


def test_there_is_a_bound_only_with_an_unstable_zero() -> None:
    assert zero_bound(at()) is None
    assert BOUND.zero_1_s == pytest.approx(transmission_zeros(LINEAR).max())


def test_the_direction_makes_the_zero_block_the_process() -> None:
    G = LINEAR.C @ np.linalg.solve(BOUND.zero_1_s * np.eye(4) - LINEAR.A, LINEAR.B)
    assert np.array(BOUND.direction) @ G == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.hypot(*BOUND.direction) == pytest.approx(1.0)
    assert BOUND.direction[0] < 0.0 < BOUND.direction[1], "levels that move together hardly meet the zero"


@pytest.mark.parametrize("step", STEPS)
def test_the_weighted_output_goes_the_wrong_way_first(step: Pair) -> None:
    """The integral behind all bounds: e^(-z t) eta' y adds up to nothing."""
    outputs = response(1.0, step)
    times = np.arange(len(outputs)) * STEP_S
    weighted = outputs @ np.array(BOUND.direction)
    total = np.sum(np.exp(-BOUND.zero_1_s * times) * weighted) * STEP_S
    assert abs(total) < 1e-3 * abs(BOUND.weighted(step)) / BOUND.zero_1_s


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("weight", [0.1, 1.0, 100.0])
def test_no_response_is_better_than_the_bounds(step: Pair, weight: float) -> None:
    outputs = response(weight, step)
    errors = np.array(step) - outputs
    assert np.sum(errors**2) * STEP_S > BOUND.least_squared_error(step)
    settled_s = (np.flatnonzero(np.any(np.abs(errors) > 0.02, axis=1))[-1] + 1) * STEP_S
    wrong_way = BOUND.wrong_way_V(step, outputs)
    assert settled_s > BOUND.least_settling_s(step, wrong_way, 0.02)
    assert wrong_way > BOUND.least_wrong_way_V(step, settled_s, 0.02)


def test_commands_that_cost_nothing_reach_the_least_squared_error() -> None:
    step = (0.3, -0.3)
    errors = np.array(step) - response(1e6, step)
    assert np.sum(errors**2) * STEP_S == pytest.approx(BOUND.least_squared_error(step), rel=0.2)


def test_the_two_forms_of_the_settling_bound_are_one() -> None:
    settled_s = BOUND.least_settling_s((0.3, 0.0), 0.1, 0.02)
    assert BOUND.least_wrong_way_V((0.3, 0.0), settled_s, 0.02) == pytest.approx(0.1)
    unit = ZeroBound(0.01, (0.0, 1.0))
    assert unit.least_settling_s((0.0, 1.0), 1.0, 0.0) == pytest.approx(100.0 * log(2.0))
    assert unit.least_wrong_way_V((0.0, 1.0), 100.0, 0.0) == pytest.approx(1.0 / (exp(1.0) - 1.0))
    assert unit.least_settling_s((1.0, 0.0), 0.0, 0.0) == 0.0, "the zero does not concern this step"
    assert unit.least_settling_s((0.0, 1.0), 0.0, 0.0) == np.inf
    assert unit.least_wrong_way_V((0.0, 1.0), 0.0, 0.0) == np.inf


def test_a_sensitivity_that_is_small_up_to_the_zero_has_a_peak() -> None:
    """Half at all frequencies up to the zero: q = pi/2, so the peak is at least 2; never below 1."""
    assert BOUND.least_peak(0.5, BOUND.zero_1_s) == pytest.approx(2.0)
    assert BOUND.least_peak(1.0, BOUND.zero_1_s) == 1.0
    assert BOUND.least_peak(0.5, 0.0) == 1.0
