"""The two designs: decoupling, noise, robustness against the loss of one pump, refusals."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import control
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.eigenstructure import DesignError, augment
from hil.core.gain_design import (
    Gains,
    RigDesign,
    choose_rig_design,
    closed_loop_poles,
    decoupling_parameters,
    noise_gain,
)
from hil.core.tanks import Array, LinearModel, equilibrium, linearise, printed_linear_model, transmission_zeros
from hil.core.types import Pair
from tests.core.core_bench import BENCH, CALIBRATED, NOISE_GAIN_MAX, OUTPUT_POLES, at, rig_design

CROSSED = replace(BENCH, valve_split=(0.43, 0.34))


def response(linear: LinearModel, K: Array, frequency_rad_s: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    """(2, 2, n) closed loop from r to y; q' = r - y drives the augmented model."""
    A, B = augment(linear)
    drive = np.vstack([np.zeros((4, 2)), np.eye(2)])
    system = control.ss(A - B @ K, drive, np.hstack([linear.C, np.zeros((2, 2))]), np.zeros((2, 2)))
    answer: npt.NDArray[Any] = control.frequency_response(system, frequency_rad_s).complex
    return answer


FREQUENCIES = np.geomspace(1e-4, 10.0, 40)


@pytest.mark.parametrize("voltage_V", [(3.0, 3.0), (2.0, 4.5), (6.0, 1.5)])
def test_each_reference_moves_only_its_own_output(voltage_V: Pair) -> None:
    linear = at(voltage_V)
    design = rig_design()
    y = response(linear, design.structure(linear).K, FREQUENCIES)
    assert np.abs(y[0, 1]).max() < 1e-9
    assert np.abs(y[1, 0]).max() < 1e-9
    for output, poles in enumerate(design.output_poles):
        s = 1j * FREQUENCIES
        expected = poles[0] * poles[1] / ((s - poles[0]) * (s - poles[1]))
        assert y[output, output] == pytest.approx(expected, abs=1e-9)


def test_calibrated_gain_lets_each_reference_move_both_outputs() -> None:
    """The measure of decoupling above can fail: the paper's gain is only nearly decoupling."""
    y = response(printed_linear_model(), CALIBRATED.structure().K, FREQUENCIES)
    assert np.abs(y[0, 1]).max() > 0.01


@pytest.mark.parametrize("voltage_V", [(3.0, 3.0), (2.0, 4.5), (9.0, 9.0)])
def test_rig_design_puts_its_poles_where_asked_and_the_rest_on_the_zeros(voltage_V: Pair) -> None:
    linear = at(voltage_V)
    design = rig_design()
    structure = design.structure(linear)
    wanted = sorted([*design.output_poles[0], *design.output_poles[1], *transmission_zeros(linear)])
    assert sorted(structure.achieved_poles.real) == pytest.approx(wanted, abs=1e-8)
    assert np.abs(structure.achieved_poles.imag).max() < 1e-8


def test_gains_do_not_jump_where_a_zero_crosses_an_output_pole() -> None:
    """The eigenvectors meet there, the gain does not notice: decoupling fixes it without them."""
    design = RigDesign(((-0.25, -0.06), (-0.18, -0.07)))
    near = min(np.linspace(2.9, 3.1, 2001), key=lambda v: abs(transmission_zeros(at((v, v)))[0] + 0.06))
    gains = [design.structure(at((near + d, near + d))).K for d in (-1e-4, 0.0, 1e-4)]
    assert gains[1] == pytest.approx((gains[0] + gains[2]) / 2.0, abs=1e-5)
    assert np.abs(gains[2] - gains[0]).max() < 1e-3


def test_decoupling_parameters_have_unit_length_and_hide_the_zeros() -> None:
    linear = at()
    zeros = transmission_zeros(linear)
    poles = np.array([-0.25, -0.06, -0.18, -0.07, *zeros])
    W = decoupling_parameters(linear, poles)
    assert np.linalg.norm(W, axis=0) == pytest.approx(np.ones(6))
    for pole, w, output in zip(poles, W.T, (0, 0, 1, 1, None, None), strict=True):
        y = linear.C @ np.linalg.solve(pole * np.eye(4) - linear.A, linear.B @ w)
        hidden = [0, 1] if output is None else [1 - output]
        assert np.abs(y[hidden]).max() < 1e-9


