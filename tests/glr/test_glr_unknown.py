"""What no hypothesis explains: by the residuals of the best one, and what the filter does then."""

from __future__ import annotations

from math import isfinite

import pytest

from hil.core.diagnosis.glr import settling, unknown
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Declared
from hil.core.types import Alarm, Measurement
from tests.glr.glr_bench import ALL, DETECTOR, Plant, play, put
from tests.narrowing import not_none, quad

CALM = Measurement((6.2, 6.3, 0.9, 0.7), ALL, 0.0, 5, (1e-5,) * 4, (5e-6,) * 4)


def memory(squares: float, count: float, calm: float = 1.0) -> Memory:
    """A memory whose first replay has these squares, the filter before its onset having had this mean."""
    m = Memory.begin(DETECTOR.config, 0.0, CALM, (3.0, 3.0))
    m.replays.squares[0] = m.replays.squares_fit[0] = (squares / 4.0,) * 4 + (count,)
    m.calm_squares[0] = calm
    return m


@pytest.mark.parametrize(("squares", "count"), [(0.0, 0.0), (5.0, 8.0), (20.0, 8.0), (110.0, 100.0)])
def test_a_true_hypothesis_needs_the_plain_margin(squares: float, count: float) -> None:
    m = memory(squares, count)
    assert unknown.dispersion(m, 0) == 1.0
    assert not unknown.fits_badly(m, 0, at_fit=False)


def test_the_margin_grows_with_the_misfit_and_then_there_is_no_name() -> None:
    some, much = memory(200.0, 100.0), memory(400.0, 100.0)
    assert 1.2 < unknown.dispersion(some, 0) < 2.0
    assert not unknown.fits_badly(some, 0, at_fit=False)
    assert unknown.dispersion(much, 0) > 2.5
    assert unknown.fits_badly(much, 0, at_fit=False)
    assert unknown.fits_badly(much, 0, at_fit=True)


def test_what_the_filter_did_not_explain_before_is_no_misfit_of_the_fault() -> None:
    assert not unknown.fits_badly(memory(400.0, 100.0, calm=4.0), 0, at_fit=False)
    assert unknown.dispersion(memory(400.0, 100.0, calm=4.0), 0) == 1.0


def test_the_third_name_within_seconds_contradicts_but_never_a_pump_that_is_stuck_on() -> None:
    m = memory(0.0, 0.0)
    m.checkpoint = settling.checkpoint(m, 20)
    for number, (kind, target) in enumerate((("leak", 3), ("sensor_bias", 4)), 1):
        assert not unknown.contradicts(m, 0)
        unknown.note(m, [Alarm(0.0, kind, target, 0.1, number=number)])
    assert unknown.contradicts(m, 0)
    assert not unknown.contradicts(m, 10), "leak 3 again"
    m.declared[1] = Declared("pump_stuck_on", 1.0, 1.0, 3, 0.0, 0.0)
    assert not unknown.contradicts(m, 0)


class Swapped(Plant):
    """From the tenth second on sensors 3 and 4 show each other's tank."""

    periods = 0

    def period(self, pump_V: tuple[float, float]) -> Measurement:
        self.periods += 1
        read = super().period(pump_V)
        if self.periods < 100:
            return read
        a, b, c, d = read.level_V
        object.__setattr__(read, "level_V", quad((a, b, d, c)))
        return read


def test_swapped_plugs_are_unknown_and_nothing_of_the_rig_is_guessed() -> None:
    log = play(7, 20.0, steps=(), plant=Swapped(7))
    kinds = [alarm.kind for alarm in log.alarms]
    assert kinds == ["unresolved", "unknown"]
    assert log.settled() == []
    alarm, diagnosis = log.alarms[-1], log.last.diagnosis
    assert alarm.isolated_s is None
    assert "sensor" in alarm.looks
    assert diagnosis.is_unknown
    assert diagnosis.has_fault
    assert 5.0 < diagnosis.unknown_s < 10.0
    assert diagnosis.effectiveness == (1.0, 1.0)
    assert diagnosis.trusted == ALL
    assert all(isfinite(level_V) for level_V in not_none(diagnosis.possible_V))


def test_a_known_fault_is_never_unknown() -> None:
    log = play(8, 16.0, ((10.0, put("effectiveness", 0, 0.5)),), steps=())
    assert [alarm.kind for alarm in log.settled()] == ["pump_effectiveness"]
    assert not log.last.diagnosis.is_unknown
    assert log.last.diagnosis.unknown_s == 0.0
