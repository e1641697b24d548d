"""Two like faults in the same step: when a replay begins, and when it is the verdict."""

from __future__ import annotations

import numpy as np
import pytest

from hil.core.diagnosis.glr import pairs
from hil.core.diagnosis.glr.ambiguity import NO_EVIDENCE
from hil.core.diagnosis.glr.bank import Bank
from hil.core.diagnosis.glr.hypotheses import ALL, BOTH, PAIRS, H, jumps_of, outlet_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.types import Measurement
from tests.glr.glr_bench import DETECTOR

CONFIG = DETECTOR.config
LOWER = next(n for n in range(H, ALL) if jumps_of(n) == (outlet_of(1), outlet_of(2)))
SLOT = 3


def memory_of(ratio1: float, ratio2: float, size2: float = -0.3) -> Memory:
    """A bank in which the lower outlets have these log-likelihood ratios at one onset; outlet 1 a size of -0.4."""
    m = Memory.begin(CONFIG, 0.0, Measurement((6.2, 6.4, 0.8, 0.7), (True,) * 4, 0.0, 5), (3.0, 3.0))
    bank: Bank = m.bank
    m.now, bank.onset[SLOT], m.max_ratio = 10, 5, 30.0
    m.history.P[SLOT] = np.eye(m.history.P.shape[1]) * 1e-6
    for tank, ratio, size in ((1, ratio1, -0.4), (2, ratio2, size2)):
        bank.energy[outlet_of(tank), SLOT] = 2.0 * ratio / size**2
        bank.match[outlet_of(tank), SLOT] = 2.0 * ratio / size
    return m


def test_a_pair_that_both_jumps_speak_for_is_replayed_from_their_onset() -> None:
    m = memory_of(20.0, 15.0)
    pairs.begin(CONFIG, m)
    assert m.replays.dropped[LOWER] == 0
    assert m.replays.onset[LOWER] == 5
    assert m.replays.evidence[LOWER] < 0.0, "two faults at once are rarer than one"
    others = [n for n in range(BOTH + 1, ALL) if n != LOWER]
    assert (m.replays.dropped[others] == 1).all()
    assert (m.replays.evidence[others] == NO_EVIDENCE).all()


@pytest.mark.parametrize(
    ("ratio1", "ratio2", "size2"),
    [(29.0, 1.5, -0.3), (12.0, 12.0, -0.3), (20.0, 15.0, 0.3), (20.0, 15.0, -0.005)],
    ids=["one alone", "far behind the likeliest fault", "opposite signs", "too small to count"],
)
def test_other_pairs_are_not_replayed(ratio1: float, ratio2: float, size2: float) -> None:
    """Each replay takes filter steps of the others: a single fault must not have its name later."""
    m = memory_of(ratio1, ratio2, size2)
    pairs.begin(CONFIG, m)
    assert m.replays.dropped[LOWER] == 1


@pytest.mark.parametrize(("lead", "is_declared"), [(4.0, False), (6.0, True)])
def test_a_pair_has_to_lead_its_own_faults_too(lead: float, is_declared: bool) -> None:
    m = memory_of(20.0, 15.0)
    m.replays.x[:] = m.replays.before[:] = m.x
    evidence = np.zeros(ALL)
    evidence[LOWER], evidence[outlet_of(1)] = 40.0, 40.0 - lead
    order = [int(n) for n in np.argsort(-evidence)]
    assert pairs.leader(CONFIG, m, evidence, order) == (LOWER if is_declared else None)


def test_a_pair_is_no_rival_of_the_faults_that_it_includes() -> None:
    evidence = np.zeros(ALL)
    evidence[LOWER] = 40.0
    assert pairs.best_without(evidence, outlet_of(1)) == 0.0
    assert pairs.best_without(evidence, BOTH) == pairs.best_without(evidence, 0) == 40.0


def test_the_pumps_are_the_first_pair_and_no_fault_is_in_two() -> None:
    assert jumps_of(BOTH) == (0, 1)
    assert len({j for pair in PAIRS for j in pair}) == 2 * len(PAIRS)