def test_noise_gain_is_what_a_monte_carlo_run_finds() -> None:
    rng = np.random.default_rng(20120401)
    K = rig_design().structure(at()).K
    sigma_V = 0.005
    noise_cm = rng.normal(0.0, sigma_V, (200_000, 4)) / BENCH.level_gain_V_cm
    found = (noise_cm @ K[:, :4].T).std(axis=0).max() / sigma_V
    assert found == pytest.approx(noise_gain(K, BENCH.level_gain_V_cm), rel=0.01)


def test_calibrated_gain_is_far_noisier_than_the_rigs() -> None:
    calibrated = noise_gain(CALIBRATED.structure().K, 0.5)
    assert calibrated == pytest.approx(2 * np.hypot(np.hypot(18.94148, 17.97382), np.hypot(0.89696, 1.54202)), rel=1e-5)
    assert calibrated > 5.0 * NOISE_GAIN_MAX


@pytest.mark.parametrize("bound", [10.0, 6.0, 4.0])
def test_noise_bound_is_met_by_slowing_all_poles_alike(bound: float) -> None:
    linear = at()
    design = choose_rig_design(linear, OUTPUT_POLES, bound)
    assert noise_gain(design.structure(linear).K, 0.5) <= bound
    chosen = sorted([*design.output_poles[0], *design.output_poles[1]])
    slowing = np.array(chosen) / sorted(OUTPUT_POLES)
    assert slowing == pytest.approx(np.full(4, slowing[0]))
    assert slowing[0] <= 1.0
    if slowing[0] < 1.0:
        before = [p * slowing[0] / 0.95 for p in OUTPUT_POLES]
        assert all(noise_gain(d.structure(linear).K, 0.5) > bound for d in all_pairings(before))


def all_pairings(poles: Sequence[float]) -> list[RigDesign]:
    a, b, c, d = poles
    pairs = [((a, b), (c, d)), ((a, c), (b, d)), ((a, d), (b, c))]
    return [RigDesign(p) for p in pairs] + [RigDesign((p[1], p[0])) for p in pairs]


def test_of_all_pairings_the_best_conditioned_is_chosen() -> None:
    linear = at()
    conditions = [d.structure(linear).cond_v for d in all_pairings(OUTPUT_POLES)]
    assert all(noise_gain(d.structure(linear).K, 0.5) <= 100.0 for d in all_pairings(OUTPUT_POLES))
    chosen = choose_rig_design(linear, OUTPUT_POLES, 100.0)
    assert chosen.structure(linear).cond_v == pytest.approx(min(conditions))
    assert max(conditions) > 1.1 * min(conditions)


def test_bench_poles_meet_the_bench_noise_bound() -> None:
    design = rig_design()
    assert sorted([*design.output_poles[0], *design.output_poles[1]]) == pytest.approx(sorted(OUTPUT_POLES))


def test_equal_poles_go_to_different_outputs() -> None:
    """A pairing with twice the same pole at one output used to refuse the whole choice."""
    design = choose_rig_design(at(), [-0.1, -0.1, -0.2, -0.2], NOISE_GAIN_MAX)
    assert sorted(design.output_poles[0]) == sorted(design.output_poles[1]) == [-0.2, -0.1]


@pytest.mark.parametrize("pump", [0, 1])
@pytest.mark.parametrize("voltage_V", [(3.0, 3.0), (2.0, 4.5), (4.5, 2.0)])
def test_rig_design_stays_stable_when_one_pump_loses_60_percent(pump: int, voltage_V: Pair) -> None:
    linear = at(voltage_V)
    effectiveness = (0.4, 1.0) if pump == 0 else (1.0, 0.4)
    assert closed_loop_poles(linear, rig_design().structure(linear).K, effectiveness)[0].real < -1e-3


def test_calibrated_gain_does_not_survive_the_loss_of_pump_1() -> None:
    K = CALIBRATED.structure().K
    assert closed_loop_poles(printed_linear_model(), K)[0].real < 0.0
    assert closed_loop_poles(printed_linear_model(), K, (0.4, 0.4))[0].real < 0.0
    assert closed_loop_poles(printed_linear_model(), K, (0.4, 1.0))[0].real > 0.0


def test_closed_loop_poles_come_slowest_first() -> None:
    structure = CALIBRATED.structure()
    found = closed_loop_poles(printed_linear_model(), structure.K)
    assert list(found.real) == sorted(found.real, reverse=True)
    assert sorted(found.real) == pytest.approx(sorted(structure.requested_poles), abs=1e-8)


