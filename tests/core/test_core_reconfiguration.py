"""Control law and state feedback: rescaling by effectiveness, bumpless changes, anti-windup, reachable targets."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core import closed_loop, state_feedback
from hil.core.diagnosis.ideal import NoDetector
from hil.core.eigenstructure import assign, augment
from hil.core.estimator import Estimate
from hil.core.gain_design import Gains, closed_loop_poles, gain_matrix
from hil.core.loop_state import LoopState
from hil.core.reconfiguration import MIN_EFFECTIVENESS, MIN_LINEARISED_CM
from hil.core.state_feedback import StateFeedback
from hil.core.tanks import equilibrium, linearise
from hil.core.types import Diagnosis, Measurement, Pair, Quad
from tests.core.core_bench import (
    BENCH,
    CALIBRATED,
    PERIOD_S,
    SECOND,
    Plant,
    at,
    bench_loop,
    inputs,
    reconfiguration,
    rig_design,
    volts,
)
from tests.narrowing import pair

RIG = reconfiguration()
PAPER = reconfiguration(CALIBRATED)
HEALTHY = (1.0, 1.0)
HALF = st.floats(0.1, 1.0)
LEVEL = st.floats(0.0, 20.0)
CHARGE = st.floats(-50.0, 50.0)


def reference_at(voltage_V: Pair = (3.0, 3.0)) -> Pair:
    h1, h2, _, _ = equilibrium(BENCH, voltage_V)
    return 0.5 * h1, 0.5 * h2


def hand_law(**changes: Any) -> StateFeedback:
    """A law with numbers that can be followed on paper."""
    gains = Gains.from_matrix(np.array([[1.0, 2.0, 3.0, 4.0, 0.5, 0.1], [5.0, 6.0, 7.0, 8.0, -0.2, 0.4]]))
    values: dict[str, Any] = {
        "gains": gains,
        "operating_level_cm": (10.0, 11.0, 2.0, 1.0),
        "operating_V": (3.0, 4.0),
        "target_V": (5.0, 5.5),
        "effectiveness": (0.5, 0.8),
        "reason": "",
    }
    return StateFeedback(**(values | changes))


def test_feedback_is_operating_voltage_minus_gains_times_state() -> None:
    effective = state_feedback.effective_voltage(hand_law(), (2.0, -1.0), (10.1, 11.0, 2.0, 0.9))
    assert effective == pytest.approx((3.0 - 0.1 + 0.4 - 1.0 + 0.1, 4.0 - 0.5 + 0.8 + 0.4 + 0.4))


def test_pumps_are_asked_for_the_effective_voltage_over_what_is_left_of_them() -> None:
    assert state_feedback.pump_voltage(hand_law(), (3.0, 4.0)) == pytest.approx((6.0, 5.0))


def test_at_the_operating_point_the_law_asks_for_the_holding_voltages() -> None:
    law = RIG.law(reference_at((2.5, 4.0)), HEALTHY)
    assert law.operating_V == pytest.approx((2.5, 4.0), abs=1e-9)
    assert law.operating_level_cm == pytest.approx(equilibrium(BENCH, (2.5, 4.0)), abs=1e-9)
    assert state_feedback.effective_voltage(law, (0.0, 0.0), law.operating_level_cm) == law.operating_V
    assert law.target_V == reference_at((2.5, 4.0))
    assert law.reason == ""


@settings(max_examples=25, deadline=None)
@given(HALF, HALF)
def test_dividing_by_theta_is_assignment_on_the_faulty_model(e1: float, e2: float) -> None:
    """Theta^-1 K is PEA for (A, B Theta) with the parameters Theta^-1 w_i: same poles, same eigenvectors."""
    structure = rig_design().structure(at())
    A, B = augment(at())
    theta = np.diag([e1, e2])
    faulty = assign(A, B @ theta, structure.requested_poles, np.linalg.inv(theta) @ structure.parameters)
    assert pytest.approx(np.linalg.inv(theta) @ structure.K, rel=1e-7, abs=1e-7) == faulty.K
    alignment = np.abs(np.sum(faulty.V * structure.V, axis=0))
    assert alignment == pytest.approx(np.ones(6), abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.tuples(LEVEL, LEVEL, LEVEL, LEVEL), CHARGE, CHARGE, st.tuples(HALF, HALF), st.floats(2.0, 4.5))
def test_a_change_of_law_does_not_change_the_effective_voltage(
    level_cm: Quad, q1: float, q2: float, effectiveness: Pair, v: float
) -> None:
    old = RIG.law(reference_at(), HEALTHY)
    new = RIG.law(reference_at((v, 3.3)), effectiveness)
    before = state_feedback.effective_voltage(old, (q1, q2), level_cm)
    integral = state_feedback.bumpless_integral(new, level_cm, before)
    after = state_feedback.effective_voltage(new, integral, level_cm)
    assert after == pytest.approx(before, rel=1e-9, abs=1e-9)


def test_bumpless_integral_undoes_the_effective_voltage() -> None:
    law = RIG.law(reference_at(), HEALTHY)
    level_cm = (11.0, 13.0, 1.5, 1.2)
    effective = state_feedback.effective_voltage(law, (1.5, -2.5), level_cm)
    assert state_feedback.bumpless_integral(law, level_cm, effective) == pytest.approx((1.5, -2.5))


def test_without_saturation_the_integral_is_that_of_the_error() -> None:
    law = hand_law()
    moved = state_feedback.advance_integral(law, (1.0, 2.0), (0.3, -0.4), (0.0, 0.0), 0.1, 5.0)
    assert moved == pytest.approx((1.03, 1.96))


@pytest.mark.parametrize(("anti_windup_s", "share"), [(5.0, 0.02), (0.1, 1.0), (0.05, 1.0), (0.0, 1.0)])
def test_back_calculation_takes_the_voltage_asked_for_towards_the_one_applied(
    anti_windup_s: float, share: float
) -> None:
    law = hand_law()
    level_cm, q = (10.0, 11.0, 2.0, 1.0), (3.0, -2.0)
    raw = np.array(state_feedback.pump_voltage(law, state_feedback.effective_voltage(law, q, level_cm)))
    excess = (1.2, -0.7)
    q = state_feedback.advance_integral(law, q, (0.0, 0.0), excess, 0.1, anti_windup_s)
    after = np.array(state_feedback.pump_voltage(law, state_feedback.effective_voltage(law, q, level_cm)))
    assert after - raw == pytest.approx(-share * np.array(excess))


class SaturatedRun:
    """The law on the tanks, with pumps that give no less and no more than LIMITS_V."""

    limits_V = (2.5, 3.6)

    def __init__(self, anti_windup: bool = True) -> None:
        self.plant, self.anti_windup = Plant(), anti_windup
        self.integral: Pair = (0.0, 0.0)
        self.raw: Pair = (math.nan, math.nan)
        self.applied = self.error = self.raw

    def step(self, law: state_feedback.StateFeedback) -> None:
        effective = state_feedback.effective_voltage(law, self.integral, self.plant.level_cm)
        low, high = self.limits_V
        self.raw = state_feedback.pump_voltage(law, effective)
        self.applied = pair(min(max(v, low), high) for v in self.raw)
        self.error = pair(r - 0.5 * h for r, h in zip(law.target_V, self.plant.level_cm[:2], strict=True))
        excess = pair(v - a for v, a in zip(self.raw, self.applied, strict=True)) if self.anti_windup else (0.0, 0.0)
        self.integral = state_feedback.advance_integral(law, self.integral, self.error, excess, PERIOD_S, 5.0)
        self.plant.advance(self.applied, PERIOD_S)

    def change(self, old: state_feedback.StateFeedback, new: state_feedback.StateFeedback) -> None:
        effective = state_feedback.effective_voltage(old, self.integral, self.plant.level_cm)
        self.integral = state_feedback.bumpless_integral(new, self.plant.level_cm, effective)


def saturate(run: SaturatedRun, far_V: float) -> state_feedback.StateFeedback:
    """Four minutes of a reference that LIMITS_V can't hold; the law then in force."""
    law = RIG.law(reference_at((far_V, far_V)), HEALTHY)
    for _ in range(2400):
        run.step(law)
    return law


