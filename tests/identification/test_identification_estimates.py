"""What the fit finds: the true parameters, with the scatter that the noise allows, from records of many kinds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.core.identification.estimate import RigEstimate, estimate
from hil.core.identification.parameters import Choice, RigModel, values_of, with_values
from hil.core.identification.records import LevelRecord, RulerReading
from hil.core.identification.simulation import simulate
from hil.core.sensors import LevelSensors
from hil.core.tanks import TankModel
from tests.identification.emulated import emulated, settings_with, truth_of
from tests.identification.made_records import Array, record_of, steps

TRUTH = with_values(
    RigModel(),
    {"k1": 3.8, "k2": 2.9, "gamma1": 0.63, "gamma2": 0.68, "a1": 0.062, "a2": 0.064, "a3": 0.078, "a4": 0.05}
    | {"lag1": 0.15, "lag2": 0.3},
)
START = RigModel()
INITIAL = (8.0, 9.0, 1.5, 2.0)
FREE, FIXED = Choice("free"), Choice("fixed")


def moving(seed: int, duration_s: float = 150.0) -> Array:
    return steps(seed, duration_s, 0.1, low_V=1.5, high_V=4.5, hold_s=10.0)


def off_by_sd(found: RigEstimate, truth: RigModel) -> Array:
    """How far the parameters are from the truth, in standard deviations."""
    true, sd = values_of(truth), np.sqrt(np.diag(found.covariance))
    return np.array([(found[name] - true[name]) / sd[found.names.index(name)] for name in found.parameters])


def test_the_emulated_rig_is_found_from_its_frames() -> None:
    voltage_V = steps(3, 120.0, 0.1, low_V=2.0, high_V=4.5, hold_s=10.0)
    record, rig = emulated(settings_with({"pumps": {"lag_s": (0.15, 0.3)}}, spread=0.2), 7, voltage_V)
    truth = truth_of(rig.parameters)
    found = estimate([record], START)
    true = values_of(truth)
    shares = [abs(found[name] / true[name] - 1.0) for name in found.parameters if "lag" not in name]
    assert max(shares) < 0.004
    assert np.abs(off_by_sd(found, truth)).max() < 4.0
    assert found.noise.noise_V == pytest.approx((0.005,) * 4, rel=0.05)


@pytest.mark.long
def test_the_scatter_of_the_estimates_is_the_cramer_rao_bound() -> None:
    voltage_V = moving(5)
    off = [
        off_by_sd(estimate([record_of(TRUTH, voltage_V, 0.1, INITIAL, seed=seed)], TRUTH), TRUTH) for seed in range(6)
    ]
    assert np.mean(np.square(off)) == pytest.approx(1.0, abs=0.5)


def test_outliers_move_the_estimate_by_less_than_its_noise() -> None:
    record = record_of(TRUTH, moving(6), 0.1, INITIAL)
    reading_V = record.reading_V.copy()
    random = np.random.default_rng(1)
    wild = random.random(reading_V.shape) < 0.02
    reading_V[wild] = random.uniform(0.0, 10.0, int(wild.sum()))
    clean, dirty = estimate([record], START), estimate([replace(record, reading_V=reading_V)], START)
    sd = np.sqrt(np.diag(clean.covariance))
    count = len(clean.parameters)
    assert np.abs((dirty.values - clean.values) / sd)[:count].max() < 1.5
    assert dirty.noise.noise_V == pytest.approx(clean.noise.noise_V, rel=0.15)


def test_readings_cut_off_at_both_ends_do_not_pull_the_estimate() -> None:
    """Taken as readings, those of a saturated sensor would say that its tank stays at the end of its range."""
    truth = replace(TRUTH, sensors=LevelSensors(offset_V=(0.0, 0.0, -0.3, 0.0)))
    record = record_of(truth, moving(7, 240.0), 0.1, INITIAL, saturation_V=(0.0, 6.0))
    share = np.mean((record.reading_V <= record.ends[0]) | (record.reading_V >= record.ends[1]), axis=0)
    assert 0.1 < share[0] < 0.7
    assert 0.03 < share[2] < 0.7
    found = estimate([record], replace(START, sensors=truth.sensors))
    assert np.abs(off_by_sd(found, truth)).max() < 4.0


@pytest.mark.parametrize("lost", [(2, 3), (3,)])
def test_the_lower_sensors_are_enough(lost: tuple[int, ...]) -> None:
    record = record_of(TRUTH, moving(8, 240.0), 0.1, INITIAL)
    reading_V = record.reading_V.copy()
    reading_V[:, list(lost)] = np.nan
    found = estimate([replace(record, reading_V=reading_V)], START)
    assert np.abs(off_by_sd(found, TRUTH)).max() < 4.0
    seen = simulate(found.model, replace(record, reading_V=reading_V), found.initial(0))
    assert np.isnan(seen.predicted_V[:, list(lost)]).all()


def test_without_a_lower_sensor_its_side_is_known_only_as_far_as_the_other_shows_it() -> None:
    record = record_of(TRUTH, moving(8, 240.0), 0.1, INITIAL)
    reading_V = record.reading_V.copy()
    reading_V[:, 0] = np.nan
    found = estimate([replace(record, reading_V=reading_V)], START)
    assert (1.0 - found["gamma1"]) * found["k1"] == pytest.approx((1.0 - 0.63) * 3.8, rel=0.005)
    assert [found[name] for name in ("k2", "gamma2", "a2", "a3", "a4")] == pytest.approx(
        [2.9, 0.68, 0.064, 0.078, 0.05], rel=0.005
    )
    assert found["a1"] == pytest.approx(0.071, rel=1e-6)


def test_several_records_share_parameters_and_have_initial_levels_of_their_own() -> None:
    empty = (0.0, 0.0, 0.0, 0.0)
    first = replace(record_of(TRUTH, moving(9), 0.1, empty, name="filling"), initial_cm=empty)
    second = record_of(TRUTH, moving(10), 0.1, INITIAL, name="second", seed=1)
    found = estimate([first, second], START)
    assert found.names[len(found.parameters) :] == tuple(f"h{i} of second" for i in (1, 2, 3, 4))
    assert found.initial(0) == empty
    assert found.initial(1) == pytest.approx(INITIAL, abs=0.02)
    assert np.abs(off_by_sd(found, TRUTH)).max() < 4.0
    alone = estimate([first], START)
    assert (np.diag(found.covariance)[:8] < np.diag(alone.covariance)[:8]).all()


def test_means_of_readings_count_by_their_number() -> None:
    record = record_of(replace(TRUTH, noise_V=(0.005 / 5**0.5,) * 4), moving(11), 0.1, INITIAL)
    found = estimate([replace(record, samples=np.full((len(record.time_s), 4), 5.0))], START)
    assert found.noise.noise_V == pytest.approx((0.005,) * 4, rel=0.08)


def test_sensors_are_found_by_the_ruler_though_one_falls_with_the_level() -> None:
    gains, offsets = (0.52, -0.4, 0.49, 0.5), (0.1, 8.5, -0.1, 0.05)
    truth = replace(TRUTH, sensors=LevelSensors(gain_V_cm=gains, offset_V=offsets))
    empty = (0.0, 0.0, 0.0, 0.0)
    voltage_V = moving(12, 240.0)
    record = replace(record_of(truth, voltage_V, 0.1, empty), initial_cm=empty)
    level_cm = simulate(truth, record, empty).level_cm
    reads = [(150.0, 0), (150.0, 1), (100.0, 2), (100.0, 3)]
    ruler = tuple(RulerReading(at_s, tank, float(level_cm[round(at_s * 10), tank]), 0.02) for at_s, tank in reads)
    found = estimate([replace(record, ruler=ruler)], START, {"sensor_gain": FREE, "sensor_offset": FREE})
    assert found.model.sensors.gain_V_cm == pytest.approx(gains, rel=0.02)
    assert found.model.sensors.offset_V == pytest.approx(offsets, abs=0.005)
    assert np.abs(off_by_sd(found, truth)).max() < 4.0


def test_what_is_fixed_stays_and_a_prior_holds_what_the_record_does_not_tell() -> None:
    record = record_of(TRUTH, np.full((600, 2), 3.0), 0.1, INITIAL)
    start = with_values(TRUTH, {"lag1": 0.4})
    found = estimate([record], start, {"k1": FIXED, "gamma": Choice("prior", 0.01), "lag": Choice("prior", 0.05)})
    assert found.model.tanks.pump_gain_cm3_Vs[0] == 3.8
    assert "k1" not in found.names
    assert found["lag1"] == pytest.approx(0.4, abs=0.001)
    sd = np.sqrt(np.diag(found.covariance))
    assert sd[found.names.index("lag1")] == pytest.approx(0.05, rel=0.01)


def test_what_no_reading_depends_on_stays_at_the_start() -> None:
    """Without an anchor the outlet of a tank that is always empty wandered to a limit."""
    voltage_V = moving(13)
    voltage_V[:, 0] = 0.0
    record = replace(record_of(TRUTH, voltage_V, 0.1, (5.0, 6.0, 1.0, 0.0)), initial_cm=(5.0, 6.0, 1.0, 0.0))
    found = estimate([record], START)
    for name in ("k1", "gamma1", "a4", "lag1"):
        assert found[name] == pytest.approx(values_of(START)[name], rel=1e-6)
    assert found["a3"] == pytest.approx(0.078, rel=0.01)


def test_a_start_at_which_an_upper_tank_is_always_empty_is_left() -> None:
    """There no parameter of that tank moves a reading, and the fit stayed with residuals of 70 mV."""
    record = record_of(TRUTH, moving(14), 0.1, INITIAL)
    start = with_values(START, {"a3": 0.6, "datum3": 2.0, "gamma2": 0.85})
    found = estimate([record], start, {"datum": FREE}, limits={"a": (0.02, 2.0)})
    assert found.noise.noise_V == pytest.approx((0.005,) * 4, rel=0.1)


def test_one_pump_two_tanks_and_a_reading_every_four_seconds() -> None:
    """A pump with an offset (a negative dead zone), no flow past the upper tank, and one sensor."""
    tanks = TankModel(area_cm2=(100.0,) * 4, pump_gain_cm3_Vs=(1.0, 4.0), valve_split=(0.5, 0.0))
    rig = RigModel(tanks=tanks, lag_s=(0.0, 0.0), noise_V=(0.02,) * 4)
    truth = with_values(rig, {"k2": 5.0, "a1": 0.09, "a3": 0.08, "dead_zone2": -0.4})
    voltage_V = np.column_stack([np.zeros(300), steps(15, 1200.0, 4.0, low_V=1.0, high_V=4.0, hold_s=80.0)[:, 1]])
    record = record_of(truth, voltage_V, 4.0, (3.0, 0.0, 2.0, 0.0))
    reading_V = record.reading_V.copy()
    reading_V[:, 1:] = np.nan
    record = replace(record, reading_V=reading_V, initial_cm=(np.nan, 0.0, np.nan, 0.0))
    choices = dict.fromkeys(("k", "gamma", "a", "lag"), FIXED) | dict.fromkeys(("k2", "a1", "a3"), FREE)
    found = estimate([record], rig, choices | {"dead_zone2": FREE}, limits={"dead_zone": (-2.0, 2.0)})
    assert np.abs(off_by_sd(found, truth)).max() < 4.0
    assert found["dead_zone2"] == pytest.approx(-0.4, abs=0.05)


def test_two_records_of_one_name_are_refused() -> None:
    record = LevelRecord("twice", np.array([0.0, 1.0]), np.ones((2, 2)), np.ones((2, 4)))
    with pytest.raises(ValueError, match="each needs a name of its own"):
        estimate([record, record], START)


def test_a_record_without_a_voltage_is_refused_with_its_time() -> None:
    voltage_V = np.ones((3, 2))
    voltage_V[1, 0] = np.nan
    record = LevelRecord("gap", np.array([0.0, 0.5, 1.0]), voltage_V, np.ones((3, 4)))
    with pytest.raises(ValueError, match=r"record 'gap': no voltage at 0.5 s"):
        estimate([record], START)


def test_a_start_beyond_the_limits_is_moved_to_the_nearest() -> None:
    """A rig file may have a lag of 0, from which a fit can't start."""
    found = estimate([record_of(TRUTH, moving(16), 0.1, INITIAL)], replace(START, lag_s=(0.0, 0.0)))
    assert found["lag1"] == pytest.approx(0.15, abs=0.01)
    with pytest.raises(ValueError, match="k1 = 0 cm3/Vs: a parameter that is not fixed must be above 0"):
        estimate([record_of(TRUTH, moving(16), 0.1, INITIAL)], with_values(START, {"k1": 0.0}))


def test_the_share_of_an_overflow_that_falls_into_the_tank_below_is_found() -> None:
    low_rims = replace(TRUTH.tanks, height_cm=(20.0, 20.0, 1.5, 2.0))
    truth = replace(TRUTH, tanks=low_rims, overflow_to_lower=(0.3, 0.8))
    record = record_of(truth, steps(17, 150.0, 0.1, low_V=2.0, high_V=6.0, hold_s=10.0), 0.1, INITIAL)
    found = estimate(
        [record], replace(START, tanks=replace(START.tanks, height_cm=low_rims.height_cm)), {"overflow": FREE}
    )
    assert found.model.overflow_to_lower == pytest.approx((0.3, 0.8), abs=0.02)
    assert np.abs(off_by_sd(found, truth)).max() < 4.0
