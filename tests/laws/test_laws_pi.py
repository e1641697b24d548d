"""Decentralised PI control against a simulation in continuous time, and what Johansson found."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.core.laws.decentralised_pi import DecentralisedPi, is_crossed, relative_gain
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Pair
from tests.laws.law_rigs import MINUS, MINUS_PLANT, PLUS, PLUS_PLANT, johansson_pi, rest_outputs
from tools.law_trial import Trial, run


def integrated(law: DecentralisedPi, v0: float, step_V: float, duration_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and states (8, n): levels, integrals of errors, IAE; after a step of reference 1, without a lag."""
    model: TankModel = law.plant.model
    rest = np.array(equilibrium(model, (v0, v0)))
    reference = 0.5 * rest[:2] + (step_V, 0.0)
    A, a = np.array(model.area_cm2), np.array(model.outlet_cm2)
    (k1, k2), (g1, g2) = model.pump_gain_cm3_Vs, model.valve_split

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        error = reference - 0.5 * state[:2]
        v1, v2 = v0 + np.array(law.gain_V_V) * (error + state[4:6] / np.array(law.integral_s))
        out = a * sqrt(2.0 * 981.0) * np.sqrt(np.maximum(state[:4], 0.0))
        inflow = np.array([g1 * k1 * v1 + out[2], g2 * k2 * v2 + out[3], (1 - g2) * k2 * v2, (1 - g1) * k1 * v1])
        return np.concatenate([(inflow - out) / A, error, np.abs(error)])

    done = solve_ivp(rates, (0.0, duration_s), [*rest, *[0.0] * 4], rtol=1e-8, atol=1e-9, max_step=5.0)
    return done.t, done.y


def continuous_response(law: DecentralisedPi, v0: float, step_V: float, duration_s: float) -> tuple[Pair, float]:
    """IAE (2,) and largest rise of output 1."""
    _, states = integrated(law, v0, step_V, duration_s)
    first, second = states[6:8, -1].tolist()
    return (first, second), float(0.5 * (states[0].max() - states[0, 0]))


def continuous_course(
    law: DecentralisedPi, v0: float, step_V: float, duration_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and the rise of output 1 (n,), V."""
    times_s, states = integrated(law, v0, step_V, duration_s)
    return times_s, 0.5 * (states[0] - states[0, 0])


@pytest.mark.parametrize(("plant", "v0", "duration_s"), [(MINUS_PLANT, 3.0, 150.0), (PLUS_PLANT, 3.15, 400.0)])
def test_johanssons_settings_respond_as_in_continuous_time(plant: object, v0: float, duration_s: float) -> None:
    law = johansson_pi(plant)  # type: ignore[arg-type]
    rest = rest_outputs(law.plant)
    iae_Vs, highest_V = continuous_response(law, v0, 0.5, duration_s)
    references = ((0.0, rest), (1.0, (rest[0] + 0.5, rest[1])))
    got = run(law, law.plant.model, law.plant.model, Trial(duration_s + 1.0, references, given_V=(v0, v0), noise_V=0.0))
    assert got.iae(1.0, duration_s + 1.0) == pytest.approx(iae_Vs, rel=0.03)
    assert got.outputs[:, 0].max() - rest[0] == pytest.approx(highest_V, rel=0.03)


def test_the_relative_gain_is_that_of_the_static_process() -> None:
    for model, v0 in ((MINUS, 3.0), (PLUS, 3.15)):
        up = np.array([equilibrium(model, pair)[:2] for pair in ((v0 + 1e-4, v0), (v0, v0 + 1e-4))])
        down = np.array([equilibrium(model, pair)[:2] for pair in ((v0 - 1e-4, v0), (v0, v0 - 1e-4))])
        G = (up - down).T
        assert relative_gain(model) == pytest.approx((G * np.linalg.inv(G).T)[0, 0], rel=1e-5)


def test_more_water_upstairs_crosses_the_pairing() -> None:
    assert (is_crossed(MINUS), is_crossed(PLUS)) == (False, True)


def test_crossed_loops_hold_the_non_minimum_phase_rig() -> None:
    rest = rest_outputs(PLUS_PLANT)
    law = DecentralisedPi(PLUS_PLANT, (0.7, 0.7), (130.0, 130.0), crossed=True)
    references = ((0.0, rest), (10.0, (rest[0] + 0.3, rest[1] - 0.3)))
    got = run(law, PLUS, PLUS, Trial(700.0, references, given_V=(3.15, 3.15), noise_V=0.0))
    assert np.abs(got.outputs[-1] - got.reference_V[-1]).max() < 0.02


def test_how_much_slower_the_published_settings_are_in_the_non_minimum_phase() -> None:
    """The ratio depends on the band: 6 times until within 10 %, 23 times until within 2 % of the step."""
    within: dict[float, list[float]] = {0.1: [], 0.02: []}
    for plant, v0, duration_s in ((MINUS_PLANT, 3.0, 100.0), (PLUS_PLANT, 3.15, 1500.0)):
        times_s, first_V = continuous_course(johansson_pi(plant), v0, 0.5, duration_s)
        for share, found in within.items():
            found.append(times_s[np.flatnonzero(np.abs(first_V - 0.5) > share * 0.5)[-1]])
    ratio = {share: plus / minus for share, (minus, plus) in within.items()}
    assert ratio[0.1] == pytest.approx(6.1, rel=0.1)
    assert ratio[0.02] == pytest.approx(23.0, rel=0.1)
