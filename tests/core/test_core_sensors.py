"""Level sensors as they are: level signals from readings of any gain and offset, and alarms in volts of the sensor."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.alarm_units import in_bench_units
from hil.core.pumps import STRAIGHT, PumpPath
from hil.core.sensors import PLAIN, LevelSensors, signal_gain
from hil.core.types import Alarm, Measurement, Quad
from hil.wire.command_sender import CommandSender
from hil.wire.receiver import Receiver
from tests.narrowing import quad
from tests.wire.wire_bench import CONTRACT, frame

GAIN = st.one_of(st.floats(0.02, 2.0), st.floats(-2.0, -0.02))
GAINS = st.tuples(GAIN, GAIN, GAIN, GAIN)
OFFSETS = st.tuples(*[st.floats(-10.0, 10.0)] * 4)
LEVELS = st.tuples(*[st.floats(0.0, 20.0)] * 4)
MIXED = LevelSensors((-0.45, 0.5, 0.05, -0.05), (9.5, 0.1, 1.0, 8.0))
ALL = (True, True, True, True)


@given(GAINS, OFFSETS, LEVELS)
def test_a_level_signal_is_one_gain_times_the_level_whatever_the_sensor(
    gains: Quad, offsets: Quad, level_cm: Quad
) -> None:
    sensors = LevelSensors(gains, offsets)
    readings = quad(o + g * h for o, g, h in zip(offsets, gains, level_cm, strict=True))
    signals = sensors.signals(readings)
    assert signals == pytest.approx([sensors.signal_gain * h for h in level_cm], abs=1e-6)
    assert sensors.readings(signals) == pytest.approx(readings, abs=1e-6)


def test_the_gain_of_the_signals_is_the_sensors_own_if_they_share_a_positive_one() -> None:
    assert signal_gain(0.3) == signal_gain([0.3] * 4) == 0.3
    assert signal_gain(-0.3) == signal_gain([0.3, 0.3, 0.3, 0.31]) == signal_gain([-0.3] * 4) == 0.5
    assert LevelSensors((0.3,) * 4).is_plain
    assert not LevelSensors((0.3,) * 4, (0.0, 0.0, 0.0, 1.0)).is_plain
    assert not MIXED.is_plain


def test_noise_is_scaled_with_its_signal() -> None:
    assert MIXED.scaled((0.0045, 0.005, 0.0005, 0.0005)) == pytest.approx((0.005,) * 4)
    seen = Measurement((5.0, 5.0, 1.0, 8.0), ALL, 0.0, 5, (1e-6,) * 4, (2e-6,) * 4, (1, 2, 3, 4), (0, 0, 0, 0))
    signal = MIXED.level_signals(seen)
    assert signal.variance_V2 == pytest.approx((1e-6 / 0.81, 1e-6, 1e-4, 1e-4))
    assert signal.jitter_V2 == pytest.approx((2e-6 / 0.81, 2e-6, 2e-4, 2e-4))
    assert (signal.repeats, signal.invalid_run, signal.valid) == (seen.repeats, seen.invalid_run, seen.valid)
    assert signal.level_V == pytest.approx((5.0, 4.9, 0.0, 0.0))


def test_plain_sensors_leave_a_measurement_alone() -> None:
    seen = Measurement((5.0, 5.0, 1.0, 1.0), ALL, 0.0, 5)
    assert PLAIN.level_signals(seen) is seen
    assert PLAIN.factor == (1.0,) * 4
    assert PLAIN.lowest_signals == (0.0,) * 4


def test_the_lowest_signal_is_that_of_the_end_at_which_a_tank_is_empty() -> None:
    """A rising sensor is cut off at the lower end of its range, a falling one at the upper end."""
    low = LevelSensors((0.5, 0.5, -0.5, -0.5), (-1.0, 1.0, 11.24, 9.0), (0.0, 10.24)).lowest_signals
    assert low == pytest.approx((1.0, -1.0, 1.0, -1.24))


def test_range_and_repeats_are_those_of_the_readings() -> None:
    """A falling sensor near 0 V is that of a full tank, and valid; beyond its range it is not."""
    sender = CommandSender(CONTRACT)
    receiver = Receiver(CONTRACT, sender, (0.5, 9.6), MIXED)
    for counter in range(3):
        receiver.take(frame("LowerLevels", counter, Level1=0.6, Level2=0.4), counter)
        receiver.take(frame("UpperLevels", counter, Level3=1.5, Level4=7.0), counter)
    seen = receiver.measurement(10)
    assert seen.valid == (True, False, True, True)
    assert seen.repeats == (2, 2, 2, 2)
    assert seen.level_V == pytest.approx((0.5 * 8.9 / 0.45, 0.3, 5.0, 10.0), abs=0.01)


def alarm(kind: str, target: int, size: float, std: float = 0.1) -> Alarm:
    return Alarm(1.0, kind, target, size, std)


@pytest.mark.parametrize(
    ("kind", "target", "size", "shown", "std"),
    [
        ("sensor_bias", 1, 0.5, -0.45, 0.09),
        ("sensor_drift", 4, 0.1, -0.01, 0.01),
        ("sensor_noise", 1, 0.2, 0.18, 0.09),
        ("sensor_stuck", 1, 5.0, 5.0, 0.1),
        ("sensor_open", 3, 5.0, 1.5, 0.1),
        ("leak", 1, 0.3, 0.3, 0.1),
        ("unresolved", 0, math.nan, math.nan, 0.1),
    ],
)
def test_an_alarm_of_a_sensor_is_in_volts_of_that_sensor(
    kind: str, target: int, size: float, shown: float, std: float
) -> None:
    (told,) = in_bench_units((alarm(kind, target, size),), MIXED, STRAIGHT)
    assert told.size == pytest.approx(shown, nan_ok=True)
    assert told.size_std == pytest.approx(std)


def test_a_stuck_pump_is_told_as_a_voltage_within_its_range() -> None:
    pumps = PumpPath((0.5, 0.5), (0.03, 0.03))
    (told,) = in_bench_units((alarm("pump_stuck_on", 2, pumps.drive((4.0, 4.0))[1]),), PLAIN, pumps)
    assert told.size == pytest.approx(4.0)
    assert told.size_std == pytest.approx(0.1 * pumps.slope(1, pumps.drive((4.0, 4.0))[1]))
    (beyond,) = in_bench_units((alarm("pump_stuck_on", 2, 40.0),), PLAIN, pumps)
    assert beyond.size == 10.0


def test_nothing_is_converted_on_the_papers_rig() -> None:
    alarms = (alarm("pump_stuck_on", 2, 4.0), alarm("sensor_bias", 1, 0.5))
    assert in_bench_units(alarms, PLAIN, STRAIGHT) is alarms
