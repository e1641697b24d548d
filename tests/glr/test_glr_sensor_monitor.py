"""The monitor of the sensors: which faults a sensor that fails may have caused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hil.core.diagnosis.glr.rollback import SAME_STEPS
from hil.core.diagnosis.glr.sensor_monitor import _is_recent

NOW, BACK = 100, 10


def a_memory(**more: Any) -> Any:
    return SimpleNamespace(now=NOW, time_of=lambda step: 0.1 * step, suspicion=None, checkpoint=None, **more)


@pytest.mark.parametrize(("steps_ago", "is_recent"), [(0, True), (BACK, True), (BACK + 1, False)])
def test_a_suspicion_since_the_sensor_began_to_fail_is_recent(steps_ago: int, is_recent: bool) -> None:
    memory = a_memory()
    memory.suspicion = SimpleNamespace(detected_s=memory.time_of(NOW - steps_ago))
    assert _is_recent(memory, BACK) is is_recent


@pytest.mark.parametrize(("earlier", "is_recent"), [(0, True), (SAME_STEPS, True), (SAME_STEPS + 1, False)])
def test_a_fault_that_began_a_little_before_the_sensor_failed_is_recent(earlier: int, is_recent: bool) -> None:
    memory = a_memory()
    memory.checkpoint = SimpleNamespace(onset=NOW - BACK - earlier)
    assert _is_recent(memory, BACK) is is_recent


def test_without_suspicion_and_fault_nothing_is_recent() -> None:
    assert not _is_recent(a_memory(), BACK)
