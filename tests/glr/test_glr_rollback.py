"""Filtering again from an earlier step: what has begun meanwhile is seen from its onset on."""

import numpy as np
import pytest

from hil.core.diagnosis.glr import rollback
from hil.core.diagnosis.glr.bank import Best, find_best
from hil.core.diagnosis.glr.filter import READING, VARIANCE
from hil.core.diagnosis.glr.glr_detector import GlrDetector
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.refilter import RING
from hil.core.diagnosis.glr.tuning import Tuning
from tests.glr.glr_bench import MODEL, NO_ESTIMATE, PERIOD_S, Plant
from tests.narrowing import not_none

SILENT = GlrDetector(MODEL, 0.2, 0.005, Tuning(settle_s=1e9))
"""Filter and bank run, but no alarm is ever raised."""

FAULT_STEP, LAST_STEP = 300, 312


def watched(seed: int, pump: int, left: float) -> Memory:
    """Memory of a rig whose pump 0 or 1 loses gain at FAULT_STEP, with nothing declared."""
    plant, volts = Plant(seed), (3.0, 3.0)
    memory: Memory | None = None
    for step in range(LAST_STEP + 1):
        if step == FAULT_STEP:
            plant.effectiveness[pump] = left
        memory, _ = SILENT.step(memory, step * PERIOD_S, plant.period(volts), NO_ESTIMATE, volts)
    return not_none(memory)


@pytest.mark.parametrize("pump", [0, 1])
@pytest.mark.parametrize("seed", [51, 52])
def test_a_fault_that_begins_in_the_steps_filtered_again_is_seen_from_its_onset_on(pump: int, seed: int) -> None:
    """The bank could stand still while filtering again, and no test noticed."""
    memory = watched(seed, pump, 0.4)
    start, withdrawn = rollback.go_back(memory, FAULT_STEP - 10)
    assert start <= FAULT_STEP - 10
    assert withdrawn == []
    rollback.refilter(SILENT.config, memory, start, memory.now)
    assert memory.bank.onset[memory.bank.onset >= 0].min() == start, "nothing older than the step gone back to"
    best = Best.empty()
    ratio = find_best(memory.bank, memory.min_jumps(), best)
    slot = int(best.slot[pump])
    assert ratio > SILENT.config.tuning.detect
    assert best.ratio[pump] > 0.9 * ratio
    assert abs(int(memory.bank.onset[slot]) - FAULT_STEP) <= 2
    size = memory.bank.match[pump, slot] / memory.bank.energy[pump, slot]
    assert size == pytest.approx(-0.6, abs=0.1)


def test_filtering_again_without_a_change_gives_the_same_filter() -> None:
    memory = watched(53, 0, 1.0)
    x, P, no_jump = memory.x.copy(), memory.P.copy(), memory.history.no_jump.copy()
    start, _ = rollback.go_back(memory, LAST_STEP - 8)
    assert not np.array_equal(memory.x, x)
    rollback.refilter(SILENT.config, memory, start, memory.now)
    assert memory.x == pytest.approx(x, abs=1e-12)
    assert pytest.approx(P, abs=1e-12) == memory.P
    assert memory.history.no_jump == pytest.approx(no_jump, abs=1e-9)


@pytest.mark.parametrize("sensor", range(4))
def test_readings_change_from_the_step_after_the_start_to_the_last(sensor: int) -> None:
    memory = watched(54, 0, 1.0)
    before = memory.history.entries.copy()
    rollback.set_reading_variance(memory, LAST_STEP - 4, sensor, 0.25)
    rollback.set_reading_variance(memory, LAST_STEP - 2, sensor, None)
    changed = {(int(row), int(column)) for row, column in np.argwhere(memory.history.entries != before)}
    wider = {((LAST_STEP - back) % RING, VARIANCE + sensor) for back in range(4)}
    removed = {((LAST_STEP - back) % RING, READING + sensor) for back in range(2)}
    assert changed == wider | removed
    assert all(memory.history.entries[row, VARIANCE + sensor] == 0.25 for row, _ in wider)
