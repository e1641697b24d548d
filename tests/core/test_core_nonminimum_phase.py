"""The design for valve splits on both sides of gamma1 + gamma2 = 1."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.eigenstructure import DesignError
from hil.core.gain_design import RigDesign, closed_loop_poles, gain_matrix, noise_gain
from hil.core.nonminimum_phase import (
    AnySplitDesign,
    NonMinimumPhaseDesign,
    choose_any_split_design,
    choose_nonminimum_phase_design,
)
from hil.core.reconfiguration import Reconfiguration
from hil.core.tanks import LinearModel, TankModel, relative_gains, transmission_zeros
from hil.core.types import Pair
from tests.core.core_bench import BENCH, NOISE_GAIN_MAX, OUTPUT_POLES, at, rig_design

PLUS = TankModel(pump_gain_cm3_Vs=(3.14, 3.29), valve_split=(0.43, 0.34))
"""Johansson's non-minimum-phase setting."""
PLUS_V = (3.15, 3.15)


def plus(voltage_V: Pair = PLUS_V) -> LinearModel:
    return at(voltage_V, PLUS)


def chosen(linear: LinearModel) -> AnySplitDesign:
    return choose_any_split_design(linear, OUTPUT_POLES, NOISE_GAIN_MAX)


DESIGN = chosen(plus())


def test_stable_zeros_get_the_decoupling_design_as_before() -> None:
    design = chosen(at())
    assert design.decoupled == rig_design()
    assert design.gains(at((3.5, 3.2))) == rig_design().gains(at((3.5, 3.2)))


def test_an_unstable_zero_gets_the_quadratic_design_at_its_noise_bound() -> None:
    quadratic = DESIGN.quadratic
    assert isinstance(quadratic, NonMinimumPhaseDesign)
    assert noise_gain(quadratic.feedback(plus()), 0.5) == pytest.approx(NOISE_GAIN_MAX, rel=1e-3)


def test_one_pole_is_the_mirror_image_of_the_unstable_zero() -> None:
    """The slowest one, and no pole cancels the zero itself."""
    zero = transmission_zeros(plus()).max()
    poles = closed_loop_poles(plus(), gain_matrix(DESIGN.gains(plus())))
    assert poles[0] == pytest.approx(-zero, rel=0.02)
    assert poles[1].real < -2.5 * zero


def test_a_greater_weight_brings_the_poles_to_the_places_of_the_rule() -> None:
    """Mirror image, stable zero, twice ten times the mirror image, and two far to the left."""
    poles = closed_loop_poles(plus(), NonMinimumPhaseDesign(1e5).feedback(plus()))
    low, high = transmission_zeros(plus())
    assert poles[:4] == pytest.approx([-high, low, -10.0 * high, -10.0 * high], rel=0.02)
    assert poles[4].real < -2.0


@settings(max_examples=40, deadline=None)
@given(st.floats(0.5, 3.0), st.floats(0.5, 3.0), st.floats(2.0, 6.0), st.floats(2.0, 6.0))
def test_each_pump_may_lose_half_its_gain_or_treble_it(e1: float, e2: float, v1: float, v2: float) -> None:
    """The margin of a linear-quadratic law, at operating points all over the range."""
    linear = plus((v1, v2))
    assert closed_loop_poles(linear, gain_matrix(DESIGN.gains(linear)), (e1, e2))[0].real < 0.0


@pytest.mark.parametrize("effectiveness", [(0.4, 1.0), (1.0, 0.4), (0.4, 0.4), (0.1, 0.1)])
def test_on_this_rig_the_loop_stands_more_than_the_margin_says(effectiveness: Pair) -> None:
    assert closed_loop_poles(plus(), gain_matrix(DESIGN.gains(plus())), effectiveness)[0].real < -5e-3


