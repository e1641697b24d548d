"""Time without control steps: what the pumps got meanwhile is not known, and no fault may be made of it."""

import numpy as np
import pytest

from hil.core.types import Alarm, Measurement
from tests.glr.glr_bench import ALL, DETECTOR, NO_ESTIMATE, PERIOD_S, READINGS, Plant
from tests.narrowing import quad

WATCHDOG_S = 0.25
OFF = (0.0, 0.0)


def alarms_around(gap_s: float, *, seed: int, at_s: float = 5.0) -> list[Alarm]:
    """The detector's alarms where control steps are missing for a while, and in the 6 s afterwards."""
    plant, random, memory = Plant(seed), np.random.default_rng(seed), None
    alarms: list[Alarm] = []
    measurement = Measurement(quad((0.5 * plant.level).tolist()), ALL, 0.0, READINGS)
    volts, t_s = OFF, 0.0
    while t_s < at_s:
        memory, verdict = DETECTOR.step(memory, t_s, measurement, NO_ESTIMATE, volts)
        alarms += verdict.new_alarms
        volts = (3.0 + 0.02 * random.normal(), 3.0 + 0.02 * random.normal())
        measurement = plant.period(volts)
        t_s += PERIOD_S
    rows = [plant.period(volts if n * PERIOD_S < WATCHDOG_S else OFF) for n in range(round(gap_s / PERIOD_S) + 1)]
    level_V = quad(np.mean([row.level_V for row in rows], axis=0).tolist())
    last = rows[-1]
    measurement = Measurement(
        level_V, ALL, 0.0, READINGS * len(rows), last.variance_V2, last.jitter_V2, last.repeats, last.invalid_run
    )
    t_s += gap_s
    volts = OFF if gap_s > WATCHDOG_S else volts
    for _ in range(60):
        memory, verdict = DETECTOR.step(memory, t_s, measurement, NO_ESTIMATE, volts)
        alarms += verdict.new_alarms
        measurement = plant.period(volts)
        t_s += PERIOD_S
    return alarms


@pytest.mark.parametrize("gap_s", [0.1, 0.3, 1.0, 10.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_gap_in_the_control_steps_is_no_fault(gap_s: float, seed: int) -> None:
    """A process that was stopped for 0.3 s took the 0 V of the node's watchdog for the voltage of the whole time, and
    called both pumps stuck on."""
    assert alarms_around(gap_s, seed=seed) == []


def test_a_voltage_that_the_node_cuts_within_a_period_is_no_fault() -> None:
    """Its status says 0 V; for a part of the period the pumps still ran."""
    plant, memory = Plant(3), None
    alarms: list[Alarm] = []
    measurement = Measurement(quad((0.5 * plant.level).tolist()), ALL, 0.0, READINGS)
    for number in range(120):
        applied = (3.0, 3.0) if 0 < number <= 60 else OFF
        memory, verdict = DETECTOR.step(memory, number * PERIOD_S, measurement, NO_ESTIMATE, applied)
        alarms += verdict.new_alarms
        measurement = plant.period((3.0, 3.0) if number <= 60 else OFF)
    assert alarms == []
