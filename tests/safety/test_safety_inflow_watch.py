"""The inflow watch: a sensor that drifts downwards too slowly for the diagnosis, and what must not look like it."""

import math
from collections.abc import Callable
from dataclasses import replace
from math import inf

import pytest

from hil.core.inflow_watch import LEARN_S, MIN_RATIO, RANGE, SMOOTHING_S, InflowWatch, watch_inflow
from hil.core.tanks import TankModel, equilibrium, level_rates
from hil.core.types import Alarm, Diagnosis, Pair, Quad
from tests.narrowing import quad
from tests.safety.safety_bench import BENCH, doubted

SECOND = 1_000_000_000
NOTHING = (-inf, -inf)
HEALTHY = Diagnosis()
NAMED = Diagnosis(new_alarms=(Alarm(1.0, "leak", 1, 0.2, isolated_s=1.0),))
UNRESOLVED = Diagnosis(new_alarms=(Alarm(1.0, "unresolved", 0, math.nan),))


def watched(
    truth: Callable[[float], tuple[TankModel, Pair]],
    reading: Callable[[float, Quad], Quad] = lambda _, level_cm: level_cm,
    told_V: Callable[[float, Pair], Pair] = lambda _, pump_V: pump_V,
    seconds: float = 900.0,
) -> InflowWatch:
    """The watch after a run of these tanks, by steps of 1 s.

    truth : tanks and what the pumps really deliver, by time. reading : what the sensors show. told_V : the voltages.
    """
    watch, level = InflowWatch(), equilibrium(BENCH, (3.0, 3.0))
    for number in range(round(seconds)):
        model, pump_V = truth(float(number))
        for _ in range(4):
            rates = level_rates(model, level, pump_V)
            level = quad(h + 0.25 * rate for h, rate in zip(level, rates, strict=True))
        shown = reading(float(number), level)
        watch = watch_inflow(BENCH, watch, shown, told_V(float(number), pump_V), HEALTHY, (number + 1) * SECOND)
    return watch


def rest(_: float) -> tuple[TankModel, Pair]:
    return BENCH, (3.0, 3.0)


def test_at_rest_the_ratio_is_that_of_a_clean_outlet_and_is_learned_after_two_minutes() -> None:
    young, old = watched(rest, seconds=LEARN_S), watched(rest, seconds=LEARN_S + 1)
    assert young.ratio == pytest.approx((1.0, 1.0), abs=1e-3)
    assert young.learned == (0.0, 0.0)
    assert old.learned == old.ratio
    assert old.age_s == LEARN_S
    assert young.possible_cm(BENCH, (12.0, 13.0, 1.0, 1.0), HEALTHY) == NOTHING


@pytest.mark.parametrize("tank", [0, 1])
def test_more_and_more_water_for_the_same_reading_means_a_level_that_may_be_higher(tank: int) -> None:
    """A drift of -0.7 mV/s at rest raised no alarm, and the tank filled up to 18.5 cm in 75 minutes."""
    at_rest = equilibrium(BENCH, (3.0, 3.0))

    def rising(t_s: float) -> tuple[TankModel, Pair]:
        more = 3.0 + 0.5 * max(t_s - 200.0, 0.0) / 1800.0
        return BENCH, (more, more)

    def held(_: float, level_cm: Quad) -> Quad:
        return quad(at_rest[i] if i == tank else h for i, h in enumerate(level_cm))

    watch = watched(rising, held, seconds=2000.0)
    true_cm = equilibrium(BENCH, (3.5, 3.5))
    shown = held(0.0, true_cm)
    possible = watch.possible_cm(BENCH, shown, HEALTHY)
    assert possible[tank] == pytest.approx(true_cm[tank], abs=0.7)
    assert possible[1 - tank] == -inf
    assert watch.possible_cm(BENCH, shown, Diagnosis(trusted=doubted(tank))) == NOTHING


@pytest.mark.parametrize("pump", [0, 1])
def test_a_pump_that_fades_without_a_name_does_not_look_like_it(pump: int) -> None:
    """More voltage, but not more water: the upper levels show it."""

    def told(t_s: float, pump_V: Pair) -> Pair:
        weak = pump_V[pump] * (1.0 + t_s / 900.0)
        return (weak, pump_V[1]) if pump == 0 else (pump_V[0], weak)

    assert watched(rest, told_V=told).ratio == pytest.approx((1.0, 1.0), abs=0.02)


@pytest.mark.parametrize("tank", [2, 3])
def test_an_upper_outlet_that_clogs_does_not_look_like_it(tank: int) -> None:
    """The upper level rises, but no more water leaves that tank than its pump gives."""

    def clogging(t_s: float) -> tuple[TankModel, Pair]:
        outlets = quad(a * (1.0 - 0.6 * t_s / 900.0 if i == tank else 1.0) for i, a in enumerate(BENCH.outlet_cm2))
        return replace(BENCH, outlet_cm2=outlets), (3.0, 3.0)

    assert watched(clogging).ratio == pytest.approx((1.0, 1.0), abs=0.05)


