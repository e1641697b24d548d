"""Level filter: the model between readings, the readings within their time constant."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core import estimator
from hil.core.estimator import LevelFilter
from hil.core.tanks import equilibrium
from hil.core.types import Pair, Quad
from tests.core.core_bench import BENCH, PERIOD_S, Plant, measurement, volts
from tests.narrowing import quad

HEALTHY = (1.0, 1.0)
REST = equilibrium(BENCH, (3.0, 3.0))
ALL, NONE = (True,) * 4, (False,) * 4


def filter_with(lag_s: float = 0.0, filter_s: float = 0.5) -> estimator.LevelFilter:
    return LevelFilter(BENCH, (lag_s, lag_s), filter_s)


def started(
    filter_: estimator.LevelFilter, level_cm: tuple[float, ...] = REST, applied_V: Pair = (3.0, 3.0)
) -> estimator.Estimate:
    return estimator.start(filter_, measurement(volts(level_cm)), applied_V)


def test_begins_at_the_readings() -> None:
    estimate = started(filter_with())
    assert estimate.level_cm == pytest.approx(REST)
    assert estimate.level_V == volts(REST)
    assert estimate.pump_V == (3.0, 3.0)
    assert estimate.innovation_V == (0.0, 0.0, 0.0, 0.0)


def test_rests_at_the_equilibrium() -> None:
    filter_ = filter_with(lag_s=0.2)
    estimate = started(filter_)
    for _ in range(100):
        estimate = estimator.step(filter_, estimate, (3.0, 3.0), HEALTHY, measurement(volts(REST)), PERIOD_S)
    assert estimate.level_cm == pytest.approx(REST, abs=1e-9)
    assert estimate.innovation_V == pytest.approx((0, 0, 0, 0), abs=1e-9)


@pytest.mark.parametrize("applied_V", [(6.0, 1.0), (0.0, 5.0), (8.0, 8.0)])
def test_without_readings_the_model_alone_follows_the_tanks(applied_V: Pair) -> None:
    filter_, plant = filter_with(), Plant()
    estimate = started(filter_)
    for _ in range(300):
        plant.advance(applied_V, PERIOD_S)
        if max(plant.level_cm) > 19.0:
            break
        blind = measurement((math.nan,) * 4, valid=NONE, readings=0)
        estimate = estimator.step(filter_, estimate, applied_V, HEALTHY, blind, PERIOD_S)
        assert estimate.level_cm == pytest.approx(plant.level_cm, abs=2e-3)
        assert all(map(math.isnan, estimate.innovation_V))


def test_pump_lag_delays_the_flow_and_no_water_is_lost_to_it() -> None:
    """What the lag withholds in the end is its time constant's worth of the step."""
    filter_ = filter_with(lag_s=0.4)
    lagged = started(filter_, applied_V=(0.0, 0.0))
    blind = measurement((math.nan,) * 4, valid=NONE, readings=0)
    drive_Vs, passed_s = 0.0, 0.0
    for _ in range(40):
        before = lagged.pump_V[0]
        lagged = estimator.step(filter_, lagged, (5.0, 5.0), HEALTHY, blind, PERIOD_S)
        passed_s += PERIOD_S
        assert lagged.pump_V == pytest.approx((5.0 * (1.0 - math.exp(-passed_s / 0.4)),) * 2)
        drive_Vs += 5.0 * PERIOD_S - 0.4 * (lagged.pump_V[0] - before)
    assert drive_Vs == pytest.approx(5.0 * (4.0 - 0.4), rel=1e-3)


def test_level_rises_by_just_the_flow_that_came_through_the_lag() -> None:
    filter_ = filter_with(lag_s=0.4)
    blind = measurement((math.nan,) * 4, valid=NONE, readings=0)
    still = estimator.step(filter_, started(filter_), (3.0, 3.0), HEALTHY, blind, PERIOD_S)
    after = estimator.step(filter_, started(filter_), (5.0, 3.0), HEALTHY, blind, PERIOD_S)
    volt_s = 2.0 * (PERIOD_S - 0.4 * (1.0 - math.exp(-PERIOD_S / 0.4)))
    rise = [a - b for a, b in zip(after.level_cm, still.level_cm, strict=True)]
    assert rise == pytest.approx([0.7 * 3.33 / 28.0 * volt_s, 0.0, 0.0, 0.3 * 3.33 / 32.0 * volt_s], rel=5e-3, abs=2e-5)


def test_a_wrong_start_decays_with_the_filters_time_constant() -> None:
    filter_ = filter_with(filter_s=0.5)
    wrong = tuple(h + 1.0 for h in REST)
    estimate = started(filter_, wrong)
    for _ in range(5):
        estimate = estimator.step(filter_, estimate, (3.0, 3.0), HEALTHY, measurement(volts(REST)), PERIOD_S)
    left = estimate.level_cm[0] - REST[0]
    assert left == pytest.approx(math.exp(-0.5 / 0.5), rel=0.03)


