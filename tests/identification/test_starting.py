"""What the sensors show of tanks whose levels are known, before any fit."""

from math import nan

import numpy as np
import pytest

from hil.core.identification.parameters import Choice, RigModel
from hil.core.identification.records import LevelRecord, RulerReading
from hil.core.identification.starting import starting_point

SENSORS = ("sensor_gain", "sensor_offset")


def filling(offset_V: float, gain: float, *, is_empty: bool = True, with_ruler: bool = True) -> LevelRecord:
    """Every level rises by 0.1 cm/s from the tenth second on, to 9 cm."""
    time_s = np.arange(0.0, 100.0)
    level_cm = 0.1 * np.maximum(time_s - 10.0, 0.0)
    voltage_V = np.where(time_s >= 10.0, 3.0, 0.0)[:, None] * np.ones(2)
    ruler = (RulerReading(60.0, 0, 5.0), RulerReading(90.0, 0, 8.0)) if with_ruler else ()
    reading_V = (offset_V + gain * level_cm)[:, None] * np.ones(4)
    initial_cm = (0.0,) * 4 if is_empty else (nan,) * 4
    return LevelRecord("r", time_s, voltage_V, reading_V, initial_cm=initial_cm, ruler=ruler)


def test_an_empty_tank_shows_the_offset_and_a_ruler_the_gain() -> None:
    found = starting_point([filling(5.8, -0.13)], RigModel(), {}, SENSORS).sensors
    assert found.offset_V == pytest.approx((5.8,) * 4)
    assert found.gain_V_cm[0] == pytest.approx(-0.13)


def test_a_falling_sensor_is_seen_without_a_ruler() -> None:
    """A fit from a rising sensor ended far away: no small step leads through a gain of zero."""
    found = starting_point([filling(5.8, -0.13, with_ruler=False)], RigModel(), {}, SENSORS).sensors
    assert found.gain_V_cm == (-0.5,) * 4


def test_what_is_not_free_stays_as_in_the_file() -> None:
    record = filling(5.8, -0.13)
    assert starting_point([record], RigModel(), {}, ()) == RigModel()
    fixed = {"sensor_gain": Choice("fixed"), "sensor_offset2": Choice("fixed")}
    found = starting_point([record], RigModel(), fixed, SENSORS).sensors
    assert found.gain_V_cm == (0.5,) * 4
    assert found.offset_V == pytest.approx((5.8, 0.0, 5.8, 5.8))


def test_levels_that_nobody_knows_show_nothing() -> None:
    record = filling(5.8, -0.13, is_empty=False, with_ruler=False)
    assert starting_point([record], RigModel(), {}, SENSORS) == RigModel()
