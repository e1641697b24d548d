"""The law with identified outlets and leaks: operating point, target, integrals; and how soon it follows them."""

from dataclasses import replace

import numpy as np
import pytest

from hil.core.diagnosis.ideal import NoDetector
from hil.core.estimator import Estimate
from hil.core.following import WATERWAYS_CHANGE, WATERWAYS_S, Followed, follow
from hil.core.gain_design import choose_rig_design, closed_loop_poles, gain_matrix
from hil.core.reconfiguration import UNSURE_V, Reconfiguration
from hil.core.state_feedback import effective_voltage
from hil.core.tanks import TankModel, equilibrium, holding_voltages, level_rates, linearise
from hil.core.types import Diagnosis, Measurement, Pair, Quad, Waterways
from tests.core.core_bench import BENCH, Plant, bench_loop, controller_config, run
from tests.narrowing import quad

REST = equilibrium(BENCH, (3.0, 3.0))
REST_V = (0.5 * REST[0], 0.5 * REST[1])
DESIGN = choose_rig_design(linearise(BENCH, REST), (-0.252, -0.184, -0.073, -0.06), 10.0)
RIG = Reconfiguration(BENCH, DESIGN, (10.0, 10.0), (3.0, 3.0))
HEALTHY = (1.0, 1.0)
CLEAN = Waterways((1.0, 1.0, 1.0, 1.0), (0.0, 0.0), (1.0, 1.0), BENCH.valve_split)


def outlets(*shares: float, leak: Pair = (0.0, 0.0)) -> Waterways:
    return replace(CLEAN, outlet=quad(shares), leak=leak)


def true_tanks(ways: Waterways) -> TankModel:
    """The tanks as eq. (1) has them; a leak of tank 3 or 4 leaves the rig."""
    o1, o2, o3, o4 = ways.outlet
    a1, a2, a3, a4 = BENCH.outlet_cm2
    (e3, e4), (k1, k2) = ways.leak, BENCH.pump_gain_cm3_Vs
    return replace(
        BENCH,
        outlet_cm2=(a1 * o1, a2 * o2, a3 * (o3 + e3), a4 * (o4 + e4)),
        arriving=(o3 / (o3 + e3), o4 / (o4 + e4)),
        pump_gain_cm3_Vs=(k1 * ways.gain[0], k2 * ways.gain[1]),
        valve_split=ways.split,
    )


CASES = (
    outlets(0.8, 1.0, 1.0, 1.0),
    outlets(1.0, 0.8, 1.0, 1.0),
    outlets(1.0, 1.0, 0.5, 1.0),
    outlets(1.0, 1.0, 1.0, 0.5),
    outlets(1.3, 1.0, 1.0, 1.0),
    outlets(1.0, 1.0, 1.0, 1.0, leak=(0.3, 0.0)),
    outlets(1.0, 1.0, 1.0, 1.0, leak=(0.0, 0.3)),
    replace(outlets(1.2, 0.9, 1.0, 1.0), gain=(0.97, 1.02), split=(0.68, 0.61)),
)


