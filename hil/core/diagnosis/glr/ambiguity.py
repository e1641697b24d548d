"""What can't be told apart yet: such alarms stay unresolved with their candidates, and no name is guessed.

At rest, under integral action, a drift of a lower tank's sensor and a slow change of that tank's outlet give the same
readings and the same voltages. They differ when the level or the reference moves, because the time constants do. A
fault that grows is at first smaller than the smallest that is declared, and others may resemble it.
"""

from __future__ import annotations

import numpy as np

from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, VOLTAGE
from hil.core.diagnosis.glr.hypotheses import ALL, JUMPS, H, drift_of, jumps_of, outlet_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import BIAS, DRIFT, LEVEL, OUTLET, Array
from hil.core.types import OpenQuestion

LOWER = 2
"""Tanks 1 and 2 are the lower ones."""

NO_EVIDENCE = -1e300
"""Evidence of an impossible hypothesis; finite, so that differences are."""

SLOW_DRIFT_V_S = 0.003
"""A slower drift of a lower tank's sensor must lead by twice the margin: outlets clog as slowly, and it can wait."""

MOVED_V, MEAN_S, MOVED_S = 0.15, 60.0, 20.0
"""A pump moves while its voltage is so far from its mean over MEAN_S: several times what noise does. After MOVED_S
of this time the simple margins hold."""

GROWTH_MARGIN = 1.5
"""A leak or blockage that grows must lead a drift by the margin of a drift times this, at rest."""


MODEL_SHARE = 0.002
"""On a rig that is proven not to be as its file says, so much of what a hypothesis explains may be owed to errors of
the model. A drift of -50 mV/s was a leak that led it by 11 of 20,800; an outlet that clogged led one by 10 of 258."""


def model_doubt(m: Memory, number: int) -> float:
    """By how much a hypothesis may lead the true one because of errors of the model, as a log-likelihood ratio."""
    return MODEL_SHARE * max(float(m.replays.evidence[number]), 0.0) if m.is_wide else 0.0


def is_drift_or_level(config: DetectorConfig, m: Memory, number: int, *, is_late: bool) -> bool:
    """Whether it is still open if the sensor of a lower tank drifts, or if the level does what it shows.

    At rest a drift and a changed outlet look the same, and a drift that is declared wrongly takes away the sensor that
    shows the tank fill. number : the hypothesis that would be declared. is_late : whether it would be for lack of time.
    """
    r, tuning = m.replays, config.tuning
    if number >= H or not (OUTLET <= JUMPS[number].state < OUTLET + 2 or DRIFT <= JUMPS[number].state < DRIFT + 2):
        return False
    if JUMPS[number].state >= DRIFT:
        rivals = [r.evidence[n] for n in range(ALL) if JUMPS[jumps_of(n)[0]].state < BIAS]
        is_slow = abs(float(r.x[number, JUMPS[number].state])) < SLOW_DRIFT_V_S and not has_moved(m)
        return bool(r.evidence[number] - max(rivals) < tuning.drift_margin * (2.0 if is_slow else 1.0))
    drift = next(n for n, jump in enumerate(JUMPS) if jump.state == DRIFT + JUMPS[number].state - OUTLET)
    lead = float(r.evidence[number] - r.evidence[drift])
    grows = r.target[number] == JUMPS[number].state
    margin = tuning.drift_margin * (1.0 if has_moved(m) else GROWTH_MARGIN)
    if not grows:
        margin = tuning.margin if is_late else 0.0
    return (grows or is_late or m.is_wide) and lead < margin + model_doubt(m, number)


def safer(config: DetectorConfig, m: Memory, number: int, evidence: Array) -> int:
    """What to declare of a drift and a leak of the same lower tank where one of them must be declared: the drift.

    A drift keeps the sensor's veto on a high level. A falling drift that is taken for a leak lets the tank fill.
    """
    if number >= H or not OUTLET <= JUMPS[number].state < OUTLET + LOWER:
        return number
    state = JUMPS[number].state
    is_leak = m.replays.x[number, state] > m.replays.before[number, state]
    drift = drift_of(JUMPS[number].target)
    margin = config.tuning.margin + model_doubt(m, number)
    return drift if is_leak and evidence[number] - evidence[drift] < margin else number


