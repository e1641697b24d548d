import math

import pytest

from hil.core.diagnosis.glr import inflow_check
from hil.core.diagnosis.glr.memory import Memory
from hil.core.types import Pair
from tests.glr.glr_bench import DETECTOR, NO_ESTIMATE, PERIOD_S, Plant

CONFIG = DETECTOR.config


def watched(seed: int, pump_V: Pair, effectiveness: list[float] | Pair, steps: int = 14, before: int = 30) -> Memory:
    """A rig that runs healthy for some periods at 3 V, then for some more as given; the detector's memory."""
    plant, memory = Plant(seed), None
    for number in range(before + steps):
        if number == before:
            plant.effectiveness[:] = effectiveness
        voltage = (3.0, 3.0) if number < before else pump_V
        reading = plant.period(voltage)
        memory, _ = DETECTOR.step(memory, number * PERIOD_S, reading, NO_ESTIMATE, voltage)
    assert isinstance(memory, Memory)
    return memory


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("pump", [0, 1])
def test_a_pump_without_water_is_missed_within_a_second_and_a_half_and_a_weak_one_is_not(seed: int, pump: int) -> None:
    none, weak = [1.0, 1.0], [1.0, 1.0]
    none[pump], weak[pump] = 0.0, 0.4
    assert inflow_check.is_missing(CONFIG, watched(seed, (3.0, 3.0), none), pump)
    assert not inflow_check.is_missing(CONFIG, watched(seed, (3.0, 3.0), none), 1 - pump)
    assert not inflow_check.is_missing(CONFIG, watched(seed, (3.0, 3.0), weak), pump)
    assert not inflow_check.is_missing(CONFIG, watched(seed, (3.0, 3.0), (1.0, 1.0)), pump)


def test_of_a_pump_at_rest_or_a_tank_without_readings_nothing_is_said() -> None:
    assert not inflow_check.is_missing(CONFIG, watched(1, (1.0, 3.0), (0.0, 1.0)), 0)
    memory = watched(1, (3.0, 3.0), (0.0, 1.0))
    for row in memory.history.entries:
        row[2 + 3] = math.nan
    assert not inflow_check.is_missing(CONFIG, memory, 0)
    memory = watched(1, (3.0, 3.0), (0.0, 1.0))
    memory.usable[3] = False
    assert not inflow_check.is_missing(CONFIG, memory, 0)
    assert not inflow_check.is_missing(CONFIG, watched(1, (3.0, 3.0), (0.0, 1.0), steps=3, before=3), 0)


def test_periods_without_readings_leave_the_others_to_judge() -> None:
    memory = watched(2, (3.0, 3.0), (0.0, 1.0))
    memory.history.entries[::2, 2 + 3] = math.nan
    assert inflow_check.is_missing(CONFIG, memory, 0)


@pytest.mark.parametrize("pump", [0, pytest.param(1, marks=pytest.mark.long)])
def test_in_a_nearly_empty_tank_a_dead_pump_is_told_from_a_weak_one(pump: int) -> None:
    """With the outflow of a tank of a few millimetres taken for that of a centimetre, a dead pump seemed to deliver."""
    dead, weak = [1.0, 1.0], [1.0, 1.0]
    dead[pump], weak[pump] = 0.0, 0.4
    tank, steps = 3 - pump, (200, 150)[pump]
    for seed in range(3):
        drained, filled = watched(seed, (3.0, 3.0), dead, steps=steps), watched(seed, (3.0, 3.0), weak, steps=300)
        assert 0.06 < drained.x[tank] < 0.4
        assert 0.06 < filled.x[tank] < 0.8
        assert inflow_check.is_missing(CONFIG, drained, pump)
        assert not inflow_check.is_missing(CONFIG, filled, pump)
