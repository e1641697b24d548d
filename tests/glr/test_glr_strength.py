"""A pump that steadily gives more or less than its file says is reported, once it is known well enough."""

from __future__ import annotations

import pytest

from hil.core.diagnosis.glr import declaration, strength
from hil.core.diagnosis.glr.filter import PERIOD, VOLTAGE
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Suspicion, Wide
from hil.core.diagnosis.glr.model import PUMP, SCALE, ZONE
from hil.core.types import Alarm, Measurement
from tests.glr.glr_bench import DETECTOR


def a_memory(share: float, std: float) -> Memory:
    """A run at 3 V whose filter has learned what pump 1 gives."""
    reading = Measurement((6.2, 6.4, 0.8, 0.7), (True,) * 4, 0.0, 5)
    m = Memory.begin(DETECTOR.config, 0.0, reading, (3.0, 3.0))
    m.entry[VOLTAGE : VOLTAGE + 2], m.entry[PERIOD] = 3.0, 0.1
    m.P[SCALE, SCALE] = std**2
    m.x[SCALE] = share
    return m


def alarms_of(m: Memory, seconds: float) -> list[Alarm]:
    """What is reported in this time."""
    return [alarm for _ in range(round(10.0 * seconds)) for alarm in strength.step(m)]


@pytest.mark.parametrize("share", [0.7, 0.85, 1.15, 1.3])
def test_a_known_difference_is_reported_once_and_the_law_uses_it(share: float) -> None:
    m = a_memory(share, 0.01)
    (alarm,) = alarms_of(m, 60.0)
    assert (alarm.kind, alarm.target, alarm.number) == ("pump_effectiveness", 1, 1)
    assert alarm.size == pytest.approx(share)
    assert alarm.size_std == pytest.approx(0.01)
    assert declaration.effectiveness(m) == pytest.approx((share, 1.0))


@pytest.mark.parametrize(("share", "std"), [(1.08, 0.01), (1.15, 0.03), (1.0, 0.01)])
def test_what_is_small_or_hardly_known_is_not(share: float, std: float) -> None:
    m = a_memory(share, std)
    assert alarms_of(m, 60.0) == []
    assert declaration.effectiveness(m) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("wide_share", "wide_std", "is_wide", "is_told"),
    [(0.81, 0.03, False, True), (0.74, 0.03, False, False), (0.81, 0.05, False, False), (0.74, 0.05, True, True)],
)
def test_where_the_file_is_believed_the_filter_of_another_rig_has_to_agree(
    wide_share: float, wide_std: float, *, is_wide: bool, is_told: bool
) -> None:
    """0.89 was reported on the ramp of a start phase, and was 0.78: the outlets were not as in the file, either."""
    m, other = a_memory(0.8, 0.01), a_memory(wide_share, wide_std)
    m.is_wide, m.wide = is_wide, Wide(x=other.x, P=other.P, began=0)
    assert bool(alarms_of(m, 15.0)) is is_told


def test_nothing_is_reported_while_an_alarm_is_open_or_a_pump_stands_still() -> None:
    m = a_memory(1.2, 0.01)
    m.suspicion = Suspicion(number=1, detected_s=0.0)
    assert alarms_of(m, 30.0) == []
    m.suspicion = None
    m.entry[VOLTAGE] = 0.5
    assert alarms_of(m, 30.0) == []
    m.entry[VOLTAGE] = 3.0
    assert alarms_of(m, 9.0) == [], "a part of the time only"
    assert len(alarms_of(m, 2.0)) == 1


def test_a_change_keeps_the_number_and_the_file_s_share_ends_it() -> None:
    m = a_memory(0.8, 0.01)
    first = alarms_of(m, 15.0)
    m.t_s, m.x[SCALE] = 20.0, 0.74
    second = alarms_of(m, 15.0)
    m.t_s, m.x[SCALE] = 40.0, 1.01
    third = alarms_of(m, 15.0)
    assert [alarm.number for alarm in (*first, *second, *third)] == [1, 1, 1]
    assert [alarm.is_recovery for alarm in (*first, *second, *third)] == [False, False, True]
    assert [alarm.detected_s for alarm in (*first, *second, *third)] == [0.0, 0.0, 40.0], "a recovery has its own time"
    assert declaration.effectiveness(m) == (1.0, 1.0)


def test_a_dead_zone_counts_at_the_voltage_at_which_the_pump_runs() -> None:
    m = a_memory(1.0, 0.005)
    m.x[ZONE] = 0.6
    (alarm,) = alarms_of(m, 60.0)
    assert alarm.size == pytest.approx(0.8)


def test_what_shows_late_is_not_the_rig_s_own() -> None:
    """A drift of 0.7 mV/s moved the pumps' gains by 10 % in 900 s, and the stop before the rim did not come."""
    m = a_memory(1.2, 0.01)
    m.t_s = m.begun_s + strength.REPORT_S + 1.0
    assert alarms_of(m, 30.0) == []


@pytest.mark.parametrize(
    ("share", "lagged_V", "std", "is_wide", "flow_V"),
    [
        (1.3, 3.0, 0.02, True, 3.9),
        (1.3, 3.0, 0.02, False, 0.0),
        (1.3, 3.0, 0.08, True, 0.0),
        (1.3, 14.0, 0.02, True, 15.0),
    ],
)
def test_what_a_pump_gives_now_is_told_to_the_interlocks(
    share: float, lagged_V: float, std: float, *, is_wide: bool, flow_V: float
) -> None:
    """A pump with a third more flow at 10 V than at 2 V looked like a shut outlet at a step up: trip high_level."""
    m = a_memory(share, std)
    m.x[PUMP], m.P[PUMP, PUMP], m.is_wide = lagged_V, 1e-6, is_wide
    assert strength.flow_V(m)[0] == pytest.approx(flow_V)


@pytest.mark.parametrize(
    ("share", "is_wide", "is_told"), [(0.25, True, True), (0.4, True, False), (0.25, False, False)]
)
def test_a_pump_that_was_learned_as_dead_is_reported_at_any_time(share: float, *, is_wide: bool, is_told: bool) -> None:
    """It died while it stood still; then the filter beside explained it, and after 300 s nothing told."""
    m = a_memory(0.8, 0.01)
    assert len(alarms_of(m, 20.0)) == 1
    m.t_s, m.is_wide, m.x[SCALE] = 400.0, is_wide, share
    told = alarms_of(m, 20.0)
    assert [alarm.kind for alarm in told] == (["pump_effectiveness"] if is_told else [])
    assert [alarm.size for alarm in told] == pytest.approx([share] if is_told else [])