def come_back(run: SaturatedRun, law: state_feedback.StateFeedback) -> tuple[float | None, float]:
    """Five minutes of a reference within reach: when the pumps left their limits, and the worst error past it."""
    back = RIG.law(reference_at(), HEALTHY)
    run.change(law, back)
    sign = 1.0 if run.error[0] > 0.0 else -1.0
    left_s, overshoot = None, 0.0
    for number in range(3000):
        run.step(back)
        if left_s is None and not set(run.applied) & set(run.limits_V):
            left_s = number * PERIOD_S
        overshoot = max(overshoot, *(sign * e for e in run.error))
    return left_s, overshoot


@pytest.mark.parametrize("far_V", [4.7, 3.9, 2.0])
def test_a_saturated_pump_does_not_wind_up_and_recovers(far_V: float) -> None:
    run = SaturatedRun()
    law = saturate(run, far_V)
    limit = run.limits_V[1] if far_V > 3.0 else run.limits_V[0]
    assert run.applied == (limit, limit)
    integral_gain = np.array(law.gains.integrals_1_s)
    standing = 5.0 * -integral_gain @ run.error  # where the pull of the error and of back-calculation balance
    assert np.array(run.raw) - limit == pytest.approx(standing, rel=0.03)
    left_s, overshoot = come_back(run, law)
    assert left_s is not None
    assert left_s < 10.0
    assert overshoot < 1e-3
    assert run.error == pytest.approx((0.0, 0.0), abs=1e-4)


