"""The predicted peak against the tanks' own equations, and what is seen of the outlets."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hil.core import monitors
from hil.core.overshoot import MIN_SHARE, Outlets, drained_peak, peak_levels, rebase, watch
from hil.core.tanks import TankModel, equilibrium, level_rates
from hil.core.types import Alarm, Diagnosis, Pair, Quad
from tests.safety.safety_bench import BENCH

SECOND = 1_000_000_000
DT_NS = SECOND // 10


def coasting(
    model: TankModel,
    level_cm: Quad,
    pump_V: Pair = (0.0, 0.0),
    lag_s: float = 0.0,
    outlets: Pair = (1.0, 1.0),
    for_s: float = 400.0,
) -> npt.NDArray[np.float64]:
    """Highest levels with the pumps commanded to 0 V and their flow fading with the lag."""
    a1, a2, a3, a4 = model.outlet_cm2
    true = replace(model, outlet_cm2=(outlets[0] * a1, outlets[1] * a2, a3, a4))

    def rates(t: float, h: npt.NDArray[np.float64]) -> Quad:
        fading = math.exp(-t / lag_s) if lag_s else 0.0
        return level_rates(true, tuple(max(x, 0.0) for x in h), (pump_V[0] * fading, pump_V[1] * fading))

    times = np.linspace(0.0, for_s, 40001)  # between the solver's own steps lies the peak
    solved = solve_ivp(rates, (0.0, for_s), level_cm, rtol=1e-7, atol=1e-7, max_step=2.0, dense_output=True)
    highest: npt.NDArray[np.float64] = solved.sol(times).max(axis=1)
    return highest


MODELS = st.builds(
    TankModel,
    area_cm2=st.tuples(*[st.floats(10.0, 60.0)] * 4),
    outlet_cm2=st.tuples(*[st.floats(0.02, 0.2)] * 4),
    valve_split=st.tuples(st.floats(0.1, 0.9), st.floats(0.1, 0.9)),
)
LEVELS = st.tuples(*[st.floats(0.01, 20.0)] * 4)


@settings(max_examples=25, deadline=None)
@given(MODELS, LEVELS)
def test_without_lag_the_peak_is_that_of_the_equations(model: TankModel, level_cm: Quad) -> None:
    assert peak_levels(model, (0.0, 0.0), level_cm, (9.0, 9.0)) == pytest.approx(coasting(model, level_cm), abs=0.01)


@settings(max_examples=25, deadline=None)
@given(MODELS, LEVELS, st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 10.0)), st.floats(0.05, 1.0))
def test_with_lag_it_is_an_upper_bound_by_no_more_than_the_water_on_its_way(
    model: TankModel, level_cm: Quad, pump_V: Pair, lag_s: float
) -> None:
    found = np.array(peak_levels(model, (lag_s, lag_s), level_cm, pump_V))
    true = coasting(model, level_cm, pump_V, lag_s)
    on_its_way_cm3 = lag_s * np.dot(model.pump_gain_cm3_Vs, pump_V)
    assert np.all(found >= true - 0.01)
    assert np.all(found <= true + on_its_way_cm3 / np.array(model.area_cm2) + 0.01)


@settings(max_examples=15, deadline=None)
@given(LEVELS, st.tuples(st.floats(MIN_SHARE, 1.0), st.floats(MIN_SHARE, 1.0)))
def test_outlets_that_are_partly_blocked_let_less_go(level_cm: Quad, shares: Pair) -> None:
    found = peak_levels(BENCH, (0.0, 0.0), level_cm, (0.0, 0.0), shares)
    assert found == pytest.approx(coasting(BENCH, level_cm, outlets=shares), abs=0.01)


def test_each_pump_fills_the_tanks_that_its_valve_feeds() -> None:
    at = equilibrium(BENCH, (3.0, 3.0))
    rest = np.array(peak_levels(BENCH, (0.2, 0.2), at, (0.0, 0.0)))
    assert rest == pytest.approx(at)
    first = np.array(peak_levels(BENCH, (0.2, 0.2), at, (5.0, 0.0))) - rest
    second = np.array(peak_levels(BENCH, (0.2, 0.2), at, (0.0, 5.0))) - rest
    w1, w2 = 3.33 * 5.0 * 0.2, 3.35 * 5.0 * 0.2
    assert first == pytest.approx([0.7 * w1 / 28, 0.3 * w1 / 32, 0.0, 0.3 * w1 / 32])
    assert second == pytest.approx([0.4 * w2 / 28, 0.6 * w2 / 32, 0.4 * w2 / 28, 0.0])


@pytest.mark.parametrize(("alpha", "beta"), [(1.0, 1.0), (1.0, 2.0), (4.0, 1.0), (1.0, 4.0), (0.25, 4.0), (0.3, 0.05)])
def test_the_closed_form_holds_for_real_double_and_complex_roots(alpha: float, beta: float) -> None:
    """alpha beta^2 = 4 makes the roots equal, and used to divide by nothing."""
    model = TankModel(area_cm2=(20.0, 30.0, 20.0 * alpha, 30.0), outlet_cm2=(0.05 * beta, 0.05, 0.05, 0.05))
    upper, lower = 18.0, 0.5 / beta**2
    assert drained_peak(alpha, beta, upper, lower) == pytest.approx(
        coasting(model, (lower, 0.0, upper, 0.0), for_s=3000.0)[0], abs=0.01
    )
    assert drained_peak(alpha, beta, upper, upper / beta**2) == pytest.approx(upper / beta**2)
    assert drained_peak(alpha, beta, upper, 0.0) <= alpha * upper + 1e-9
    assert drained_peak(alpha, beta, upper, -1.0) == drained_peak(alpha, beta, upper, 0.0)


def watched(
    outlets: Pair = (1.0, 1.0),
    seconds: float = 30.0,
    model: TankModel = BENCH,
    wrong: TankModel = BENCH,
    noise: float = 0.0,
) -> Outlets:
    """Tanks near their equilibrium whose outlets become what they are; what is seen of them at the end."""
    rng = np.random.default_rng(4)
    a1, a2, a3, a4 = model.outlet_cm2
    true = replace(model, outlet_cm2=(outlets[0] * a1, outlets[1] * a2, a3, a4))
    level, seen = np.array(equilibrium(model, (3.0, 3.0))), Outlets()
    for number in range(round(seconds * 10)):
        level = level + 0.1 * np.array(level_rates(true, tuple(level), (3.0, 3.0)))
        read = tuple((level + rng.normal(0.0, noise, 4)).tolist())
        seen = watch(wrong, seen, read, (3.0, 3.0), (number + 1) * DT_NS)
    return seen


@pytest.mark.parametrize("outlets", [(1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (0.3, 0.6), (0.0, 0.0)])
def test_what_is_seen_of_the_outlets_comes_near_the_truth(outlets: Pair) -> None:
    assert watched(outlets).share == pytest.approx(outlets, abs=0.02)
    assert watched(outlets, noise=0.005).share == pytest.approx(outlets, abs=0.1)


def test_with_a_model_that_is_5_percent_wrong_a_clean_outlet_looks_clean() -> None:
    wrong = replace(BENCH, area_cm2=(29.4, 30.4, 29.4, 30.4), pump_gain_cm3_Vs=(3.16, 3.18), valve_split=(0.67, 0.57))
    assert min(watched(wrong=wrong, noise=0.005).share) > 0.8


def test_the_open_share_is_never_more_than_a_clean_outlet_nor_nothing() -> None:
    for share, expected in (
        ((1.3, 0.7), (1.0, 0.7)),
        ((0.7, 1.3), (0.7, 1.0)),
        ((-0.2, 0.0), (MIN_SHARE, MIN_SHARE)),
    ):
        assert Outlets(share, earlier=share).open_share == expected
    assert Outlets().open_share == (1.0, 1.0)


def test_a_share_that_falls_is_extrapolated_until_the_tank_above_has_drained() -> None:
    """0.1 below the earlier one is 1 % a second, and the share is 3 s old; a share that rises is taken as it is."""
    falling = Outlets((0.8, 0.7), earlier=(0.9, 0.9), drain_s=(20.0, 10.0))
    assert falling.open_share == pytest.approx((0.8 - 0.01 * 23.0, 0.7 - 0.02 * 13.0))
    assert falling._replace(earlier=(0.7, 0.6)).open_share == (0.8, 0.7)
    assert falling._replace(earlier=(1.8, 0.9)).open_share[0] == MIN_SHARE


@pytest.mark.parametrize(("tank", "drain_s"), [(0, 22.8), (1, 30.1)])
def test_an_outlet_that_clogs_goes_on_clogging_after_a_trip(tank: int, drain_s: float) -> None:
    """At 2 %/s the tank above drained into one whose outlet had shut meanwhile: 0.5 cm over the rim after a trip."""
    level, seen = np.array(equilibrium(BENCH, (3.0, 3.0))), Outlets()
    for number in range(250):
        open_now = 1.0 - 0.001 * number
        shares = [open_now if i == tank else 1.0 for i in range(4)]
        a1, a2, a3, a4 = (a * share for a, share in zip(BENCH.outlet_cm2, shares, strict=True))
        true = replace(BENCH, outlet_cm2=(a1, a2, a3, a4))
        level = level + 0.1 * np.array(level_rates(true, tuple(level), (3.0, 3.0)))
        seen = watch(BENCH, seen, tuple(level.tolist()), (3.0, 3.0), (number + 1) * DT_NS)
    assert seen.drain_s[tank] == pytest.approx(drain_s, abs=0.1)
    assert seen.open_share[tank] == pytest.approx(open_now - 0.01 * drain_s, abs=0.06)
    assert seen.open_share[1 - tank] > 0.98


def test_a_pump_that_turns_out_to_be_weak_is_no_outlet_that_clogs() -> None:
    """0.6 of its gain: its share fell to 1 in some seconds, which was extrapolated to a trip below 16 cm."""
    weak_V = (0.6 * 3.0, 3.0)
    at = equilibrium(BENCH, weak_V)
    seen = Outlets()
    for number in range(600):
        seen = watch(BENCH, seen, at, (3.0, 3.0), (number + 1) * DT_NS)
    assert seen.share[0] > 1.3
    plain, rebased = seen, rebase(BENCH, seen, at, (weak_V[0] - 3.0, 0.0))
    lowest, lowest_rebased = 1.0, 1.0
    for number in range(600, 700):
        plain = watch(BENCH, plain, at, weak_V, (number + 1) * DT_NS)
        rebased = watch(BENCH, rebased, at, weak_V, (number + 1) * DT_NS)
        lowest, lowest_rebased = min(lowest, plain.open_share[0]), min(lowest_rebased, rebased.open_share[0])
    assert lowest < 0.6
    assert lowest_rebased == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "onset_s", "learned_V"),
    [("pump_effectiveness", math.nan, -1.2), ("pump_effectiveness", 3.0, 0.0), ("valve_split", math.nan, 0.0)],
)
def test_only_a_pump_that_always_was_so_moves_what_was_seen_of_the_outlets(
    kind: str, onset_s: float, learned_V: float
) -> None:
    """A fault with an onset has not been so before."""
    alarm = Alarm(9.0, kind, 1, 0.6, onset_s=onset_s)
    diagnosis = Diagnosis(effectiveness=(0.6, 0.9), new_alarms=(alarm,))
    assert monitors._learned((1.0, 1.0), diagnosis, (3.0, 3.0)) == pytest.approx((learned_V, 0.0))


def test_the_first_look_and_a_look_at_the_same_time_say_nothing() -> None:
    at = equilibrium(BENCH, (3.0, 3.0))
    first = watch(BENCH, Outlets((0.5, 0.6)), at, (0.0, 0.0), SECOND)
    assert first == Outlets((0.5, 0.6), at, SECOND)
    assert watch(BENCH, Outlets(earlier=(0.3, 0.4)), at, (0.0, 0.0), SECOND).earlier == (0.3, 0.4)
    again = watch(BENCH, first, (1.0, 2.0, 3.0, 4.0), (0.0, 0.0), SECOND)
    assert again == Outlets((0.5, 0.6), (1.0, 2.0, 3.0, 4.0), SECOND)


@pytest.mark.parametrize(("jump_cm", "extreme"), [(2.0, -1.0), (-2.0, 3.0)])
def test_a_jump_of_a_level_is_a_sensors_matter_and_moves_it_little(jump_cm: float, extreme: float) -> None:
    """One step weighs a thirtieth, whatever it says."""
    at = equilibrium(BENCH, (3.0, 3.0))
    before = Outlets((1.0, 1.0), at, SECOND)
    jumped = (at[0] + jump_cm, at[1] + jump_cm, at[2], at[3])
    after = watch(BENCH, before, jumped, (3.0, 3.0), SECOND + DT_NS)
    assert after.share == pytest.approx((1.0 + (extreme - 1.0) / 30.0,) * 2)


def test_after_a_stall_the_share_is_what_was_seen_over_it() -> None:
    at = equilibrium(BENCH, (3.0, 3.0))
    after = watch(BENCH, Outlets((0.2, 0.2), at, SECOND), at, (3.0, 3.0), 11 * SECOND)
    assert after.share == pytest.approx((1.0, 1.0))


def test_a_shallow_tank_does_not_magnify_what_is_seen() -> None:
    low = (0.01, 0.01, 0.0, 0.0)
    before = Outlets((1.0, 1.0), (0.01, 0.01, 0.01, 0.01), SECOND)
    after = watch(BENCH, before, low, (1.0, 1.0), SECOND + 3 * SECOND)
    a, s = np.array(BENCH.outlet_cm2[:2]), math.sqrt(2.0 * 981.0)
    inflow = np.array((0.7 * 3.33, 0.6 * 3.35))
    assert after.share == pytest.approx(tuple(inflow / (a * s)))
    assert watch(BENCH, before, (0.01, 0.01, -1e-9, -1e-9), (0.0, 0.0), 4 * SECOND).share == pytest.approx((0.0, 0.0))
