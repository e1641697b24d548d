"""Two like faults in the same step: the valves, the outlets of two tanks, or leaks of both upper tanks.

The bank has no jumps for them. The two show at different sensors, so that the ratio of a pair is nearly the sum of
those of its two jumps at the same onset. Only at an alarm, and where both count, a replay is begun.
Why: `docs/decisions/0055-two-like-faults-at-once.md`.
"""

from __future__ import annotations

import numpy as np

from hil.core.diagnosis.glr import ambiguity, onsets, unknown
from hil.core.diagnosis.glr.ambiguity import NO_EVIDENCE
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.hypotheses import ALL, BOTH, PLAIN, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import Array

MIN_RATIO = 2.0
"""Each of the two jumps has at least this log-likelihood ratio, two standard deviations of its size."""


def begin(config: DetectorConfig, m: Memory) -> None:
    """Begin a replay of each pair that the bank's single jumps speak for, at its likeliest onset."""
    for number in range(BOTH + 1, ALL):
        slot = _likeliest_slot(m, number, m.max_ratio - config.tuning.margin)
        if slot is None:
            m.replays.evidence[number], m.replays.dropped[number] = NO_EVIDENCE, 1
        else:
            onsets.begin(m, m.replays, number, number, PLAIN, slot)


def _likeliest_slot(m: Memory, number: int, enough: float) -> int | None:
    """The slot of the bank at which both jumps have one sign, sizes that count, and together the greatest ratio.

    None if there is none, or if they have less than enough together.
    """
    rise, fall = m.min_jumps()
    places = list(jumps_of(number))
    energy, match = m.bank.energy[places], m.bank.match[places]
    sizes = np.divide(match, energy, out=np.zeros_like(match), where=energy > 0.0)
    ratios = 0.5 * match * sizes
    least = np.where(sizes > 0.0, rise[places, None], fall[places, None])
    count = (np.abs(sizes) >= least) & (ratios >= MIN_RATIO)
    is_usable = count.all(axis=0) & (sizes[0] * sizes[1] > 0.0) & (m.bank.onset >= 0)
    together = np.where(is_usable, ratios.sum(axis=0), 0.0)
    slot = int(np.argmax(together))
    return slot if is_usable[slot] and float(together[slot]) >= enough else None


def best_without(evidence: Array, number: int) -> float:
    """The greatest evidence of the pairs here that are not about this hypothesis. evidence : (ALL,)."""
    return max(float(evidence[n]) for n in range(BOTH + 1, ALL) if number not in jumps_of(n))


def leader(config: DetectorConfig, m: Memory, evidence: Array, order: list[int]) -> int | None:
    """The pair that is the likeliest, if it leads all else by the margin, its own two faults as well; or None."""
    pair, second = order[:2]
    margin = config.tuning.margin * unknown.dispersion(m, pair)
    rival = max(float(evidence[second]), ambiguity.best_small(m))
    return pair if float(evidence[pair]) - rival >= margin else None
