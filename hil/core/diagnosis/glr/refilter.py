"""The replay: the filter again, from the onset on, once per hypothesis; exact where the bank is linear.

Each hypothesis is the filter as it was at the onset, with room to jump: the variance of the state that jumps. How
well it then predicts the readings, against the filter that assumes no jump, tells the hypotheses apart; its state
tells the size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.core.diagnosis.glr.bank import MAX_AGE, SLOTS
from hil.core.diagnosis.glr.compiled import compiled
from hil.core.diagnosis.glr.filter import ENTRY, PERIOD, READING, StepResult, filter_step, whitened
from hil.core.diagnosis.glr.growth import BOTH_GAINS, NO_GROWTH, grow
from hil.core.diagnosis.glr.hypotheses import BIAS_PRIOR_V, BOTH, JUMPS, PAIR_ODDS, PAIRS, ROWS, VARIANTS, jumps_of
from hil.core.diagnosis.glr.model import BIAS, LEVEL, MOVING, RATE, Array, FilterModel, Ints, N

RING = MAX_AGE + 64
"""Steps of history that are kept: a little more than the oldest onset needs."""

ONSET_SPREAD = 0.3
"""Standard deviation of an onset within its control period, in periods (that of a uniform one)."""

MAX_SQUARE = 30.0
"""One squared innovation counts for no more in what a replay leaves unexplained: one odd reading says little."""

MISFIT_SLACK, MAX_MISFIT_STEP = 2.0, 15.0
"""What a step's readings may be off before it counts, and may count for at the most: one odd step says nothing."""

FIT_STEPS = 5
"""Between two steps kept as those at which a replay fits: what has just begun doesn't show in a step or two."""

JUMPING_BIAS = np.array(
    [jump.state - BIAS if BIAS <= jump.state < BIAS + 4 else -1 for jump in JUMPS] + [-1] * len(PAIRS)
)


class History(NamedTuple):
    """What the filters saw, by step modulo RING, and the filter's state at the onset of every slot of the bank.

    entries : (RING, ENTRY), see `filter`. no_jump : (RING,) log-likelihood of the readings without a jump.
    x : (SLOTS, N). P : (SLOTS, N, N).
    """

    entries: Array
    no_jump: Array
    x: Array
    P: Array

    @classmethod
    def empty(cls) -> History:
        """Nothing seen."""
        return cls(
            entries=np.zeros((RING, ENTRY)),
            no_jump=np.zeros(RING),
            x=np.zeros((SLOTS, N)),
            P=np.zeros((SLOTS, N, N)),
        )


class Replays(NamedTuple):
    """One filter a hypothesis, then one a variant, R in all; all arrays change in place.

    x : (R, N). P : (R, N, N). evidence : (R,) log-likelihood ratio against no jump. seen : (R,) the last step that the
    filter has taken in. onset : (R,) the step at which its jump begins. before : (R, N) the state at the onset.
    bias : (R,) the sensor whose bias jumps, from 0; -1 for none. variant : (R,) place in VARIANTS, -1 for the plain
    jump. target : (R,) the state that grows, see `growth`.
    dropped : (R,) 1 for those that have fallen too far behind to be worth their time. misfit : (R,) how far the
    latest readings are from what the replay itself expects, see `catch_up`. fit, x_fit, P_fit : (R,) a late step
    at which they were as expected, and the filter at it. squares, squares_fit : (R, 5) sums of the squared whitened
    innovations of each sensor since the onset, and their number; the same at the step `fit`.
    """

    x: Array
    P: Array
    evidence: Array
    seen: Ints
    onset: Ints
    before: Array
    bias: Ints
    variant: Ints
    target: Ints
    dropped: Ints
    misfit: Array
    fit: Ints
    x_fit: Array
    P_fit: Array
    squares: Array
    squares_fit: Array

    @classmethod
    def empty(cls) -> Replays:
        """None under way."""
        n = ROWS
        return cls(
            x=np.zeros((n, N)),
            P=np.zeros((n, N, N)),
            evidence=np.zeros(n),
            seen=np.zeros(n, dtype=np.int64),
            onset=np.zeros(n, dtype=np.int64),
            before=np.zeros((n, N)),
            bias=np.full(n, -1, dtype=np.int64),
            variant=np.full(n, -1, dtype=np.int64),
            target=np.full(n, NO_GROWTH, dtype=np.int64),
            dropped=np.zeros(n, dtype=np.int64),
            misfit=np.zeros(n),
            fit=np.zeros(n, dtype=np.int64),
            x_fit=np.zeros((n, N)),
            P_fit=np.zeros((n, N, N)),
            squares=np.zeros((n, 5)),
            squares_fit=np.zeros((n, 5)),
        )

    def begin(
        self, row: int, number: int, variant: int, history: History, slot: int, onset: int, reach: Array, target: int
    ) -> None:
        """Put hypothesis `number` at the onset of a slot, in row `row`.

        variant : place in VARIANTS, -1 for the plain jump. reach : (8,) how far the jump, as the bank has it, moves
        each level, cm, and each sensor's bias, V, in one period. target : what grows already, see `growth`.
        """
        self.x[row] = self.before[row] = history.x[slot]
        P = self.P[row]
        P[:] = history.P[slot]
        way = VARIANTS[variant] if variant >= 0 else None
        for jump in (JUMPS[i] for i in jumps_of(number)):
            P[jump.state, jump.state] += (way.prior if way else jump.prior) ** 2
            self.x[row, jump.state] += way.shift if way else 0.0
        if way and way.rate > 0.0:
            target = BOTH_GAINS if number == BOTH else JUMPS[number].state
            self.x[row, RATE] = 0.0
            P[RATE, :] = P[:, RATE] = 0.0
            P[RATE, RATE] = way.rate**2
        moved = (*range(LEVEL, LEVEL + 4), *range(BIAS, BIAS + 4))
        P[moved, moved] += (ONSET_SPREAD * reach) ** 2
        odds = PAIR_ODDS if number > BOTH else 0.0
        self.evidence[row], self.misfit[row] = way.odds if way else odds, 0.0
        self.seen[row] = self.onset[row] = self.fit[row] = onset
        self.bias[row] = JUMPING_BIAS[number]
        self.variant[row], self.target[row] = variant, target
        self.dropped[row] = 0
        self.squares[row] = self.squares_fit[row] = 0.0

    def swap(self, row: int, other: int) -> None:
        """Exchange two rows."""
        for array in self:
            array[[row, other]] = array[[other, row]]

    def take(self, row: int, other: Replays, its_row: int) -> None:
        """Replace a row by one of another's."""
        for mine, theirs in zip(self, other, strict=True):
            mine[row] = theirs[its_row]


