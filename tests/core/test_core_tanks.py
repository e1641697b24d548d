"""Tanks of the controller: equilibrium, mass balance, linear model, zeros, reachable levels."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.reachable import nearest_reachable
from hil.core.tanks import (
    LinearModel,
    TankModel,
    equilibrium,
    holding_voltages,
    level_rates,
    linearise,
    printed_linear_model,
    pump_matrix,
    through_flow_matrix,
    transmission_zeros,
)
from hil.core.types import Pair, Quad
from tests.core.core_bench import BENCH, OUTFLOW, at
from tests.narrowing import pair, quad

LEVEL = st.floats(0.05, 20.0)
VOLT = st.floats(0.5, 10.0)
SPLIT = st.floats(0.05, 0.95)


@st.composite
def tank_models(draw: st.DrawFn) -> TankModel:
    """Quadruple tanks of any size, with the two lower levels at least a little independent."""
    areas = st.floats(5.0, 100.0)
    outlets = st.floats(0.02, 0.5)
    splits = draw(st.tuples(SPLIT, SPLIT).filter(lambda s: abs(sum(s) - 1.0) > 0.02))
    return TankModel(
        area_cm2=draw(st.tuples(areas, areas, areas, areas)),
        outlet_cm2=draw(st.tuples(outlets, outlets, outlets, outlets)),
        pump_gain_cm3_Vs=draw(st.tuples(st.floats(1.0, 10.0), st.floats(1.0, 10.0))),
        valve_split=splits,
        level_gain_V_cm=draw(st.floats(0.1, 2.0)),
    )


def test_bench_equilibrium_at_3_volts_is_the_papers_but_for_its_rounding() -> None:
    levels = equilibrium(BENCH, (3.0, 3.0))
    assert levels == pytest.approx((12.263, 12.783, 1.634, 1.409), abs=5e-4)
    assert levels == pytest.approx((12.4, 12.7, 1.8, 1.4), abs=0.2)


@settings(max_examples=60)
@given(tank_models(), VOLT, VOLT)
def test_levels_stand_still_at_an_equilibrium(model: TankModel, v1: float, v2: float) -> None:
    levels = equilibrium(model, (v1, v2))
    inflow = float(np.sum(pump_matrix(model) @ [v1, v2]))
    assert level_rates(model, levels, (v1, v2)) == pytest.approx((0, 0, 0, 0), abs=1e-12 * inflow)


@settings(max_examples=60)
@given(tank_models(), VOLT, VOLT)
def test_holding_voltages_undo_the_equilibrium(model: TankModel, v1: float, v2: float) -> None:
    h1, h2, _, _ = equilibrium(model, (v1, v2))
    assert holding_voltages(model, (h1, h2)) == pytest.approx((v1, v2), rel=1e-9, abs=1e-9)


def test_no_voltage_means_empty_tanks() -> None:
    assert equilibrium(BENCH, (0.0, 0.0)) == (0.0, 0.0, 0.0, 0.0)
    assert holding_voltages(BENCH, (0.0, 0.0)) == (0.0, 0.0)
    assert level_rates(BENCH, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0)) == (0.0, 0.0, 0.0, 0.0)


@settings(max_examples=60)
@given(tank_models(), st.tuples(*[st.floats(0.0, 20.0)] * 4), st.tuples(*[st.floats(0.0, 10.0)] * 2))
def test_what_the_pumps_bring_and_the_lower_outlets_drain_is_what_the_tanks_gain(
    model: TankModel, levels: Quad, pump_V: Pair
) -> None:
    gained = sum(a * rate for a, rate in zip(model.area_cm2, level_rates(model, levels, pump_V), strict=True))
    pumped = sum(k * v for k, v in zip(model.pump_gain_cm3_Vs, pump_V, strict=True))
    drained = sum(model.outlet_cm2[i] * OUTFLOW * math.sqrt(levels[i]) for i in (0, 1))
    assert gained == pytest.approx(pumped - drained, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("tank", range(4))
def test_every_tank_feels_only_its_own_flows(tank: int) -> None:
    """Eq. (1) row by row: what a little more water in one tank does to all four."""
    levels = [9.0, 9.0, 4.0, 4.0]
    more = list(levels)
    more[tank] += 1.0
    before = level_rates(BENCH, quad(levels), (3.0, 3.0))
    after = level_rates(BENCH, quad(more), (3.0, 3.0))
    flow = BENCH.outlet_cm2[tank] * OUTFLOW * (math.sqrt(more[tank]) - math.sqrt(levels[tank]))
    expected = [0.0] * 4
    expected[tank] = -flow / BENCH.area_cm2[tank]
    if tank >= 2:
        expected[tank - 2] = flow / BENCH.area_cm2[tank - 2]
    assert np.subtract(after, before) == pytest.approx(expected, abs=1e-12)


def test_a_pump_feeds_its_lower_tank_and_the_opposite_upper_one() -> None:
    (k1, k2), (g1, g2) = BENCH.pump_gain_cm3_Vs, BENCH.valve_split
    A1, A2, A3, A4 = BENCH.area_cm2
    still = (0.0, 0.0, 0.0, 0.0)
    assert level_rates(BENCH, still, (2.0, 0.0)) == pytest.approx((2 * g1 * k1 / A1, 0, 0, 2 * (1 - g1) * k1 / A4))
    assert level_rates(BENCH, still, (0.0, 2.0)) == pytest.approx((0, 2 * g2 * k2 / A2, 2 * (1 - g2) * k2 / A3, 0))


def test_at_rest_all_that_is_pumped_leaves_through_the_lower_outlets() -> None:
    assert through_flow_matrix(BENCH)[:2].sum(axis=0) == pytest.approx(BENCH.pump_gain_cm3_Vs)


@settings(max_examples=60)
@given(tank_models(), st.tuples(LEVEL, LEVEL, LEVEL, LEVEL), VOLT, VOLT)
def test_linear_model_is_the_derivative_of_the_rates(model: TankModel, levels: Quad, v1: float, v2: float) -> None:
    linear = linearise(model, levels)

    def difference(i: int, step: float, of_levels: bool) -> npt.NDArray[np.float64]:
        up, down = [*levels, v1, v2], [*levels, v1, v2]
        index = i if of_levels else 4 + i
        up[index] += step
        down[index] -= step
        rates = [np.array(level_rates(model, quad(x[:4]), pair(x[4:]))) for x in (up, down)]
        slope: npt.NDArray[np.float64] = (rates[0] - rates[1]) / (2.0 * step)
        return slope

    for i in range(4):
        column = difference(i, 1e-3 * levels[i], of_levels=True)
        assert linear.A[:, i] == pytest.approx(column, rel=1e-5, abs=1e-8)
    for i in range(2):
        assert linear.B[:, i] == pytest.approx(difference(i, 0.1, of_levels=False), rel=1e-9, abs=1e-12)
    assert pytest.approx(np.array(levels[:2]) * model.level_gain_V_cm) == linear.C @ levels


def test_printed_model_is_the_linear_model_at_the_levels_of_table_2_to_its_rounding() -> None:
    linear, printed = linearise(BENCH, (12.4, 12.7, 1.8, 1.4)), printed_linear_model()
    assert pytest.approx(linear.A, abs=1.1e-4) == printed.A
    assert pytest.approx(linear.B, abs=0.6e-4) == printed.B
    assert np.array_equal(printed.C, linear.C)


def test_a_linear_model_can_not_be_written_to() -> None:
    source = np.eye(4)
    model = LinearModel(source, np.ones((4, 2)), np.ones((2, 4)))
    source[0, 0] = 7.0
    assert model.A[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        model.A[0, 0] = 2.0


def rosenbrock_zeros(linear: LinearModel) -> Any:
    """Generalised eigenvalues of [A - sI, B; C, 0]: the finite ones are the transmission zeros."""
    M = np.block([[linear.A, linear.B], [linear.C, np.zeros((2, 2))]])
    N = np.zeros((6, 6))
    N[:4, :4] = np.eye(4)
    alpha, beta = scipy.linalg.eigvals(M, N, homogeneous_eigvals=True)
    finite = np.argsort(np.abs(alpha) / np.maximum(np.abs(beta), 1e-300))[:2]
    return np.sort((alpha[finite] / beta[finite]).real)


def test_zeros_of_the_printed_model() -> None:
    assert transmission_zeros(printed_linear_model()) == pytest.approx([-0.0580, -0.0172], abs=5e-5)


@settings(max_examples=60)
@given(tank_models(), VOLT, VOLT)
def test_zeros_are_those_of_the_rosenbrock_pencil(model: TankModel, v1: float, v2: float) -> None:
    linear = at((v1, v2), model)
    scale = np.abs(linear.A).max()
    assert transmission_zeros(linear) / scale == pytest.approx(rosenbrock_zeros(linear) / scale, abs=1e-7)


@settings(max_examples=60)
@given(tank_models(), VOLT, VOLT)
def test_valves_that_send_more_up_than_down_make_the_process_non_minimum_phase(
    model: TankModel, v1: float, v2: float
) -> None:
    zeros = transmission_zeros(at((v1, v2), model))
    assert zeros[0] < 0.0
    assert (zeros[1] > 0.0) == (sum(model.valve_split) < 1.0)


@settings(max_examples=40)
@given(st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_levels_that_the_pumps_can_hold_are_left_alone(v1: float, v2: float) -> None:
    h1, h2, _, _ = equilibrium(BENCH, (v1, v2))
    target = nearest_reachable(BENCH, (h1, h2), (10.0, 10.0))
    assert target.lower_cm == (h1, h2)
    assert target.holding_V == pytest.approx((v1, v2), abs=1e-9)
    assert target.reason == ""


GRID = np.linspace(0.0, 1.0, 401)


def nearest_on_a_grid(model: TankModel, lower_cm: Pair, limit_V: Pair) -> float:
    flow = through_flow_matrix(model)[:2] / (np.array(model.outlet_cm2[:2])[:, None] * OUTFLOW)
    v1, v2 = np.meshgrid(GRID * limit_V[0], GRID * limit_V[1])
    h1 = (flow[0, 0] * v1 + flow[0, 1] * v2) ** 2
    h2 = (flow[1, 0] * v1 + flow[1, 1] * v2) ** 2
    return float(np.sqrt(((h1 - lower_cm[0]) ** 2 + (h2 - lower_cm[1]) ** 2).min()))


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.0, 40.0),
    st.floats(0.0, 40.0),
    st.floats(0.0, 10.0),
    st.floats(0.0, 10.0),
    st.sampled_from([(0.7, 0.6), (0.43, 0.34)]),
)
def test_levels_out_of_reach_move_to_the_nearest_in_reach(
    h1: float, h2: float, limit1: float, limit2: float, splits: Pair
) -> None:
    model = replace(BENCH, valve_split=splits)
    target = nearest_reachable(model, (h1, h2), (limit1, limit2))
    held = equilibrium(model, pair(max(v, 0.0) for v in target.holding_V))
    assert held[:2] == pytest.approx(target.lower_cm, abs=1e-6)
    if target.reason == "":
        return
    assert 0.0 <= target.holding_V[0] <= limit1
    assert 0.0 <= target.holding_V[1] <= limit2
    distance = math.dist(target.lower_cm, (h1, h2))
    assert distance <= nearest_on_a_grid(model, (h1, h2), (limit1, limit2)) + 1e-9


def test_reason_names_the_pump_that_is_too_weak_and_its_voltages() -> None:
    h1, h2, _, _ = equilibrium(BENCH, (4.0, 3.0))
    target = nearest_reachable(BENCH, (h1, h2), (2.5, 10.0))
    assert target.reason == "pump 1 would need 4.00 V of 2.50 V"
    target = nearest_reachable(BENCH, (h1, h2), (2.5, 1.25))
    assert target.reason == "pump 1 would need 4.00 V of 2.50 V; pump 2 would need 3.00 V of 1.25 V"
    assert target.holding_V == (2.5, 1.25)


def test_reason_names_a_pump_that_would_have_to_suck() -> None:
    target = nearest_reachable(BENCH, (18.0, 1.0), (10.0, 10.0))
    assert "pump 2 would need -" in target.reason
    assert target.reason.endswith("below 0 V")
    assert target.holding_V[1] == 0.0


def test_a_dead_pump_leaves_one_line_of_levels() -> None:
    h1, h2, _, _ = equilibrium(BENCH, (3.0, 3.0))
    target = nearest_reachable(BENCH, (h1, h2), (0.0, 10.0))
    assert target.holding_V[0] == 0.0
    assert 3.0 < target.holding_V[1] < 10.0
    both_dead = nearest_reachable(BENCH, (h1, h2), (0.0, 0.0))
    assert both_dead.holding_V == (0.0, 0.0)
    assert both_dead.lower_cm == (0.0, 0.0)


@pytest.mark.parametrize("voltages", [(-0.1, 3.0), (3.0, -1e-9)])
def test_no_equilibrium_for_a_negative_voltage(voltages: Pair) -> None:
    with pytest.raises(ValueError, match="below 0 V"):
        equilibrium(BENCH, voltages)


@pytest.mark.parametrize("levels", [(-0.1, 3.0), (3.0, -0.1)])
def test_no_voltage_holds_a_negative_level(levels: Pair) -> None:
    with pytest.raises(ValueError, match="below 0 cm"):
        holding_voltages(BENCH, levels)
    with pytest.raises(ValueError, match="below 0 cm"):
        nearest_reachable(BENCH, levels, (10.0, 10.0))


def test_valves_that_add_up_to_one_can_not_set_the_lower_levels_apart() -> None:
    with pytest.raises(ValueError, match="add up to 1"):
        holding_voltages(replace(BENCH, valve_split=(0.7, 0.3)), (10.0, 10.0))


@pytest.mark.parametrize("tank", range(4))
def test_an_empty_tank_has_no_linear_model(tank: int) -> None:
    levels = [5.0] * 4
    levels[tank] = 0.0
    with pytest.raises(ValueError, match="empty tank"):
        linearise(BENCH, quad(levels))
