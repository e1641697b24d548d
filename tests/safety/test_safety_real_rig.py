"""Overshoot, dry watch and inflow watch on tanks whose outlets lie below their zero, and of different heights."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.dry_watch import DryWatch, watch_dry
from hil.core.inflow_watch import InflowWatch, watch_inflow
from hil.core.overshoot import Outlets, peak_levels, watch
from hil.core.tanks import TankModel, equilibrium, level_rates
from hil.core.types import Diagnosis, Pair, Quad
from tests.narrowing import quad
from tests.safety.safety_bench import ALL, BENCH
from tests.safety.test_safety_overshoot import coasting

SECOND = 1_000_000_000
DATUM = (5.0, 6.0, 4.0, 3.0)
AT_REST = equilibrium(BENCH, (3.0, 3.0))
DEEP = replace(
    BENCH,
    datum_cm=DATUM,
    outlet_cm2=quad(a * math.sqrt(h / (h + d)) for a, h, d in zip(BENCH.outlet_cm2, AT_REST, DATUM, strict=True)),
)
"""Tanks with the paper's levels at 3 V, but with outlets below their zero."""

DATUMS = st.tuples(*[st.one_of(st.just(0.0), st.floats(0.1, 40.0))] * 4)
LEVELS = st.tuples(*[st.floats(0.01, 20.0)] * 4)


def test_the_deep_tanks_have_the_papers_levels() -> None:
    assert equilibrium(DEEP, (3.0, 3.0)) == pytest.approx(AT_REST)


@settings(max_examples=25, deadline=None)
@given(DATUMS, LEVELS)
def test_no_peak_is_higher_than_predicted_and_no_prediction_higher_than_all_water(datum: Quad, level_cm: Quad) -> None:
    model = replace(BENCH, datum_cm=datum)
    found = np.array(peak_levels(model, (0.0, 0.0), level_cm, (9.0, 9.0)))
    assert np.all(found >= coasting(model, level_cm) - 0.01)
    for lower, upper in ((0, 2), (1, 3)):
        alone = level_cm[lower] + level_cm[upper] * model.area_cm2[upper] / model.area_cm2[lower]
        assert found[lower] <= alone + 1e-9


@settings(max_examples=15, deadline=None)
@given(st.floats(0.0, 40.0), st.floats(0.0, 40.0), LEVELS)
def test_with_the_datum_of_a_lower_tank_alone_the_peak_is_exact(first: float, second: float, level_cm: Quad) -> None:
    model = replace(BENCH, datum_cm=(first, second, 0.0, 0.0))
    assert peak_levels(model, (0.0, 0.0), level_cm, (9.0, 9.0)) == pytest.approx(coasting(model, level_cm), abs=0.01)


@pytest.mark.parametrize("side", [0, 1])
def test_all_water_of_a_nearly_empty_tank_above_is_little(side: int) -> None:
    """The closed form takes water for there that the datum only adds to the head: 5 cm too much under a shut outlet."""
    model = replace(BENCH, datum_cm=(0.0, 0.0, 5.0, 5.0))
    level_cm = (10.0, 10.0, 0.4, 0.3)
    share = (0.02, 1.0) if side == 0 else (1.0, 0.02)
    assert peak_levels(model, (0.0, 0.0), level_cm, (0.0, 0.0), share)[side] == pytest.approx(
        10.0 + level_cm[2 + side], abs=1e-9
    )


def test_each_pump_delivers_for_its_own_lag_and_delay() -> None:
    rest = np.array(peak_levels(BENCH, (0.2, 0.7), AT_REST, (0.0, 0.0)))
    late = np.array(peak_levels(BENCH, (0.2, 0.7), AT_REST, (5.0, 4.0))) - rest
    w1, w2 = 3.33 * 5.0 * 0.2, 3.35 * 4.0 * 0.7
    assert late[2:] == pytest.approx([0.4 * w2 / 28, 0.3 * w1 / 32])


def simulated(pump_V: Pair, left: Pair, seconds: float, start: Quad = AT_REST) -> list[Quad]:
    """Levels of the deep tanks by steps of 0.1 s, with these shares of the pumps' flow left."""
    level, levels = start, []
    for _ in range(round(10 * seconds)):
        rates = level_rates(DEEP, level, (left[0] * pump_V[0], left[1] * pump_V[1]))
        level = quad(max(h + 0.1 * rate, 0.0) for h, rate in zip(level, rates, strict=True))
        levels.append(level)
    return levels


