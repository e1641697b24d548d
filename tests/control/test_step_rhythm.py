"""The process that serves clients leaves the processors alone shortly before each control step."""

from __future__ import annotations

import pytest

from hil.edge.control.step_rhythm import StepRhythm


def test_before_the_next_step_there_is_a_pause_until_its_update() -> None:
    rhythm = StepRhythm(0.1)
    assert rhythm.pause_s(7.0) == 0.0, "no step was made yet"
    rhythm.stepped(10.0)
    assert rhythm.pause_s(10.0) == 0.0
    assert rhythm.free_s(10.0) == pytest.approx(0.095)
    assert rhythm.pause_s(10.094) == 0.0
    assert rhythm.pause_s(10.0951) == pytest.approx(0.0099), "until 5 ms after the step, if nothing is heard of it"
    rhythm.stepped(10.1)
    assert rhythm.pause_s(10.1001) == 0.0, "the step is made"


def test_a_run_that_hangs_does_not_silence_its_clients() -> None:
    rhythm = StepRhythm(0.1)
    rhythm.stepped(0.0)
    paused = sum(rhythm.pause_s(k * 1e-3) > 0.0 for k in range(150, 10_150))
    assert paused == pytest.approx(1000, abs=120), "10 ms of each period"


def test_fast_steps_of_which_some_tell_nothing_have_their_pauses_too() -> None:
    rhythm = StepRhythm(0.01)
    rhythm.stepped(0.0)
    assert [rhythm.pause_s(t_s) > 0.0 for t_s in (0.005, 0.0095, 0.0115, 0.015, 0.0495, 0.055)] == [
        False, True, False, False, True, False,
    ]  # fmt: skip


@pytest.mark.parametrize("period_s", [0.0, 1e-3])
def test_without_a_period_or_with_a_very_short_one_there_is_none(period_s: float) -> None:
    rhythm = StepRhythm(period_s)
    rhythm.stepped(0.0)
    assert rhythm.free_s(0.0) is None
    assert not any(rhythm.pause_s(k * 1e-4) for k in range(100))
