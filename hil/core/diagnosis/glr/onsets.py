"""Onsets of the replays: where one begins at an alarm, and which others are tried before a verdict.

An onset that is wrong by half a second costs the true hypothesis of a jump more than the margin of a verdict. The onset
of a fault that grows shows less; it is looked for from less than half to twice as long ago.
"""

from __future__ import annotations

import numpy as np

from hil.core.diagnosis.glr import kernels
from hil.core.diagnosis.glr.bank import MAX_AGE, SLOTS
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD
from hil.core.diagnosis.glr.hypotheses import ALL, JUMPS, ROWS, VARIANTS, H, Variant, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import BIAS, DRIFT, OUTLET
from hil.core.diagnosis.glr.refilter import Replays

ONSETS_AROUND = (-8, -4, -2, -1, 0, 1, 2, 4, 8)
AGES_AROUND = (0.4, 0.55, 0.75, 1.3, 1.7, 2.2)
"""Onsets to try, in steps from the likeliest; of growth, the times since the onset, over the likeliest."""

MAX_PRIORS = 2.0
"""Largest drift, in standard deviations of its prior, whose effect within its first period is left open."""

NO_LIMIT = 1 << 40
"""Filter steps; more than there can be."""

GROWTH_AGE = 1.5
"""Since the onset of a fault that grows, over the time since that of the jump that looks most like it."""


def earlier(m: Memory, slot: int, leader: int) -> int:
    """The slot at which a fault began to grow that looks like a jump at the onset of this slot.

    leader : slot of the likeliest jump. Growth begins no later: while a fault is smaller than what the bank counts, the
    bank's best onset for it may be any recent one.
    """
    begun, slots = m.bank.onset, slots_in_use(m)
    age = m.now - min(int(begun[slot]), int(begun[leader]))
    early = [s for s in slots if begun[s] <= m.now - GROWTH_AGE * age]
    return max(early, key=lambda s: int(begun[s])) if early else min(slots, key=lambda s: int(begun[s]))


def slots_in_use(m: Memory) -> list[int]:
    """Slots that are in use, and whose replay is done before the history forgets its first steps."""
    return [s for s in range(SLOTS) if m.bank.onset[s] >= 0 and m.now - m.bank.onset[s] <= MAX_AGE]


def begin(m: Memory, replays: Replays, row: int, number: int, variant: int, slot: int) -> None:
    """Begin a replay of hypothesis `number`, its onset that of a slot of the bank."""
    reach = np.zeros(8)
    for j in jumps_of(number):
        energy = m.bank.energy[j, slot]
        size = min(max(m.bank.match[j, slot] / energy, -1.0), 1.0) if energy > 0.0 else 0.0
        reach[:4] += size * m.result.A[:4, JUMPS[j].state]
        if JUMPS[j].state >= DRIFT:
            most = MAX_PRIORS * JUMPS[j].prior  # with more, a drift would explain a bias that jumps
            reach[4 + JUMPS[j].state - DRIFT] += min(max(size, -most), most) * float(m.entry[PERIOD])
    replays.begin(row, number, variant, m.history, slot, int(m.bank.onset[slot]), reach, m.growing)


def alike(number: int) -> tuple[int, ...]:
    """The leaks and blockages of the tank whose sensor a drift is about: they change the same reading at first."""
    if number >= H or JUMPS[number].state < DRIFT:
        return ()
    tank = JUMPS[number].target
    return tuple(n for n, jump in enumerate(JUMPS) if OUTLET <= jump.state < BIAS and jump.target == tank)


def sharpen(config: DetectorConfig, m: Memory, number: int) -> None:
    """Try onsets around that of a hypothesis, and of its growth; the best replay takes its place.

    Each is judged against no jump from its own onset on, so that the ratios compare as they are.
    """
    growing = (row for row in range(ALL, ROWS) if _grows(VARIANTS[row - ALL], number))
    for row in (number, *growing):
        _sharpen_row(config, m, row, number)


def _grows(variant: Variant, number: int) -> bool:
    return variant.number == number and variant.rate > 0.0 and variant.onset_of is None


def _sharpen_row(config: DetectorConfig, m: Memory, row: int, number: int) -> None:
    r, scratch = m.replays, m.scratch
    onset, variant = int(r.onset[row]), int(r.variant[row])
    near = _ages_around(m, onset) if variant >= 0 and VARIANTS[variant].rate > 0.0 else _onsets_around(m, onset)
    if not near or m.now - onset > MAX_AGE:
        return
    for place, slot in enumerate(near):
        begin(m, scratch, place, number, variant, slot)
    kernels.catch_up(config.model, m.history, scratch, len(near), m.now, NO_LIMIT)
    best = int(np.argmax(scratch.evidence[: len(near)]))
    if scratch.evidence[best] > r.evidence[row]:
        r.take(row, scratch, best)


def _onsets_around(m: Memory, onset: int) -> list[int]:
    """Slots of the onsets a few steps from this one, and of itself."""
    slot_of = {int(at): slot for slot, at in enumerate(m.bank.onset) if at >= 0}
    return [slot_of[onset + by] for by in ONSETS_AROUND if onset + by in slot_of and onset + by < m.now - 1]


def _ages_around(m: Memory, onset: int) -> list[int]:
    """Slots of onsets from less than half to twice as long ago: the onset of growth shows little by itself."""
    begun, slots = m.bank.onset, slots_in_use(m)
    wanted = [m.now - round(share * (m.now - onset)) for share in AGES_AROUND]
    nearest = {int(np.argmin([abs(int(begun[s]) - at) for s in slots])) for at in wanted}
    return [slots[n] for n in sorted(nearest) if begun[slots[n]] not in (onset, m.now, m.now - 1)]
