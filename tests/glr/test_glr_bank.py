import numpy as np
import pytest

from hil.core.diagnosis.glr import bank, process
from hil.core.diagnosis.glr.hypotheses import JUMPS, H
from hil.core.diagnosis.glr.memory import Memory
from tests.glr.glr_bench import DETECTOR, NO_ESTIMATE, PERIOD_S, Plant


def a_memory(seconds: float = 60.0) -> tuple[Memory, Plant]:
    plant, memory = Plant(21), None
    for number in range(round(seconds / PERIOD_S)):
        memory, _ = DETECTOR.step(memory, number * PERIOD_S, plant.period((3.0, 3.0)), NO_ESTIMATE, (3.0, 3.0))
    assert memory is not None
    return memory, plant


@pytest.mark.parametrize("j", range(H), ids=[f"{jump.rises or jump.falls}-{jump.target}" for jump in JUMPS])
def test_a_signature_is_what_the_jump_leaves_in_the_innovations(j: int) -> None:
    """The same readings through two filters, one told of the jump: their innovations differ by the signature."""
    memory, plant = a_memory()
    setup = DETECTOR._setup
    told = (memory.x.copy(), memory.P.copy())
    untold = (memory.x.copy(), memory.P.copy())
    size = 1e-3 if JUMPS[j].state >= process.BIAS else 1e-2
    size = 1e-4 if JUMPS[j].state >= process.DRIFT else size
    told[0][JUMPS[j].state] += size
    b = bank.Bank.empty()
    bank.open_slot(0, bank.STATES, b.onset, b.effect, b.energy, b.match, b.cross)
    slot = int(np.argmax(b.onset == 0))
    energy = 0.0
    work = [(np.zeros((6, process.N)), np.zeros((process.N, 4)), np.zeros((4, 4)), np.zeros(4)) for _ in range(2)]
    for _ in range(15):
        memory.now += 1
        DETECTOR._note(memory, memory.t_s + PERIOD_S, plant.period((3.2, 2.9)), (3.2, 2.9))
        entry = memory.entry.copy()
        # readings just as the untold filter expects them: what then shows in the other's innovations is the jump alone
        process.step(setup.c, setup.walk, untold[0].copy(), untold[1].copy(), entry, *work[0])
        entry[2:6] -= work[0][3]
        process.step(setup.c, setup.walk, *told, entry, *work[0])
        process.step(setup.c, setup.walk, *untold, entry, *work[1])
        bank.advance(setup.c[13], entry, *work[1][:3], work[1][3], b.effect, b.energy, b.match, b.cross)
        difference = work[1][2] @ (work[1][3] - work[0][3]) / size
        energy += float(difference @ difference)
    assert b.energy[j, slot] == pytest.approx(energy, rel=0.04)


def test_the_ratio_is_the_best_over_sizes() -> None:
    memory, _ = a_memory(30.0)
    b = memory.bank
    taken = np.flatnonzero(b.onset >= 0)
    none = np.zeros(H)
    ratio, slot = np.zeros(H + 1), np.zeros(H + 1, dtype=np.int64)
    greatest = bank.best(none, none, b.onset, b.energy, b.match, b.cross, ratio, slot)
    with np.errstate(invalid="ignore", divide="ignore"):
        expected = np.nan_to_num(b.match[:, taken] ** 2 / b.energy[:, taken] / 2.0).max(axis=1)
    assert ratio[:H] == pytest.approx(expected)
    assert greatest == pytest.approx(ratio.max())
    assert ratio[H] <= expected[0] + expected[1] + 1e-9 or b.cross[slot[H]] != 0.0


def test_onsets_thin_out_with_age_and_never_exceed_the_slots() -> None:
    b = bank.Bank.empty()
    for now in range(2000):
        bank.open_slot(now, bank.STATES, b.onset, b.effect, b.energy, b.match, b.cross)
    ages = np.sort(1999 - b.onset[b.onset >= 0])
    kept = [age for age in ages if age <= bank.OLDEST]
    assert list(ages[: bank.FRESH]) == list(range(bank.FRESH))
    assert max(kept) > bank.OLDEST - 64
    gaps = np.diff(kept)
    assert all(gap <= max(1, age / bank.PER_OCTAVE) for gap, age in zip(gaps, kept[1:], strict=True))


def test_no_slot_that_is_still_wanted_is_taken() -> None:
    b = bank.Bank.empty()
    for now in range(1500):
        wanted = {int(onset) for onset in b.onset if onset >= 0 and bank.is_kept(onset, now)}
        bank.open_slot(now, bank.STATES, b.onset, b.effect, b.energy, b.match, b.cross)
        assert wanted <= {int(onset) for onset in b.onset}