@settings(max_examples=30, deadline=None)
@given(st.floats(1.0, 9.0), st.floats(1.0, 9.0))
def test_rescaled_gain_has_the_nominal_poles_at_any_effectiveness(e1: float, e2: float) -> None:
    linear = at()
    K = rig_design().structure(linear).K
    theta = np.array([e1, e2]) / 10.0
    rescaled = K / theta[:, None]
    nominal = closed_loop_poles(linear, K)
    assert closed_loop_poles(linear, rescaled, tuple(theta)) == pytest.approx(nominal, abs=1e-7)


def test_non_minimum_phase_valves_are_refused() -> None:
    linear = at((3.0, 3.0), CROSSED)
    with pytest.raises(DesignError, match=r"transmission zero at \+0\.0\d+ 1/s.*can't be decoupled stably"):
        rig_design().structure(linear)
    with pytest.raises(DesignError, match="can't be decoupled stably"):
        choose_rig_design(linear, OUTPUT_POLES, NOISE_GAIN_MAX)


@pytest.mark.parametrize(
    "poles",
    [
        (-0.1, -0.2, -0.3),
        (-0.1, -0.2, -0.3, -0.4, -0.5),
        (-0.1, -0.2, -0.3, 0.0),
        (-0.1, -0.2, -0.3, 0.4),
        (-0.1, -0.2, -0.3, float("nan")),
        (-0.1, -0.2, -0.3, float("-inf")),
        (),
    ],
)
def test_choice_wants_four_stable_real_poles(poles: tuple[float, ...]) -> None:
    with pytest.raises(DesignError, match="want four stable real poles"):
        choose_rig_design(at(), poles, NOISE_GAIN_MAX)


def test_four_times_the_same_pole_is_refused() -> None:
    with pytest.raises(DesignError, match="asked for 4 times"):
        choose_rig_design(at(), [-0.1] * 4, NOISE_GAIN_MAX)


def test_a_noise_bound_that_no_slowing_meets_is_refused() -> None:
    with pytest.raises(DesignError, match=r"noise gain 0\.001 V/V can't be met"):
        choose_rig_design(at(), OUTPUT_POLES, 0.001)


def test_an_output_pole_on_an_open_loop_pole_is_refused() -> None:
    """It used to surface as numpy's LinAlgError."""
    linear = at()
    with pytest.raises(DesignError, match="eigenvalue of A"):
        RigDesign(((float(linear.A[0, 0]), -0.2), (-0.1, -0.3))).structure(linear)


def test_an_output_pole_on_a_zero_is_refused() -> None:
    linear = at()
    with pytest.raises(DesignError, match="linearly dependent"):
        RigDesign(((float(transmission_zeros(linear)[0]), -0.2), (-0.1, -0.3))).structure(linear)


def test_gains_split_the_matrix_and_invert_its_integral_part() -> None:
    K = np.arange(12.0).reshape(2, 6)
    gains = Gains.from_matrix(K)
    assert gains.levels_V_cm == ((0.0, 1.0, 2.0, 3.0), (6.0, 7.0, 8.0, 9.0))
    assert gains.integrals_1_s == ((4.0, 5.0), (10.0, 11.0))
    assert np.array(gains.integral_inverse) @ K[:, 4:] == pytest.approx(np.eye(2))


def test_a_gain_that_integrates_only_one_way_is_refused() -> None:
    with pytest.raises(DesignError, match="integral gain has no inverse"):
        Gains.from_matrix(np.ones((2, 6)))


def test_calibrated_gains_do_not_follow_the_operating_point_and_the_rigs_do() -> None:
    low, high = at((2.0, 2.0)), at((5.0, 5.0))
    assert not CALIBRATED.follows_reference
    assert CALIBRATED.gains(low) == CALIBRATED.gains(high)
    assert rig_design().follows_reference
    assert rig_design().gains(low) != rig_design().gains(high)
    assert rig_design().gains(low) == Gains.from_matrix(rig_design().structure(low).K)


def test_design_takes_any_model_of_four_tanks() -> None:
    other = replace(BENCH, area_cm2=(50.0, 40.0, 20.0, 30.0), outlet_cm2=(0.1, 0.08, 0.09, 0.06), level_gain_V_cm=0.4)
    linear = linearise(other, equilibrium(other, (4.0, 5.0)))
    assert isinstance(linear, LinearModel)
    design = choose_rig_design(linear, OUTPUT_POLES, 20.0)
    y = response(linear, design.structure(linear).K, FREQUENCIES)
    assert max(np.abs(y[0, 1]).max(), np.abs(y[1, 0]).max()) < 1e-9