@settings(max_examples=20, deadline=None)
@given(st.floats(0.05, 1.0), st.floats(0.05, 1.0))
def test_the_rescaled_command_has_the_nominal_poles_at_any_effectiveness(e1: float, e2: float) -> None:
    """v = (v0 + u)/theta: the paper's reconfiguration does not depend on how the gains were found."""
    K, theta = gain_matrix(DESIGN.gains(plus())), np.array([e1, e2])
    rescaled = closed_loop_poles(plus(), K / theta[:, None], (e1, e2))
    assert rescaled == pytest.approx(closed_loop_poles(plus(), K), abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.12, 0.6), st.floats(0.12, 0.6))
def test_every_split_well_below_one_has_a_stable_law(g1: float, g2: float) -> None:
    if g1 + g2 > 0.9:
        return
    linear = at(PLUS_V, replace(PLUS, valve_split=(g1, g2)))
    design = choose_nonminimum_phase_design(linear, NOISE_GAIN_MAX)
    assert closed_loop_poles(linear, design.feedback(linear))[0].real < -1e-3


@pytest.mark.parametrize("splits", [(0.5, 0.5), (0.49, 0.5), (0.505, 0.505), (0.48, 0.49), (0.9, 0.1)])
def test_near_one_there_is_no_design_and_the_reason_says_how_near(splits: Pair) -> None:
    linear = at(PLUS_V, replace(PLUS, valve_split=splits))
    with pytest.raises(DesignError, match=r"gamma1 \+ gamma2 is too near to 1.*transmission zero at .* relative gain"):
        chosen(linear)
    for design in (DESIGN, chosen(at())):
        with pytest.raises(DesignError, match="too near to 1"):
            design.gains(linear)


def test_a_valve_on_the_other_side_gets_the_other_design() -> None:
    """From both sides: the design of the phase that the valves are in, chosen when it is needed."""
    assert isinstance(DESIGN.at(at()), RigDesign)
    assert isinstance(chosen(at()).at(plus()), NonMinimumPhaseDesign)
    assert closed_loop_poles(plus(), gain_matrix(chosen(at()).gains(plus())))[0].real < -0.01


def test_the_quadratic_design_refuses_stable_zeros_and_a_bound_that_no_law_meets() -> None:
    with pytest.raises(DesignError, match="this design is for one in the right half plane"):
        NonMinimumPhaseDesign(1.0).gains(at())
    with pytest.raises(DesignError, match=r"noise gain 0\.0001 V/V can't be met"):
        choose_nonminimum_phase_design(plus(), 1e-4)


@pytest.mark.parametrize("model", [BENCH, PLUS])
def test_relative_gains_are_those_of_the_splits(model: TankModel) -> None:
    """Johansson (2000): the first is gamma1 gamma2 / (gamma1 + gamma2 - 1) and does not depend on the levels."""
    g1, g2 = model.valve_split
    rga = relative_gains(at((3.0, 4.0), model))
    assert rga[0, 0] == pytest.approx(g1 * g2 / (g1 + g2 - 1.0))
    assert rga.sum(axis=0) == pytest.approx([1.0, 1.0])


def test_the_paper_fault_on_the_other_phase_keeps_target_and_poles() -> None:
    """Both pumps at 40 %: the operating voltages rise to 2.5 times, the reference stays reachable."""
    reconfiguration = Reconfiguration(PLUS, DESIGN, (10.0, 10.0), PLUS_V)
    reference = (6.3, 6.6)
    healthy, weak = (reconfiguration.law(reference, e) for e in ((1.0, 1.0), (0.4, 0.4)))
    assert (weak.reason, weak.problem, weak.target_V) == ("", "", reference)
    assert weak.gains == healthy.gains
    assert weak.operating_V == healthy.operating_V
    assert weak.effectiveness == (0.4, 0.4)


def test_a_found_split_near_one_leaves_no_law_from_either_side() -> None:
    for model, design, voltage in ((PLUS, DESIGN, PLUS_V), (BENCH, chosen(at()), (3.0, 3.0))):
        reconfiguration = Reconfiguration(model, design, (10.0, 10.0), voltage)
        law = reconfiguration.law((6.2, 6.4), (1.0, 1.0), valve_split=(0.5, 0.5))
        assert "leave no stable law" in law.problem
