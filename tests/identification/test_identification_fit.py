from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.core.identification.estimate import RigEstimate, estimate
from hil.core.identification.parameters import Choice, RigModel, values_of, with_values
from hil.core.identification.robust_fit import fit_initial
from hil.core.identification.simulation import first_levels, simulate
from tests.identification.made_records import levels_of, record_of, steps

TRUTH = with_values(
    RigModel(),
    {"k1": 3.8, "k2": 2.9, "gamma1": 0.63, "gamma2": 0.68, "a1": 0.062, "a2": 0.064, "a3": 0.078, "a4": 0.05}
    | {"lag1": 0.15, "lag2": 0.3},
)
START = RigModel()
INITIAL = (8.0, 9.0, 1.5, 2.0)


@pytest.fixture(scope="module")
def basic() -> RigEstimate:
    voltage_V = steps(1, 200.0, 0.1, low_V=1.5, high_V=4.5, hold_s=20.0)
    return estimate([record_of(TRUTH, voltage_V, 0.1, INITIAL)], START)


def test_drawn_parameters_are_found_within_what_the_noise_allows(basic: RigEstimate) -> None:
    true = values_of(TRUTH)
    sd = np.sqrt(np.diag(basic.covariance))
    off = [(basic[name] - true[name]) / sd[basic.names.index(name)] for name in basic.parameters]
    assert np.abs(off).max() < 4.0
    assert basic.is_converged
    assert max(abs(basic[name] / true[name] - 1.0) for name in basic.parameters if "lag" not in name) < 0.005


def test_noise_of_each_sensor_is_estimated(basic: RigEstimate) -> None:
    """The estimate is from means over a second, 200 of them: 5 % is its standard deviation."""
    assert basic.noise.noise_V == pytest.approx((0.005,) * 4, rel=0.15)


def test_initial_levels_are_fitted_beside_the_parameters(basic: RigEstimate) -> None:
    assert basic.initial(0) == pytest.approx(INITIAL, abs=0.02)
    assert basic.names[-4:] == ("h1 of made", "h2 of made", "h3 of made", "h4 of made")


def test_simulation_agrees_with_small_euler_steps_where_tanks_are_empty_and_spill() -> None:
    rig = with_values(TRUTH, {"datum3": 4.0, "overflow3": 0.4, "overflow4": 0.7, "dead_zone1": 0.4, "delay2": 0.3})
    rig = replace(rig, tanks=replace(rig.tanks, height_cm=(8.0, 7.0, 1.2, 4.0)))
    voltage_V = np.repeat([[0.0, 0.0], [9.5, 9.5], [0.0, 3.0], [1.0, 0.2]], 500, axis=0)
    record = record_of(rig, voltage_V, 0.1, (1.0, 0.5, 1.0, 0.0))
    simulated = simulate(rig, record, (1.0, 0.5, 1.0, 0.0)).level_cm
    expected = levels_of(rig, voltage_V, 0.1, (1.0, 0.5, 1.0, 0.0))
    assert (expected == np.array(rig.tanks.height_cm)).any(axis=0).all()
    assert (expected[:, 2:] == 0.0).any(axis=0).all()
    assert np.abs(simulated - expected).max() < 0.03


def test_initial_levels_of_a_held_out_record_come_from_its_first_part() -> None:
    voltage_V = steps(2, 60.0, 0.1, low_V=1.5, high_V=4.5, hold_s=20.0)
    record = record_of(TRUTH, voltage_V, 0.1, INITIAL, name="held out")
    initial_cm = fit_initial(TRUTH, record, until_s=20.0)
    assert initial_cm == pytest.approx(INITIAL, abs=0.01)
    assert first_levels(TRUTH, record) == pytest.approx(INITIAL, abs=0.05)


def test_an_unknown_choice_is_refused_by_name() -> None:
    record = record_of(TRUTH, np.ones((10, 2)), 0.1, INITIAL)
    with pytest.raises(ValueError, match="choice for 'kay'"):
        estimate([record], START, {"kay": Choice("free")})
