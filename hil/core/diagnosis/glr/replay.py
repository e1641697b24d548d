"""The filter again, from the onset on, once per hypothesis: exact where the bank is linear.

Each hypothesis is the filter as it stood at the onset, with room to jump: the variance of the state that jumps. How
well it then predicts the readings, against the filter that knows of no jump, tells the hypotheses apart; its state
tells the size.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from hil.core.diagnosis.glr import bank
from hil.core.diagnosis.glr.bank import SLOTS
from hil.core.diagnosis.glr.hypotheses import BOTH, JUMPS, PUMPS, H
from hil.core.diagnosis.glr.process import BIAS, Array, Ints, N

RING = bank.OLDEST + 64
"""Steps of history that are kept: a little more than the oldest onset needs."""

ENTRY = 12
ONSET_SPREAD = 0.3
"""Standard deviation of an onset within its control period, in periods (that of a uniform one)."""

JUMPING_BIAS = np.array([jump.state - BIAS if BIAS <= jump.state < BIAS + 4 else -1 for jump in JUMPS] + [-1])


@dataclass(frozen=True, eq=False)
class History:
    """What the filters saw, by step modulo RING, and the filter's state at the onset of every slot of the bank."""

    entries: Array  # (RING, ENTRY)
    none: Array  # (RING,) log-likelihood of the readings without a jump
    x: Array  # (SLOTS, N)
    P: Array  # (SLOTS, N, N)

    @classmethod
    def empty(cls) -> History:
        """Nothing seen."""
        return cls(np.zeros((RING, ENTRY)), np.zeros(RING), np.zeros((SLOTS, N)), np.zeros((SLOTS, N, N)))


@dataclass(frozen=True, eq=False)
class Replays:
    """One filter a hypothesis, H + 1 of them; all arrays change in place.

    x : (H + 1, N). P : (H + 1, N, N). evidence : (H + 1,) log-likelihood ratio against no jump. seen : (H + 1,) the
    last step that the filter has taken in. onset : (H + 1,) the step at which its jump begins. before : (H + 1, N) the
    state at the onset. bias : (H + 1,) the sensor whose bias jumps, from 0; -1 for none.
    dropped : (H + 1,) 1 for those that have fallen too far behind to be worth their time. misfit : (H + 1,) how far the
    latest readings are from what the replay itself expects, see `process.catch_up`. fit, x_fit, P_fit : (H + 1,) a
    late step at which they were as expected, and the filter at it.
    """

    x: Array
    P: Array
    evidence: Array
    seen: Ints
    onset: Ints
    before: Array
    bias: Ints
    dropped: Ints
    misfit: Array
    fit: Ints
    x_fit: Array
    P_fit: Array

    @classmethod
    def empty(cls) -> Replays:
        """None under way."""
        n = H + 1
        return cls(
            np.zeros((n, N)),
            np.zeros((n, N, N)),
            np.zeros(n),
            np.zeros(n, dtype=np.int64),
            np.zeros(n, dtype=np.int64),
            np.zeros((n, N)),
            np.full(n, -1, dtype=np.int64),
            np.zeros(n, dtype=np.int64),
            np.zeros(n),
            np.zeros(n, dtype=np.int64),
            np.zeros((n, N)),
            np.zeros((n, N, N)),
        )

    def begin(self, row: int, number: int, history: History, slot: int, onset: int, reach: Array) -> None:
        """Put hypothesis `number` at the onset of a slot, in row `row`.

        reach : (4,) cm, how far the jump, as the bank has it, moves each level in one period.
        """
        self.x[row] = self.before[row] = history.x[slot]
        P = self.P[row]
        P[:] = history.P[slot]
        for jump in (JUMPS[i] for i in (PUMPS if number == BOTH else (number,))):
            P[jump.state, jump.state] += jump.prior**2
        P[range(4), range(4)] += (ONSET_SPREAD * reach) ** 2
        self.evidence[row] = self.misfit[row] = 0.0
        self.seen[row] = self.onset[row] = self.fit[row] = onset
        self.bias[row] = JUMPING_BIAS[number]
        self.dropped[row] = 0

    def take(self, row: int, other: Replays, its_row: int) -> None:
        """Replace a row by one of another's."""
        for one in fields(self):
            getattr(self, one.name)[row] = getattr(other, one.name)[its_row]