def watch_movement(m: Memory) -> None:
    """Note for how long a pump has been away from where it was before, while an alarm is open."""
    if m.suspicion is None:
        return
    voltages = m.entry[VOLTAGE : VOLTAGE + 2]
    if m.suspicion.mean_V is None:
        m.suspicion.mean_V = voltages.copy()
    if float(np.abs(voltages - m.suspicion.mean_V).max()) > MOVED_V:
        m.suspicion.moved_s += float(m.entry[PERIOD])
    m.suspicion.mean_V += min(float(m.entry[PERIOD]) / MEAN_S, 1.0) * (voltages - m.suspicion.mean_V)


def has_moved(m: Memory) -> bool:
    """Whether the pumps have moved for long enough to tell a drift from a level."""
    return m.suspicion is not None and m.suspicion.moved_s >= MOVED_S


def is_led_by_small(m: Memory, number: int) -> bool:
    """Whether a fault that is too small so far to be declared explains the readings better: it is the likelier one.

    Without this a drift near the smallest that counts was declared as whatever came next, far behind.
    """
    r = m.replays
    return any(float(r.evidence[n]) > float(r.evidence[number]) and _is_small(m, n) for n in range(H) if n != number)


def leading_small(m: Memory, most: float) -> int | None:
    """The likeliest fault that is too small to be declared, if its evidence is above the greatest of the others."""
    found = too_small(m)
    best = max(found, key=lambda number: found[number], default=None)
    return best if best is not None and found[best] > most else None


def _is_small(m: Memory, number: int) -> bool:
    """Whether the fault has a possible sign, and less than the smallest size that counts."""
    jump = JUMPS[number]
    size = float(m.replays.x[number, jump.state] - m.replays.before[number, jump.state])
    is_small = abs(size) < (jump.rise[0] if size > 0.0 else jump.fall[0])
    return is_small and bool(jump.rises if size > 0.0 else jump.falls)


def open_question(config: DetectorConfig, m: Memory) -> OpenQuestion | None:
    """Whether it is open if a lower tank's level changes or its sensor drifts, and of which tank.

    It is while an alarm is unresolved and one of the two is the likeliest, and while a declared drift is reviewed and
    no movement has spoken for it yet.
    """
    if m.suspicion is None:
        if m.rival is None or m.rival.sensor >= LOWER or m.rival.suspicion.number is None:
            return None
        if m.rival.moved_lead >= config.tuning.detect:
            return None
        apart_cm = abs(float(m.rival.own_x[LEVEL + m.rival.sensor] - m.rival.x[LEVEL + m.rival.sensor]))
        return OpenQuestion(alarm=m.rival.suspicion.number, tank=m.rival.sensor + 1, apart_cm=apart_cm)
    number, leader = m.suspicion.number, m.suspicion.leader
    if number is None or leader is None or leader >= H:
        return None
    state = JUMPS[leader].state
    for first in (OUTLET, DRIFT):
        if first <= state < first + LOWER:
            tank = state - first + 1
            by_drift, by_outlet = (float(m.replays.x[n, LEVEL + tank - 1]) for n in (drift_of(tank), outlet_of(tank)))
            return OpenQuestion(alarm=number, tank=tank, apart_cm=abs(by_drift - by_outlet))
    return None


def too_small(m: Memory) -> dict[int, float]:
    """Evidence, by hypothesis, of the faults that are too small so far to be declared: one of them may be growing.

    A bias does not grow; a drift does, and its rate is known to a tenth only.
    """
    r = m.replays
    grow = (number for number, jump in enumerate(JUMPS) if not BIAS <= jump.state < DRIFT and not r.dropped[number])
    return {number: float(r.evidence[number]) for number in grow if _is_small(m, number)}


def best_small(m: Memory) -> float:
    """The greatest evidence of a fault that is too small so far to be declared."""
    return max(too_small(m).values(), default=NO_EVIDENCE)