def test_without_anti_windup_the_same_run_latches() -> None:
    """The measure of windup above can fail."""
    run = SaturatedRun(anti_windup=False)
    law = saturate(run, 4.7)
    assert min(run.raw) > 500.0
    left_s, _ = come_back(run, law)
    assert left_s is None


def test_a_pump_that_can_not_hold_the_reference_gets_the_nearest_that_it_can() -> None:
    reference = reference_at((3.0, 3.0))
    law = RIG.law(reference, (0.25, 1.0))
    assert law.reason == "pump 1 would need 3.00 V of 2.50 V"
    assert law.target_V != reference
    assert law.operating_V[0] == pytest.approx(2.5)
    assert state_feedback.pump_voltage(law, law.operating_V)[0] == pytest.approx(10.0)
    assert 0.0 <= state_feedback.pump_voltage(law, law.operating_V)[1] <= 10.0
    h1, h2, _, _ = equilibrium(BENCH, law.operating_V)
    assert law.target_V == pytest.approx((0.5 * h1, 0.5 * h2))


def test_with_60_percent_lost_the_bench_still_reaches_its_reference() -> None:
    law = RIG.law(reference_at(), (0.4, 0.4))
    assert law.reason == ""
    assert state_feedback.pump_voltage(law, law.operating_V) == pytest.approx((7.5, 7.5), abs=1e-6)


@pytest.mark.parametrize("effectiveness", [0.0, 0.01, MIN_EFFECTIVENESS / 2.0])
def test_a_dead_pump_is_not_asked_for_infinitely_much(effectiveness: float) -> None:
    law = RIG.law(reference_at(), (effectiveness, 1.0))
    assert law.effectiveness == (MIN_EFFECTIVENESS, 1.0)
    assert law.operating_V[0] == pytest.approx(effectiveness * 10.0)
    assert np.isfinite(state_feedback.pump_voltage(law, law.operating_V)).all()


def test_calibrated_law_keeps_its_operating_point_and_gain() -> None:
    away = PAPER.law(reference_at((4.0, 3.5)), (0.4, 1.0))
    assert away.operating_V == (3.0, 3.0)
    assert away.operating_level_cm == equilibrium(BENCH, (3.0, 3.0))
    assert away.target_V == reference_at((4.0, 3.5))
    assert away.gains == CALIBRATED.gains(at())
    assert away.effectiveness == (0.4, 1.0)


def test_rig_law_is_designed_at_the_reference() -> None:
    law = RIG.law(reference_at((4.0, 3.5)), (0.4, 1.0))
    assert law.gains.levels_V_cm[0] == pytest.approx(rig_design().gains(at((4.0, 3.5))).levels_V_cm[0], rel=1e-6)


def test_empty_tanks_still_have_a_law() -> None:
    law = RIG.law((0.0, 0.0), HEALTHY)
    assert law.operating_V == (0.0, 0.0)
    assert law.operating_level_cm == (0.0, 0.0, 0.0, 0.0)
    lowest = linearise(BENCH, (MIN_LINEARISED_CM,) * 4)
    assert law.gains == rig_design().gains(lowest)


def test_the_same_request_gives_the_same_law() -> None:
    assert RIG.law(reference_at(), (0.4, 0.7)) == RIG.law(reference_at(), (0.4, 0.7))


# valves that have shifted


