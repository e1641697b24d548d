"""Scheduled faults: onset, end, overlap, scenario time."""

from collections.abc import Iterable

from firmware_sim.faults import FaultSchedule, PumpEffectiveness
from tests.firmware_sim.sim_bench import SECOND

START = 7 * SECOND


def pump_fault(at_s: float, value: float, target: int = 1, until_s: float | None = None) -> PumpEffectiveness:
    return PumpEffectiveness(at_s=at_s, until_s=until_s, kind="pump_effectiveness", target=target, value=value)


def seen(faults: tuple[PumpEffectiveness, ...], times_s: Iterable[float]) -> list[tuple[float, ...]]:
    schedule = FaultSchedule(faults)
    schedule.start(START)
    result = []
    for time_s in times_s:
        schedule.advance(START + round(time_s * SECOND))
        result.append(tuple(schedule.effects.effectiveness))
    return result


def test_a_fault_begins_at_its_very_time_and_stays() -> None:
    assert seen((pump_fault(2.0, 0.4),), [1.999999999, 2.0, 1e6]) == [(1, 1), (0.4, 1), (0.4, 1)]


def test_a_fault_with_an_end_goes_away() -> None:
    assert seen((pump_fault(2.0, 0.4, 2, 3.0),), [2.0, 2.999999999, 3.0]) == [(1, 0.4), (1, 0.4), (1, 1)]


def test_of_two_faults_the_later_onset_holds_until_it_ends() -> None:
    faults = (pump_fault(2.0, 0.2, until_s=3.0), pump_fault(1.0, 0.7))
    assert seen(faults, [0.5, 1.0, 2.0, 3.0]) == [(1, 1), (0.7, 1), (0.2, 1), (0.7, 1)]


def test_nothing_happens_before_the_scenario_starts() -> None:
    schedule = FaultSchedule((pump_fault(0.0, 0.4),))
    assert schedule.next_ns is None
    schedule.advance(100 * SECOND)
    assert schedule.effects.effectiveness == [1.0, 1.0]
    schedule.start(100 * SECOND)
    assert schedule.next_ns == 100 * SECOND


def test_next_time_names_onsets_and_ends_in_order() -> None:
    schedule = FaultSchedule((pump_fault(2.0, 0.2, until_s=3.0), pump_fault(1.0, 0.7, 2)))
    schedule.start(START)
    times_s = []
    while schedule.next_ns is not None:
        times_s.append((schedule.next_ns - START) / SECOND)
        schedule.advance(schedule.next_ns)
    assert times_s == [1.0, 2.0, 3.0]
