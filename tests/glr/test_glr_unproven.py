"""A pump that was at rest when the other one failed: unproven until it has been seen to work."""

from __future__ import annotations

from hil.core.diagnosis.glr.memory import Memory
from hil.core.types import Diagnosis, Pair
from tests.glr.glr_bench import DETECTOR, NO_ESTIMATE, PERIOD_S, Plant


def test_a_pump_at_rest_when_the_other_fails_is_unproven_until_it_has_worked_for_a_second() -> None:
    """The reservoir may have run empty: then the second pump is as dead as the first, which shows when it is driven."""
    plant = Plant(7, spread=0.0)
    memory: Memory | None = None
    seen: list[Diagnosis] = []

    def drive(pump_V: Pair, seconds: float) -> None:
        nonlocal memory
        for _ in range(round(seconds / PERIOD_S)):
            memory, diagnosis = DETECTOR.step(memory, len(seen) * PERIOD_S, plant.period(pump_V), NO_ESTIMATE, pump_V)
            seen.append(diagnosis)

    drive((3.0, 3.0), 10.0)
    drive((3.0, 0.0), 10.0)
    plant.effectiveness[0] = 0.0
    drive((3.0, 0.0), 10.0)
    assert [(alarm.kind, alarm.target) for one in seen for alarm in one.new_alarms if alarm.isolated_s] == [
        ("pump_effectiveness", 1)
    ]
    assert seen[-1].unproven == (False, True), "at rest for 10 s, it has shown nothing"
    drive((3.0, 3.0), 0.8)
    assert seen[-1].unproven == (False, True)
    drive((3.0, 3.0), 0.4)
    assert seen[-1].unproven == (False, False)