@pytest.mark.parametrize("split", [(0.6, 0.6), (0.65, 0.55), (0.9, 0.6)])
def test_a_shifted_valve_moves_the_operating_point_and_keeps_gains_that_are_stable(split: Pair) -> None:
    before, law = RIG.law(reference_at(), HEALTHY), RIG.law(reference_at(), HEALTHY, split)
    found = replace(BENCH, valve_split=split)
    assert law.gains == before.gains
    assert law.problem == ""
    assert law.target_V == before.target_V
    assert 0.5 * np.array(equilibrium(found, law.operating_V)[:2]) == pytest.approx(reference_at())
    assert law.operating_level_cm == pytest.approx(equilibrium(found, law.operating_V))


def test_the_target_is_what_the_valves_found_can_reach() -> None:
    law = RIG.law(reference_at(), HEALTHY, (0.45, 0.6))
    assert "pump 2 would need -11.9" in law.reason
    assert law.target_V != reference_at()
    assert min(law.operating_V) == 0.0


@pytest.mark.parametrize("split", [(0.254, 0.6), (0.7, 0.2), (0.4, 0.6), (0.0, 0.0)])
def test_beyond_a_sum_of_one_no_law_is_stable_and_the_law_says_so(split: Pair) -> None:
    """A zero in the right half plane, or at the origin: the decoupling design would put a pole on it."""
    law = RIG.law(reference_at(), HEALTHY, split)
    assert law.problem == f"valve splits of {split[0]:.3f} and {split[1]:.3f} leave no stable law"
    assert replace(law, problem="") == RIG.law(reference_at(), HEALTHY)


def test_gains_that_are_no_longer_stable_are_computed_again() -> None:
    split = (0.92517, 0.08241)
    law = RIG.law(reference_at(), HEALTHY, split)
    assert law.problem == ""
    assert law.gains != RIG.law(reference_at(), HEALTHY).gains
    h1, h2, h3, h4 = (max(h, MIN_LINEARISED_CM) for h in law.operating_level_cm)
    linear = linearise(replace(BENCH, valve_split=split), (h1, h2, h3, h4))
    assert closed_loop_poles(linear, gain_matrix(law.gains))[0].real < 0.0


def test_with_a_dead_pump_the_splits_are_left_alone() -> None:
    assert RIG.law(reference_at(), (0.0, 1.0), (0.25, 0.6)) == RIG.law(reference_at(), (0.0, 1.0))


class FindsSplit(NoDetector):
    """A detector that finds splits, by run time."""

    def __init__(self, *found: tuple[float, Pair | None]) -> None:
        self.found = found

    def step(
        self, memory: object, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[None, Diagnosis]:
        del memory, measurement, estimate, applied_V
        return None, Diagnosis(valve_split=next(split for at_s, split in reversed(self.found) if at_s <= t_s + 1e-6))


def loops_with(*found: tuple[float, Pair | None], seconds: float, **changes: Any) -> list[LoopState]:
    """The loop's states, at rest, with what the detector finds."""
    config = bench_loop(detector=FindsSplit(*found), **changes)
    seen = inputs(volts(equilibrium(BENCH, (3.0, 3.0))), (3.0, 3.0))
    states = [closed_loop.begin(config, seen, 0)]
    for number in range(1, round(10 * seconds) + 1):
        states.append(closed_loop.step(config, states[-1], seen, number * SECOND // 10)[0])
    return states


def test_the_loop_waits_for_a_split_to_be_refined_before_it_gives_up() -> None:
    bad = (0.25, 0.6)
    states = loops_with((0.0, None), (1.0, bad), seconds=8.0)
    assert [state.problem != "" for state in states] == [n >= 60 for n in range(81)]
    assert all((state.request.problem != "") is (n >= 10) for n, state in enumerate(states))
    for later in (None, (0.6, 0.6)):
        states = loops_with((0.0, None), (1.0, bad), (4.0, later), seconds=12.0)
        assert not any(state.problem for state in states)
    assert not any(state.problem for state in loops_with((0.0, bad), seconds=8.0, reconfigure=False))


def test_the_law_follows_a_split_every_two_seconds_and_only_changes_that_matter() -> None:
    states = loops_with((0.0, None), (1.0, (0.7, 0.5)), (1.1, (0.7, 0.55)), (3.5, (0.7, 0.559)), seconds=6.0)
    assert [states[n].law_memory.task[2] for n in (9, 10, 29)] == [None, (0.7, 0.5), (0.7, 0.5)]
    assert [states[n].law_memory.task[2] for n in (30, 60)] == [(0.7, 0.55), (0.7, 0.55)]
    away = loops_with((0.0, (0.7, 0.5)), (0.5, None), seconds=0.6)
    assert [away[n].law_memory.task[2] for n in (4, 5)] == [(0.7, 0.5), None]
