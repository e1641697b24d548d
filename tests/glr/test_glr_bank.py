import copy
from functools import cache

import numpy as np
import pytest

from hil.core.diagnosis.glr import bank
from hil.core.diagnosis.glr.filter import READING, StepResult, filter_step
from hil.core.diagnosis.glr.hypotheses import JUMPS, H
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import BIAS, DRIFT
from tests.glr.glr_bench import DETECTOR, NO_ESTIMATE, PERIOD_S, Plant


def a_memory(seconds: float = 60.0) -> tuple[Memory, Plant]:
    """A detector and a rig after so many quiet seconds; the caller may change both."""
    return copy.deepcopy(_quiet(seconds))


@cache
def _quiet(seconds: float) -> tuple[Memory, Plant]:
    plant, memory = Plant(21), None
    for number in range(round(seconds / PERIOD_S)):
        memory, _ = DETECTOR.step(memory, number * PERIOD_S, plant.period((3.0, 3.0)), NO_ESTIMATE, (3.0, 3.0))
    assert memory is not None
    return memory, plant


@pytest.mark.parametrize("j", range(H), ids=[f"{jump.rises or jump.falls}-{jump.target}" for jump in JUMPS])
def test_a_signature_is_what_the_jump_leaves_in_the_innovations(j: int) -> None:
    """The same readings through two filters, one told of the jump: their innovations differ by the signature."""
    memory, plant = a_memory()
    model = DETECTOR.config.model
    told = (memory.x.copy(), memory.P.copy())
    untold = (memory.x.copy(), memory.P.copy())
    size = 1e-3 if JUMPS[j].state >= BIAS else 1e-2
    size = 1e-4 if JUMPS[j].state >= DRIFT else size
    told[0][JUMPS[j].state] += size
    b = bank.Bank.empty()
    bank.open_slot(0, b)
    slot = int(np.argmax(b.onset == 0))
    energy = 0.0
    with_jump, without = StepResult.empty(), StepResult.empty()
    for _ in range(15):
        memory.now += 1
        DETECTOR._note(memory, memory.t_s + PERIOD_S, plant.period((3.2, 2.9)), (3.2, 2.9))
        entry = memory.entry.copy()
        # readings just as the untold filter expects them: what then shows in the other's innovations is the jump alone
        filter_step(model, untold[0].copy(), untold[1].copy(), entry, without)
        entry[READING : READING + 4] -= without.innovation
        filter_step(model, *told, entry, with_jump)
        filter_step(model, *untold, entry, without)
        bank.advance(model.level_gain_V_cm, entry, without, b)
        difference = without.whitener @ (without.innovation - with_jump.innovation) / size
        energy += float(difference @ difference)
    assert b.energy[j, slot] == pytest.approx(energy, rel=0.04)


def test_a_slot_is_opened_without_what_was_in_it() -> None:
    b = bank.Bank.empty()
    for array in (b.effect, b.energy, b.match, b.cross):
        array[:] = 7.0
    slot = bank.open_slot(5, b)
    assert b.onset[slot] == 5
    assert not np.concatenate([b.energy[:, slot], b.match[:, slot], b.cross[[slot]]]).any()
    expected = np.zeros(b.effect.shape[:2])
    expected[[jump.state for jump in JUMPS], range(H)] = 1.0
    assert np.array_equal(b.effect[:, :, slot], expected)
    others = np.arange(bank.SLOTS) != slot
    assert (b.energy[:, others] == 7.0).all(), "those of other slots stay"


def test_the_ratio_is_the_best_over_sizes() -> None:
    memory, _ = a_memory(30.0)
    b = memory.bank
    taken = np.flatnonzero(b.onset >= 0)
    any_size, best = bank.MinJumps(np.zeros(H), np.zeros(H)), bank.Best.empty()
    greatest = bank.find_best(b, any_size, best)
    with np.errstate(invalid="ignore", divide="ignore"):
        expected = np.nan_to_num(b.match[:, taken] ** 2 / b.energy[:, taken] / 2.0).max(axis=1)
    assert best.ratio[:H] == pytest.approx(expected)
    assert greatest == pytest.approx(best.ratio.max())


def test_the_ratio_of_both_pumps_is_that_of_the_best_pair_of_sizes_of_one_sign() -> None:
    """A comparison that was true for any cross energy stood here; a pair judged without it passed."""
    memory, _ = a_memory(30.0)
    b, best = memory.bank, bank.Best.empty()
    b.match[0], b.match[1] = 0.3 * b.energy[0], 0.2 * b.energy[1]
    for smallest in (0.0, 0.1, 0.25):
        bank.find_best(b, bank.MinJumps(np.full(H, smallest), np.full(H, smallest)), best)
        expected, expected_slot = 0.0, -1
        for slot in np.flatnonzero(b.onset >= 0):
            information = np.array([[b.energy[0, slot], b.cross[slot]], [b.cross[slot], b.energy[1, slot]]])
            if np.linalg.det(information) <= 1e-9 * b.energy[0, slot] * b.energy[1, slot]:
                continue
            sizes = np.linalg.solve(information, b.match[:2, slot])
            ratio = 0.5 * float(b.match[:2, slot] @ sizes)
            if sizes[0] * sizes[1] > 0.0 and np.abs(sizes).min() >= smallest and ratio > expected:
                expected, expected_slot = ratio, int(slot)
        assert best.ratio[H] == pytest.approx(expected)
        assert best.slot[H] == expected_slot
    assert np.abs(b.cross).max() > 0.0


def test_onsets_thin_out_with_age_and_never_exceed_the_slots() -> None:
    b = bank.Bank.empty()
    for now in range(2000):
        bank.open_slot(now, b)
    ages = np.sort(1999 - b.onset[b.onset >= 0])
    kept = [age for age in ages if age <= bank.MAX_AGE]
    assert list(ages[: bank.FRESH]) == list(range(bank.FRESH))
    assert max(kept) > bank.MAX_AGE - 64
    gaps = np.diff(kept)
    assert all(gap <= max(1, age / bank.PER_OCTAVE) for gap, age in zip(gaps, kept[1:], strict=True))


def test_no_slot_that_is_still_wanted_is_taken() -> None:
    b = bank.Bank.empty()
    for now in range(1500):
        wanted = {int(onset) for onset in b.onset if onset >= 0 and bank.is_kept(onset, now)}
        bank.open_slot(now, b)
        assert wanted <= {int(onset) for onset in b.onset}
