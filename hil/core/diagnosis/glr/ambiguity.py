"""What can't be told apart yet: such alarms stay unresolved with their candidates, and no name is guessed.

At rest, under integral action, a drift of a lower tank's sensor and a slow change of that tank's outlet give the same
readings and the same voltages. They differ when the level or the reference moves, because the time constants do. A
fault that grows is at first smaller than the smallest that is declared, and others may resemble it.
"""

from __future__ import annotations

from hil.core.diagnosis.glr.hypotheses import BOTH, JUMPS, H
from hil.core.diagnosis.glr.memory import DetectorConfig, Memory
from hil.core.diagnosis.glr.model import BIAS, DRIFT, OUTLET
from hil.core.types import OpenQuestion

LOWER = 2
"""Tanks 1 and 2 are the lower ones."""

NO_EVIDENCE = -1e300
"""Evidence of an impossible hypothesis; finite, so that differences are."""

SLOW_DRIFT_V_S = 0.003
"""A slower drift of a lower tank's sensor must lead by twice the margin: outlets clog as slowly, and it can wait."""

GROWTH_MARGIN = 1.5
"""A leak or blockage that grows must lead a drift by the margin of a drift times this."""


def is_drift_or_level(config: DetectorConfig, m: Memory, number: int, *, is_late: bool) -> bool:
    """Whether it is still open if the sensor of a lower tank drifts, or if the level does what it shows.

    At rest a drift and a changed outlet look the same, and a drift that is declared wrongly takes away the sensor that
    shows the tank fill. number : the hypothesis that would be declared. is_late : whether it would be for lack of time.
    """
    r, tuning = m.replays, config.tuning
    if number == BOTH or not (OUTLET <= JUMPS[number].state < OUTLET + 2 or DRIFT <= JUMPS[number].state < DRIFT + 2):
        return False
    if JUMPS[number].state >= DRIFT:
        rivals = [r.evidence[n] for n in range(H + 1) if n == BOTH or JUMPS[n].state < BIAS]
        is_slow = abs(float(r.x[number, JUMPS[number].state])) < SLOW_DRIFT_V_S
        return bool(r.evidence[number] - max(rivals) < tuning.drift_margin * (2.0 if is_slow else 1.0))
    drift = next(n for n, jump in enumerate(JUMPS) if jump.state == DRIFT + JUMPS[number].state - OUTLET)
    lead = float(r.evidence[number] - r.evidence[drift])
    grows = r.target[number] == JUMPS[number].state
    return lead < GROWTH_MARGIN * tuning.drift_margin if grows else is_late and lead < tuning.margin


def open_question(m: Memory) -> OpenQuestion | None:
    """Whether it is open if a lower tank's level changes or its sensor drifts, and of which tank.

    It is while an alarm is unresolved and one of the two is the likeliest, and while a declared drift is reviewed.
    """
    if m.suspicion is None:
        if m.rival is None or m.rival.sensor >= LOWER or m.rival.suspicion.number is None:
            return None
        return OpenQuestion(alarm=m.rival.suspicion.number, tank=m.rival.sensor + 1)
    number, leader = m.suspicion.number, m.suspicion.leader
    if number is None or leader is None or leader == BOTH:
        return None
    state = JUMPS[leader].state
    for first in (OUTLET, DRIFT):
        if first <= state < first + LOWER:
            return OpenQuestion(alarm=number, tank=state - first + 1)
    return None


def best_small(m: Memory) -> float:
    """The greatest evidence of a fault that is too small so far to be declared: it may be one that grows."""
    r, best = m.replays, NO_EVIDENCE
    for number in range(H):
        jump = JUMPS[number]
        size = float(r.x[number, jump.state] - r.before[number, jump.state])
        is_small = abs(size) < (jump.rise[0] if size > 0.0 else jump.fall[0])
        if jump.state < BIAS and is_small and (jump.rises if size > 0.0 else jump.falls):
            best = max(best, float(r.evidence[number]))
    return best