def test_a_clean_outlet_is_seen_as_clean_and_a_shut_one_as_shut() -> None:
    seen = Outlets()
    for number, level in enumerate(simulated((3.0, 3.0), (1.0, 1.0), 30.0)):
        seen = watch(DEEP, seen, level, (3.0, 3.0), (number + 1) * SECOND // 10)
    assert seen.share == pytest.approx((1.0, 1.0), abs=1e-3)
    shut = replace(DEEP, outlet_cm2=(1e-9, *DEEP.outlet_cm2[1:]))
    level = AT_REST
    for number in range(300, 600):
        rates = level_rates(shut, level, (3.0, 3.0))
        level = quad(h + 0.1 * rate for h, rate in zip(level, rates, strict=True))
        seen = watch(DEEP, seen, level, (3.0, 3.0), (number + 1) * SECOND // 10)
    assert seen.share == pytest.approx((0.0, 1.0), abs=0.01)


def test_the_time_in_which_a_tank_drains_ends_when_it_is_empty() -> None:
    levels = simulated((0.0, 0.0), (0.0, 0.0), 60.0)
    seen = watch(DEEP, Outlets(level_cm=AT_REST), AT_REST, (0.0, 0.0), SECOND)
    for place, tank in enumerate((2, 3)):
        empty_s = 0.1 * next(number for number, level in enumerate(levels, 1) if level[tank] <= 0.0)
        assert seen.drain_s[place] == pytest.approx(empty_s, abs=0.5)
    assert watch(DEEP, Outlets(level_cm=(9.0, 9.0, 0.0, 0.0)), (9.0, 9.0, 0.0, 0.0), (0.0, 0.0), SECOND).drain_s == (
        0.0,
        0.0,
    )


def dry(levels: list[Quad], pump_V: Pair, model: TankModel = DEEP) -> DryWatch:
    state = DryWatch()
    for number, level in enumerate(levels):
        state = watch_dry(model, state, level, pump_V, ALL, (number + 1) * SECOND // 10)
    return state


def test_water_that_arrives_in_deep_tanks_is_seen() -> None:
    rest = dry(simulated((3.0, 3.0), (1.0, 1.0), 30.0), (3.0, 3.0))
    assert rest.share == pytest.approx((1.0, 1.0), abs=1e-3)
    half = dry(simulated((3.0, 3.0), (1.0, 0.95), 30.0), (3.0, 3.0))
    assert half.share == pytest.approx((1.0, 0.95), abs=0.01)


def test_an_empty_tank_that_draws_all_its_water_is_not_dry() -> None:
    """Its outlet could carry more than arrives: nothing is to be seen in it, and nothing is said."""
    levels = [(9.0, 9.0, 0.0, 0.0)] * 300
    assert dry(levels, (1.5, 1.5)).share == pytest.approx((1.0, 1.0))
    assert dry(levels, (3.0, 3.0), BENCH).is_dry


def inflow(level: Quad, told_V: Pair, seconds: int = 300, earlier: InflowWatch | None = None) -> InflowWatch:
    state = earlier or InflowWatch()
    begin = 0 if earlier is None else earlier.watched_ns // SECOND
    for number in range(begin, begin + seconds):
        state = watch_inflow(DEEP, state, level, told_V, Diagnosis(), (number + 1) * SECOND)
    return state


def test_more_water_for_the_same_reading_means_a_higher_head() -> None:
    """20 % more flow is held by 44 % more head; the datum is no level."""
    rest = inflow(AT_REST, (3.0, 3.0))
    assert rest.ratio == pytest.approx((1.0, 1.0), abs=1e-6)
    risen = rest._replace(ratio=(1.2, 1.0))
    possible = risen.possible_cm(DEEP, AT_REST, Diagnosis())
    assert possible[0] == pytest.approx(1.44 * (AT_REST[0] + DATUM[0]) - DATUM[0])
    assert possible[1] == -math.inf
    more = inflow(equilibrium(DEEP, (3.3, 3.3)), (3.3, 3.3), earlier=rest)
    assert more.ratio == pytest.approx((1.0, 1.0), abs=0.01)


def test_a_lower_tank_that_is_nearly_empty_is_judged_as_if_it_held_a_centimetre() -> None:
    a1, g = DEEP.outlet_cm2[0], DEEP.gravity_cm_s2
    level = (0.2, AT_REST[1], AT_REST[2], AT_REST[3])
    clean = a1 * math.sqrt(2.0 * g * (1.0 + DATUM[0]))
    arrives = 0.7 * 3.33 * 3.0 + DEEP.outlet_cm2[2] * math.sqrt(2.0 * g * (AT_REST[2] + DATUM[2]))
    assert inflow(level, (3.0, 3.0)).ratio[0] == pytest.approx(arrives / clean, rel=1e-6)