@compiled
def catch_up(model: FilterModel, history: History, replays: Replays, rows: int, now: int, budget: int) -> int:
    """Take the first `rows` filters on towards step `now`, by at most `budget` filter steps; how many are still to do.

    In the period in which a bias begins, the mean of that sensor's readings holds part of it only: what is learned of
    the bias there is forgotten. That is the first reading since the onset: an empty tank is not read before.
    """
    result = StepResult(np.zeros((MOVING, N)), np.zeros((N, 4)), np.zeros((4, 4)), np.zeros(4), np.zeros(4))
    left = 0
    for j in range(rows):
        if replays.dropped[j]:
            continue
        while replays.seen[j] < now and budget > 0:
            replays.seen[j] += 1
            budget -= 1
            at = replays.seen[j] % history.entries.shape[0]
            entry = history.entries[at]
            grow(replays.x[j], replays.P[j], replays.target[j], entry[PERIOD])
            likelihood = filter_step(model, replays.x[j], replays.P[j], entry, result)
            replays.evidence[j] += likelihood - history.no_jump[at]
            bias = replays.bias[j]
            is_unread = bias >= 0 and replays.squares[j, bias] == 0.0
            _watch_misfit(entry, result, replays, j)
            if is_unread and replays.squares[j, bias] > 0.0:
                _forget_bias(replays.P[j], BIAS + bias)
        left += now - replays.seen[j]
    return left


@compiled
def _watch_misfit(entry: Array, result: StepResult, replays: Replays, j: int) -> None:
    """How badly replay j fits the latest readings; the filter at a late step at which it fitted is kept.

    The misfit is a cumulative sum (Page, 1954) of half the squared whitened innovations in excess of what is expected
    of them, less a slack.
    """
    excess = 0.0
    for i in range(4):
        if np.isfinite(entry[READING + i]):
            value = whitened(result.whitener, result.innovation, i)
            excess += 0.5 * (value * value - 1.0)
            replays.squares[j, i] += min(value * value, MAX_SQUARE)
            replays.squares[j, 4] += 1.0
    excess -= MISFIT_SLACK
    replays.misfit[j] = max(replays.misfit[j] + min(excess, MAX_MISFIT_STEP), 0.0)
    if replays.misfit[j] == 0.0 and replays.seen[j] - replays.fit[j] >= FIT_STEPS:
        replays.fit[j] = replays.seen[j]
        replays.x_fit[j] = replays.x[j]
        replays.P_fit[j] = replays.P[j]
        replays.squares_fit[j] = replays.squares[j]


@compiled
def _forget_bias(P: Array, state: int) -> None:
    """Back to what is known of a bias before any reading."""
    P[state, :] = 0.0
    P[:, state] = 0.0
    P[state, state] = BIAS_PRIOR_V**2