def test_an_error_of_the_rig_file_is_learned() -> None:
    wider = replace(BENCH, outlet_cm2=(0.080, 0.064, 0.071, 0.057), pump_gain_cm3_Vs=(4.2, 4.2))
    watch = watched(lambda _: (wider, (2.4, 2.4)), seconds=400.0)
    assert min(watch.ratio) > 0.8
    assert watch.ratio == pytest.approx(watch.learned, abs=0.05)
    assert watch.possible_cm(BENCH, (12.0, 13.0, 1.0, 1.0), HEALTHY) == NOTHING


@pytest.mark.parametrize("strength", [1.0, 1.3])
@pytest.mark.parametrize("bend", [-0.03, 0.03])
@pytest.mark.parametrize("step_V", [-1.2, 1.0])
def test_pumps_with_a_curve_that_the_file_does_not_have_do_not_look_like_it(
    strength: float, bend: float, step_V: float
) -> None:
    """The ratio rose when the voltage of such a pump changed, and healthy runs were stopped."""

    def voltage(t_s: float) -> float:
        return 3.5 + step_V * min(max(t_s - 200.0, 0.0) / 30.0, 1.0)

    def moved(t_s: float) -> tuple[TankModel, Pair]:
        x = voltage(t_s) - 0.5
        flow_V = strength * x * (1.0 + bend * x)
        return BENCH, (flow_V, flow_V)

    watch = InflowWatch()
    highest = 0.0

    def told(t_s: float, _: Pair) -> Pair:
        return voltage(t_s), voltage(t_s)

    for seconds in (200.0, 260.0, 330.0, 500.0):
        watch = watched(moved, told_V=told, seconds=seconds)
        highest = max(highest, *(now / then for now, then in zip(watch.ratio, watch.learned, strict=True)))
    assert highest < 1.06


def test_what_the_diagnosis_names_is_learned_again() -> None:
    before = InflowWatch((1.2, 1.3), (1.0, 1.0), 300.0, (12.0, 13.0, 1.6, 1.4), SECOND)
    at = (12.1, 13.1, 1.7, 1.5)
    again = watch_inflow(BENCH, before, at, (3.0, 3.0), NAMED, 2 * SECOND)
    assert again == InflowWatch(level_cm=at, watched_ns=2 * SECOND)
    assert watch_inflow(BENCH, before, at, (3.0, 3.0), UNRESOLVED, 2 * SECOND).learned == (1.0, 1.0)
    assert watch_inflow(BENCH, before, at, (3.0, 3.0), HEALTHY, SECOND) == InflowWatch(level_cm=at, watched_ns=SECOND)


def test_one_step_counts_for_little_and_a_small_increase_for_nothing() -> None:
    level = (10.0, 10.0, 1.0, 1.0)
    before = InflowWatch((1.0, 1.0), (1.0, 1.0), 300.0, level, 0)
    for jump_cm, extreme in ((-5.0, RANGE[1]), (5.0, RANGE[0])):
        jumped = (10.0 + jump_cm, 10.0 + jump_cm, 1.0, 1.0)
        after = watch_inflow(BENCH, before, jumped, (3.0, 3.0), HEALTHY, SECOND)
        assert after.ratio == pytest.approx((1.0 + (extreme - 1.0) / SMOOTHING_S,) * 2)
    small, large = MIN_RATIO - 1e-6, MIN_RATIO + 1e-6
    watch = before._replace(ratio=(small, large))
    assert watch.possible_cm(BENCH, level, HEALTHY) == pytest.approx((-inf, 12.1), abs=1e-4)
    assert watch._replace(ratio=(0.5, 0.5)).possible_cm(BENCH, level, HEALTHY) == NOTHING


def test_what_had_risen_in_the_start_phase_is_not_learned() -> None:
    """A drift that began while the tanks filled was learned, and the tank ran over after time 0."""
    level = equilibrium(BENCH, (3.0, 3.0))
    watch = InflowWatch(level_cm=level, watched_ns=0)
    for number in range(1, round(LEARN_S) + 1):
        watch = watch_inflow(BENCH, watch, level, (3.0, 3.0), HEALTHY, number * SECOND, (1.15, 1.0))
    assert watch.ratio == pytest.approx((1.0, 1.0))
    assert watch.learned == pytest.approx((1.0 / 1.15, 1.0))
    possible = watch.possible_cm(BENCH, level, HEALTHY)
    assert possible == pytest.approx((level[0] * 1.15**2, -inf))
    assert watch_inflow(BENCH, watch, level, (3.0, 3.0), HEALTHY, 200 * SECOND, (1.3, 1.3)).learned == watch.learned
