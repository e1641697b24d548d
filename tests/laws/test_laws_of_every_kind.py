"""What every law does: it reaches references, begins at rest, takes over from MANUAL, leaves saturation, goes on."""

from __future__ import annotations

import numpy as np
import pytest

from tests.laws.law_rigs import MINUS, MINUS_PLANT, PLUS, PLUS_PLANT, laws, raised, rest_outputs
from tools.law_trial import Course, Trial, run

REST = rest_outputs(MINUS_PLANT)
LAWS = laws(MINUS_PLANT)
every_law = pytest.mark.parametrize("name", LAWS)


def course(name: str, trial: Trial) -> Course:
    return run(LAWS[name], MINUS, MINUS, trial)


@every_law
def test_a_reference_is_reached_without_offset(name: str) -> None:
    trial = Trial(100.0, ((0.0, REST), (10.0, raised(REST, 0.3))), given_V=(3.0, 3.0), noise_V=0.0)
    got = course(name, trial)
    assert np.abs(got.outputs[-1] - got.reference_V[-1]).max() < 2e-3
    assert got.overshoot(10.0, 100.0) < 0.3


@every_law
def test_at_rest_nothing_moves(name: str) -> None:
    got = course(name, Trial(5.0, ((0.0, REST),), given_V=(3.0, 3.0), noise_V=0.0))
    assert np.abs(got.wanted_V - 3.0).max() < 0.02


@every_law
def test_control_returns_from_manual_without_a_jump(name: str) -> None:
    trial = Trial(60.0, ((0.0, REST),), manual=(5.0, 10.0, (3.6, 2.7)), given_V=(3.0, 3.0), noise_V=0.0)
    got = course(name, trial)
    back = int(np.searchsorted(got.t_s, 10.0 - 1e-6))
    assert np.abs(got.wanted_V[back] - got.given_V[back - 1]).max() < 0.1
    assert np.abs(got.outputs[-1] - got.reference_V[-1]).max() < 0.02


@every_law
def test_a_step_that_saturates_the_pumps_does_not_wind_up(name: str) -> None:
    trial = Trial(110.0, ((0.0, REST), (5.0, raised(REST, 1.2))), given_V=(3.0, 3.0), noise_V=0.0)
    got = course(name, trial)
    assert got.given_V.max() <= 10.0
    assert got.overshoot(5.0, 110.0) < 0.35
    assert got.settled_s(5.0, 110.0, 0.03) < 70.0


@every_law
def test_both_pumps_that_lose_60_percent_are_made_up_for(name: str) -> None:
    faults = ((0.0, (1.0, 1.0)), (5.0, (0.4, 0.4)))
    got = course(name, Trial(100.0, ((0.0, REST),), faults, given_V=(3.0, 3.0), noise_V=0.0))
    assert np.abs(got.outputs[-1] - got.reference_V[-1]).max() < 0.02
    np.testing.assert_allclose(got.given_V[-1], (7.5, 7.5), atol=0.2)


@every_law
def test_a_dead_pump_leaves_the_other_within_its_range(name: str) -> None:
    faults = ((0.0, (1.0, 1.0)), (5.0, (1.0, 0.0)))
    got = course(name, Trial(60.0, ((0.0, REST),), faults, given_V=(3.0, 3.0)))
    assert np.isfinite(got.wanted_V).all()
    assert got.level_cm.max() < 19.0


@every_law
def test_empty_tanks_are_filled_along_a_ramp(name: str) -> None:
    ramp = tuple((k, (min(REST[0] * k / 110.0, REST[0]), min(REST[1] * k / 110.0, REST[1]))) for k in range(111))
    got = course(name, Trial(125.0, ramp, level_cm=(0.0, 0.0, 0.0, 0.0), noise_V=0.0))
    assert np.isfinite(got.wanted_V).all()
    assert np.abs(got.outputs[-1] - REST).max() < 0.25
    assert (got.outputs - REST).max() < 0.6


@every_law
def test_what_is_shown_has_the_same_names_at_every_step(name: str) -> None:
    got = course(name, Trial(2.0, ((0.0, REST), (1.0, raised(REST, 0.1)))))
    assert len({tuple(row) for row in got.shown}) == 1
    assert got.shown[0]


@pytest.mark.long
@pytest.mark.parametrize("name", laws(PLUS_PLANT))
def test_a_law_reaches_a_reference_in_the_non_minimum_phase_and_makes_up_for_a_loss(name: str) -> None:
    """A common step, then a pump that loses 40 %: the outputs end at their references, and none runs away."""
    law, rest = laws(PLUS_PLANT)[name], rest_outputs(PLUS_PLANT)
    faults = ((0.0, (1.0, 1.0)), (450.0, (0.6, 1.0)))
    trial = Trial(900.0, ((0.0, rest), (10.0, raised(rest, 0.2))), faults, given_V=(3.15, 3.15), noise_V=0.0)
    got = run(law, PLUS, PLUS, trial)
    error = np.abs(got.outputs - got.reference_V)
    step_end = int(np.searchsorted(got.t_s, 449.0))
    assert error[step_end].max() < 0.02
    assert error[: step_end + 1].max() < 0.6
    if name != "pi":  # takes nothing from the diagnosis, and its loops take a thousand seconds
        assert error[-1].max() < 0.03