def test_a_leaking_upper_tank_gives_the_lower_one_its_share_only() -> None:
    ways = outlets(1.0, 1.0, 0.9, 1.0, leak=(0.3, 0.0))
    model = true_tanks(ways)
    own = BENCH.outlet_cm2[2] * np.sqrt(2.0 * BENCH.gravity_cm_s2 * 4.0)
    leaks, clean = level_rates(model, (4.0,) * 4, (0.0, 0.0)), level_rates(BENCH, (4.0,) * 4, (0.0, 0.0))
    assert leaks[2] * BENCH.area_cm2[2] == pytest.approx(-1.2 * own)
    assert (leaks[0] - clean[0]) * BENCH.area_cm2[0] == pytest.approx(-0.1 * own)
    at = equilibrium(model, (3.0, 3.0))
    assert level_rates(model, at, (3.0, 3.0)) == pytest.approx((0.0,) * 4, abs=1e-12)
    assert holding_voltages(model, at[:2]) == pytest.approx((3.0, 3.0))
    step = 1e-5
    slope = (np.array(level_rates(model, (at[0], at[1], at[2] + step, at[3]), (3.0, 3.0)))) / step
    assert linearise(model, at).A[:, 2] == pytest.approx(slope, rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("ways", CASES, ids=str)
def test_its_operating_point_is_that_of_the_identified_tanks(ways: Waterways) -> None:
    law = RIG.law(REST_V, HEALTHY, None, ways)
    assert law.problem == law.reason == ""
    assert law.target_V == REST_V
    assert law.operating_V == pytest.approx(holding_voltages(true_tanks(ways), REST[:2]))
    rates = level_rates(true_tanks(ways), law.operating_level_cm, law.operating_V)
    assert rates == pytest.approx((0.0,) * 4, abs=1e-9)
    assert law.gains == RIG.law(REST_V, HEALTHY).gains, "stable as they are"


def test_a_reference_that_blocked_tanks_can_not_hold_has_a_nearest_one() -> None:
    law = RIG.law(REST_V, HEALTHY, None, outlets(0.3, 1.0, 1.0, 1.0))
    assert "pump 1 would need" in law.reason
    assert law.target_V[0] > REST_V[0] > 0.0
    assert law.target_V[1] < REST_V[1]


def test_a_reference_that_is_missed_by_little_is_kept() -> None:
    """A holding voltage of -0.2 V, by an identified outlet, gave up a reference that the true tanks could hold."""
    ways = outlets(0.5, 1.0, 1.0, 1.0)
    law = RIG.law(REST_V, HEALTHY, None, ways)
    assert -UNSURE_V < law.operating_V[0] < 0.0
    assert law.reason == ""
    assert law.target_V == REST_V
    assert law.operating_level_cm[:2] == pytest.approx(REST[:2])


def test_what_leaves_no_stable_law_is_named() -> None:
    law = RIG.law(REST_V, HEALTHY, None, replace(CLEAN, split=(0.25, 0.6)))
    assert "outlets of 1.00, 1.00, 1.00 and 1.00" in law.problem
    assert RIG.law(REST_V, (0.02, 1.0), None, replace(CLEAN, split=(0.25, 0.6))).problem == "", "not with a dead pump"


def error_integral(ways: Waterways, integral: Pair, level_cm: Quad) -> float:
    """Integral of the squared errors, V^2 s, of the linear closed loop."""
    law = RIG.law(REST_V, HEALTHY, None, ways)
    linear = linearise(true_tanks(ways), law.operating_level_cm)
    A = np.zeros((6, 6))
    K = gain_matrix(law.gains)
    A[:4, :4] = linear.A
    A[4:, :4] = -linear.C
    A[:4] -= linear.B @ K
    z = np.concatenate([np.array(level_cm) - np.array(law.operating_level_cm), integral])
    total, dt = 0.0, 0.05
    for _ in range(8000):
        total += float(np.sum((linear.C @ z[:4]) ** 2)) * dt
        z = z + dt * (A @ (z + 0.5 * dt * (A @ z)))
    return total


def test_the_settling_integrals_return_the_outputs_best() -> None:
    ways, at = outlets(1.3, 1.0, 1.0, 1.0), quad((REST[0] - 0.4, *REST[1:]))
    law = RIG.law(REST_V, HEALTHY, None, ways)
    q = RIG.settling_integral(law, ways, at)
    best = error_integral(ways, q, at)
    for other in ((q[0] + 0.1, q[1]), (q[0] - 0.1, q[1]), (q[0], q[1] + 0.1), (q[0], q[1] - 0.1)):
        assert error_integral(ways, other, at) > best
    assert RIG.settling_integral(law, ways, law.operating_level_cm) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert effective_voltage(law, (0.0, 0.0), law.operating_level_cm) == law.operating_V
    assert closed_loop_poles(linearise(BENCH, REST), gain_matrix(law.gains))[0].real < 0.0


class FindsWays(NoDetector):
    """A detector that knows the waterways from found_s on; None: it only says that all is well."""

    def __init__(self, ways: Waterways | None, found_s: float) -> None:
        self.ways, self.found_s = ways, found_s

    def step(
        self, memory: object, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[None, Diagnosis]:
        del memory, measurement, estimate, applied_V
        return None, Diagnosis(waterways=self.ways if t_s >= self.found_s else None)


@pytest.mark.parametrize("ways", [CASES[1], CASES[2], CASES[4], outlets(0.5, 1.0, 1.0, 1.0)], ids=str)
def test_the_outputs_are_held_better_by_a_law_that_knows(ways: Waterways) -> None:
    """Outlets were identified within seconds, and not used: the integral action alone found the new voltages."""
    errors = []
    for known in (ways, None):
        plant = Plant(start_V=(3.0, 3.0))
        plant.model = true_tanks(ways)
        loop = bench_loop(detector=FindsWays(known, 5.0), rule=RIG)
        _, records = run(controller_config(loop), plant, 1200)
        errors.append(sum(records[-1].iae_Vs))
    assert errors[0] < 0.95 * errors[1]


def test_waterways_are_followed_at_once_and_then_in_steps_that_matter() -> None:
    found, refined = outlets(0.6, 1.0, 1.0, 1.0), outlets(0.6 - 1.01 * WATERWAYS_CHANGE, 1.0, 1.0, 1.0)
    first = follow(Followed(), Diagnosis(waterways=found), 5.0)
    assert first.waterways is found
    assert follow(first, Diagnosis(waterways=refined), 4.99 + WATERWAYS_S).waterways is found
    again = follow(first, Diagnosis(waterways=refined), 5.0 + WATERWAYS_S)
    assert again.waterways is refined
    little = outlets(0.6 - 0.5 * WATERWAYS_CHANGE, 1.0, 1.0, 1.0)
    assert follow(first, Diagnosis(waterways=little), 60.0) is first
    leak = outlets(0.6, 1.0, 1.0, 1.0, leak=(0.0, 1.01 * WATERWAYS_CHANGE))
    assert follow(first, Diagnosis(waterways=leak), 60.0).waterways is leak
    assert follow(first, Diagnosis(), 5.1).waterways is None
    assert follow(first, Diagnosis((0.4, 1.0), waterways=found), 5.1).effectiveness == (0.4, 1.0)