def test_innovation_is_reading_minus_prediction() -> None:
    filter_ = filter_with()
    read = tuple(y + d for y, d in zip(volts(REST), (0.1, -0.1, 0.02, -0.02), strict=True))
    estimate = estimator.step(filter_, started(filter_), (3.0, 3.0), HEALTHY, measurement(read), PERIOD_S)
    assert estimate.innovation_V == pytest.approx((0.1, -0.1, 0.02, -0.02), abs=1e-9)
    share = 1.0 - math.exp(-PERIOD_S / 0.5)
    assert estimate.level_V[0] == pytest.approx(0.5 * REST[0] + share * 0.1)


def test_a_filter_time_of_zero_believes_the_readings() -> None:
    filter_ = filter_with(filter_s=0.0)
    read = (5.0, 6.0, 1.0, 0.5)
    estimate = estimator.step(filter_, started(filter_), (3.0, 3.0), HEALTHY, measurement(read), PERIOD_S)
    assert estimate.level_V == pytest.approx(read)


@pytest.mark.parametrize("channel", range(4))
def test_a_channel_that_is_not_valid_is_only_predicted(channel: int) -> None:
    filter_ = filter_with()
    valid = quad(i != channel for i in range(4))
    read = tuple(y + 0.2 for y in volts(REST))
    estimate = estimator.step(filter_, started(filter_), (3.0, 3.0), HEALTHY, measurement(read, valid=valid), PERIOD_S)
    for i in range(4):
        assert math.isnan(estimate.innovation_V[i]) == (i == channel)
        moved = estimate.level_V[i] - volts(REST)[i]
        assert moved == pytest.approx(0.0 if i == channel else 0.2 * (1.0 - math.exp(-0.2)), abs=1e-9)


@pytest.mark.parametrize("nonsense", [math.nan, math.inf, -math.inf])
def test_a_reading_that_is_no_number_does_not_reach_the_estimate(nonsense: float) -> None:
    filter_ = filter_with()
    read = (nonsense, *volts(REST)[1:])
    estimate = estimator.step(filter_, started(filter_), (3.0, 3.0), HEALTHY, measurement(read), PERIOD_S)
    assert estimate.level_cm == pytest.approx(REST, abs=1e-9)


def test_old_readings_are_not_used_twice() -> None:
    filter_ = filter_with()
    read = measurement(tuple(y + 0.2 for y in volts(REST)), readings=0)
    estimate = estimator.step(filter_, started(filter_), (3.0, 3.0), HEALTHY, read, PERIOD_S)
    assert estimate.level_cm == pytest.approx(REST, abs=1e-9)


def test_a_known_loss_of_gain_is_in_the_prediction() -> None:
    filter_, plant = filter_with(), Plant()
    plant.effectiveness = (0.4, 0.7)
    estimate = started(filter_)
    blind = measurement((math.nan,) * 4, valid=NONE, readings=0)
    for _ in range(100):
        plant.advance((3.0, 3.0), PERIOD_S)
        estimate = estimator.step(filter_, estimate, (3.0, 3.0), (0.4, 0.7), blind, PERIOD_S)
    assert estimate.level_cm == pytest.approx(plant.level_cm, abs=1e-3)
    assert estimate.level_cm[0] < REST[0] - 1.0


LEVELS = st.tuples(*[st.floats(0.0, 20.0)] * 4)
VOLTS = st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 10.0))
READINGS = st.tuples(*[st.floats(-1.0, 11.0)] * 4)


@settings(max_examples=100, deadline=None)
@given(LEVELS, VOLTS, READINGS, st.floats(0.001, 0.5), st.sampled_from([0.0, 0.2]), st.sampled_from([0.0, 0.5]))
def test_no_level_is_negative(
    levels: Quad, applied: Pair, read: Quad, period_s: float, lag_s: float, filter_s: float
) -> None:
    filter_ = filter_with(lag_s, filter_s)
    estimate = estimator.step(filter_, started(filter_, levels), applied, HEALTHY, measurement(read), period_s)
    assert min(estimate.level_cm) >= 0.0
    assert estimate.level_V == pytest.approx(volts(estimate.level_cm))


@settings(max_examples=50, deadline=None)
@given(LEVELS, st.floats(0.001, 0.5))
def test_a_predicted_level_does_not_pass_the_rim(levels: Quad, period_s: float) -> None:
    filter_ = filter_with()
    estimate = started(filter_, levels)
    blind = measurement((math.nan,) * 4, valid=NONE, readings=0)
    for _ in range(20):
        estimate = estimator.step(filter_, estimate, (50.0, 50.0), HEALTHY, blind, period_s)
        assert max(estimate.level_cm) <= BENCH.height_cm[0]


def test_full_tanks_stay_full_at_the_rim() -> None:
    filter_ = filter_with()
    estimate = started(filter_, (20.0,) * 4, (100.0, 100.0))
    blind = measurement((math.nan,) * 4, valid=NONE, readings=0)
    estimate = estimator.step(filter_, estimate, (100.0, 100.0), HEALTHY, blind, PERIOD_S)
    assert estimate.level_cm == (20.0,) * 4


def test_no_time_gone_moves_nothing() -> None:
    filter_ = filter_with(lag_s=0.2)
    before = started(filter_)
    after = estimator.step(filter_, before, (9.0, 9.0), HEALTHY, measurement((1.0,) * 4), 0.0)
    assert after.level_cm == before.level_cm
    assert after.pump_V == before.pump_V
