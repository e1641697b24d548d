"""A run that asks for an operator stops when nobody is there, and not before."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from hil.core import controller
from hil.core.alarm_list import AlarmList
from hil.core.attendance import Attendance, unattended, watch_attendance
from hil.core.controller import ControllerState
from hil.core.types import Mode
from tests.safety.safety_bench import HEALTHY, LIMITS, PERIOD_S, READY, config

SECOND = 1_000_000_000


def modes(steps: int, *, attended_s: float = 0.0, unattended_s: float = 0.0, here: tuple[int, ...] = ()) -> list[Mode]:
    """Modes of a run at rest; here : steps at which an operator sends a request."""
    setup = replace(config(), limits=replace(LIMITS, attended_s=attended_s, unattended_s=unattended_s))
    state, found = ControllerState(), []
    leak = {"number": 1, "kind": "leak", "target": 1}
    for number in range(steps):
        inputs = replace(HEALTHY if number > 1 else READY, is_attended=number in here)
        if number == 5:
            state = state._replace(
                alarms=state.alarms.take("alarm", "leak 1: 0.3", leak, state.loop.t_s if state.loop else 0.0)
            )
        state, _ = controller.step(setup, state, inputs, round(number * PERIOD_S * SECOND))
        found.append(state.supervision.mode)
    return found


def test_nobody_is_needed_by_default() -> None:
    assert modes(60)[-1] is Mode.RUNNING


def test_an_operator_who_left_stops_the_run_after_twice_the_time() -> None:
    found = modes(40, attended_s=1.0)
    first = found.index(Mode.STOPPING)
    begun = found.index(Mode.RUNNING)
    assert first - begun == pytest.approx(2.0 / PERIOD_S, abs=1)


def test_an_operator_who_comes_back_in_time_keeps_it_running() -> None:
    assert modes(40, attended_s=1.0, here=(15, 30))[-1] is Mode.RUNNING


def test_an_urgent_alarm_that_nobody_sees_stops_the_run() -> None:
    found = modes(40, unattended_s=2.0)
    assert found.index(Mode.STOPPING) - 4 == pytest.approx(2.0 / PERIOD_S, abs=1)


def test_absence_is_told_once_and_so_is_the_return() -> None:
    limits = replace(LIMITS, attended_s=10.0)
    seen, told = Attendance(), []
    for second in range(31):
        seen, events = watch_attendance(seen, limits, second == 25, float(second))
        told += [(second, event.code, event.data["is_over"]) for event in events]
    assert told == [(10, "operator_absent", False), (25, "operator_absent", True)]
    assert unattended(seen, AlarmList(), limits, 44.9) == ""
    assert unattended(seen, AlarmList(), limits, 45.0) == "no request of an operator for 20 s"
    assert unattended(seen, AlarmList(), replace(limits, attended_s=0.0), math.inf) == ""
