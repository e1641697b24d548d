"""Pumps that give more than their file says, and pumps that are stuck."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.glr.glr_bench import MODEL, Plant, play
from tests.narrowing import not_none, pair

AT_S = 20.0


def give(first: float, second: float) -> Callable[[Plant], None]:
    def begin(plant: Plant) -> None:
        plant.effectiveness[:] = (first, second)

    return begin


@pytest.mark.parametrize("share", [(1.15, 1.0), (1.0, 1.3), (1.2, 1.2)])
def test_a_pump_that_gives_more_is_told_as_effectiveness_above_1_and_used(share: tuple[float, float]) -> None:
    """It was called stuck on and tripped, and the operator was told to cut its supply."""
    log = play(71, AT_S + 20.0, ((AT_S, give(*share)),))
    assert {(alarm.kind, alarm.target) for alarm in log.settled()} == {
        ("pump_effectiveness", pump + 1) for pump in (0, 1) if share[pump] != 1.0
    }
    assert log.last.diagnosis.effectiveness == pytest.approx(share, abs=0.02)
    assert log.last.law_memory.feedback.effectiveness == pytest.approx(share, abs=0.03), "the law divides by it"
    assert not any(any(state.diagnosis.stuck_on) for state in log.states)


class SluggishPlant(Plant):
    """Pumps with two lags of the same length, which no single lag describes."""

    def __init__(self, seed: int, lag_s: float) -> None:
        super().__init__(seed, lag_s=lag_s)
        self.shaft_V = np.zeros(2)

    def _move(self, pump_V: tuple[float, float], duration_s: float) -> None:
        self.shaft_V += (np.array(pump_V) - self.shaft_V) * (1.0 - np.exp(-duration_s / self.lag_s))
        super()._move(pair(self.shaft_V), duration_s)


def test_a_pump_that_follows_late_is_not_stuck() -> None:
    """It was called stuck as soon as its voltage had moved."""
    loses = (40.0, give(0.5, 1.0))
    log = play(1, 60.0, (loses,), ((5.0, 0.3), (20.0, -0.3)), plant=SluggishPlant(1, lag_s=3.0))
    assert not any(any(state.diagnosis.stuck_on) for state in log.states)


def test_a_pump_that_fails_and_recovers_within_seconds_is_not_stuck() -> None:
    """Its return within the stuck check was taken for a flow that does not follow the voltage."""
    faults = tuple(
        event for n in range(3) for event in ((AT_S + 16.0 * n, give(0.4, 1.0)), (AT_S + 16.0 * n + 5.0, give(1, 1)))
    )
    log = play(72, AT_S + 50.0, faults)
    assert not any(any(state.diagnosis.stuck_on) for state in log.states)
    assert log.last.diagnosis.effectiveness == (1.0, 1.0)
    assert {(alarm.kind, alarm.target) for alarm in log.settled() if alarm.kind != "unresolved"} == {
        ("pump_effectiveness", 1)
    }


@pytest.mark.parametrize("stuck_V", [0.5, 4.5, 10.0])
def test_a_stuck_pump_is_found_and_its_size_lies_within_its_range(stuck_V: float) -> None:
    """The size could be more than the pump's range, 12.9 V of 10 V."""

    def freeze(plant: Plant) -> None:
        plant.frozen_V[1] = stuck_V

    log = play(73, AT_S + 20.0, ((AT_S, freeze),), ((5.0, 0.3), (AT_S + 6.0, 0.3)))
    stuck = [alarm for alarm in log.settled() if alarm.kind == "pump_stuck_on"]
    assert {alarm.target for alarm in stuck} == {2}
    assert all(0.0 <= alarm.size <= 10.0 for alarm in stuck)
    assert stuck[0].size == pytest.approx(stuck_V, rel=0.1, abs=0.1)
    assert not_none(stuck[0].isolated_s) - AT_S < 12.0
    assert max(2.0 * level[0] for level in log.true_V) < MODEL.height_cm[0]
