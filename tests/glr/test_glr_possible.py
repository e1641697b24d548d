"""What the rig may be while an alarm stands open."""

import pytest

from hil.core.diagnosis.glr import possible
from hil.core.diagnosis.glr.hypotheses import BOTH, JUMPS
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Suspicion
from hil.core.diagnosis.glr.model import BIAS, GAIN, OUTLET, SPLIT
from hil.core.types import Measurement
from tests.glr.glr_bench import DETECTOR, MODEL

CONFIG = DETECTOR.config


def number_of(state: int) -> int:
    return next(number for number, jump in enumerate(JUMPS) if jump.state == state)


def open_alarm(since_s: float, *candidates: tuple[int, float, float]) -> Memory:
    """A memory with an alarm that has been open for so long. candidates : state, its value, evidence."""
    m = Memory.begin(CONFIG, 0.0, Measurement((6.2, 6.4, 0.8, 0.7), (True,) * 4, 0.0, 5), (3.0, 3.0))
    m.t_s = 30.0
    m.replays.x[:] = m.replays.before[:] = m.x
    m.replays.evidence[:] = 0.0
    for state, value, evidence in candidates:
        m.replays.x[number_of(state), state] = value
        m.replays.evidence[number_of(state)] = evidence
    m.suspicion = Suspicion(number=1, detected_s=30.0 - since_s, leader=number_of(candidates[0][0]))
    return m


def test_each_candidate_of_pump_valve_and_tank_is_a_rig() -> None:
    m = open_alarm(6.0, (GAIN, 0.4, 50.0), (SPLIT + 1, 0.8, 45.0), (OUTLET + 3, 0.5, 44.0), (BIAS, 0.3, 49.0))
    pump, valve, tank = possible.rigs(CONFIG, m)
    assert pump.names == ("pump_effectiveness 1",)
    assert pump.effectiveness == pytest.approx((0.4, 1.0))
    assert valve.valve_split == pytest.approx((MODEL.valve_split[0], 0.8 * MODEL.valve_split[1]))
    assert (valve.names, valve.effectiveness) == (("valve_split 2",), (1.0, 1.0))
    assert tank.names == ("outlet_block 4",)
    assert tank.waterways is not None
    assert tank.waterways.outlet == pytest.approx((1.0, 1.0, 1.0, 0.5))


def test_what_lags_far_behind_is_no_candidate_any_more() -> None:
    m = open_alarm(6.0, (GAIN, 0.4, 50.0), (SPLIT, 0.8, 30.0))
    assert [rig.names for rig in possible.rigs(CONFIG, m)] == [("pump_effectiveness 1",)]


def test_both_pumps_at_once_are_one_rig() -> None:
    m = open_alarm(6.0, (GAIN, 0.4, 50.0))
    m.replays.x[BOTH, GAIN : GAIN + 2] = 0.5, 0.6
    m.replays.evidence[BOTH] = 52.0
    assert possible.rigs(CONFIG, m)[1].effectiveness == pytest.approx((0.5, 0.6))


def test_an_alarm_that_has_just_been_raised_changes_nothing_yet() -> None:
    assert possible.rigs(CONFIG, open_alarm(4.0, (GAIN, 0.4, 50.0))) == ()
