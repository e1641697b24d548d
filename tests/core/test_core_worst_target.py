"""While it is open what has failed, the law aims at outputs that the rig can hold whatever candidate is true."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from hil.core import closed_loop
from hil.core.pumps import PumpPath
from hil.core.reachable import nearest_reachable
from hil.core.reconfiguration import UNSURE_V, found_tanks
from hil.core.tanks import equilibrium, holding_voltages
from hil.core.types import Diagnosis, Pair, PossibleRig, Waterways
from hil.core.worst_target import STEP_V, worst_target
from tests.core.core_bench import BENCH, PERIOD_S, SECOND, Plant, bench_loop, inputs, volts

PUMPS = PumpPath()
HELD_CM = equilibrium(BENCH, (6.0, 4.0))[:2]
WANTED_V = (0.5 * HELD_CM[0], 0.5 * HELD_CM[1])


def weak(first: float, second: float = 1.0) -> PossibleRig:
    return PossibleRig((f"pump_effectiveness {1 if first < 1.0 else 2}",), (first, second))


def target(*rigs: PossibleRig) -> tuple[Pair, str]:
    return worst_target(BENCH, PUMPS, WANTED_V, rigs)


def test_a_reference_that_every_candidate_can_hold_is_kept() -> None:
    assert target() == (WANTED_V, "")
    assert target(weak(0.8), PossibleRig(("valve_split 1",), (1.0, 1.0), valve_split=(0.68, 0.6))) == (WANTED_V, "")
    assert target(weak(0.55)) == (WANTED_V, ""), "half a volt too little: it is not known so well"


def test_the_candidate_that_holds_the_least_binds() -> None:
    found_V, why = target(weak(0.4), weak(0.2), weak(1.0, 0.9))
    reached_cm = nearest_reachable(BENCH, (HELD_CM[0], HELD_CM[1]), (2.0, 10.0)).lower_cm
    assert found_V == pytest.approx((0.5 * reached_cm[0], 0.5 * reached_cm[1]), abs=0.51 * STEP_V)
    assert why == "it may be pump_effectiveness 1"


def test_a_rig_without_an_operating_point_binds_nothing() -> None:
    """With splits that sum to 1 no outputs can be chosen: there is nothing to aim at instead."""
    assert target(PossibleRig(("valve_split 1",), (1.0, 1.0), valve_split=(0.5, 0.5))) == (WANTED_V, "")


def test_a_blocked_outlet_of_a_lower_tank_binds_nothing() -> None:
    """It needs less than nothing of a pump. A drift that looked like it sent the outputs from 13 cm to 5 and 15 cm."""
    blocked = Waterways(outlet=(1.0, 0.29, 1.0, 1.0), leak=(0.0, 0.0), gain=(1.0, 1.0), split=BENCH.valve_split)
    assert min(holding_voltages(found_tanks(BENCH, None, blocked)[0], (HELD_CM[0], HELD_CM[1]))) < -UNSURE_V
    assert target(PossibleRig(("outlet_block 2",), (1.0, 1.0), waterways=blocked)) == (WANTED_V, "")


class Asks:
    """A detector that has an open question from 1 s to 2 s."""

    def __init__(self, rig: PossibleRig) -> None:
        self.rig = rig

    def start(self) -> None:
        return None

    def step(self, memory: Any, t_s: float, *_: Any) -> tuple[Any, Diagnosis]:
        return memory, Diagnosis(possible=(self.rig,) if 1.0 <= t_s < 2.0 else ())


@pytest.mark.parametrize("reconfigure", [True, False])
def test_the_law_aims_at_it_while_the_question_is_open(*, reconfigure: bool) -> None:
    """The reference of the record, and the error that is counted, stay those that were asked for."""
    loop = bench_loop(references=((0.0, WANTED_V),), detector=Asks(weak(0.2)), pumps=PUMPS, reconfigure=reconfigure)
    seen = inputs(volts(Plant(start_V=(6.0, 4.0)).level_cm), (6.0, 4.0))
    state, targets, texts = closed_loop.begin(loop, seen, 0), {}, []
    for number in range(1, 25):
        state, events = closed_loop.step(loop, state, seen, round(number * PERIOD_S * SECOND))
        assert state.reference_V == WANTED_V
        targets[number] = state.request.target_V
        texts += [event.text for event in events if event.code == "target"]
    assert targets[5] == targets[22] == pytest.approx(WANTED_V)
    worst_V, _ = target(weak(0.2))
    assert targets[15] == pytest.approx(worst_V if reconfigure else WANTED_V)
    assert [("it may be pump_effectiveness 1" in text) for text in texts] == ([True] if reconfigure else [])
    assert replace(state.diagnosis) == Diagnosis()
