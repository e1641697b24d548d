"""Hidden level: how full a lower tank is if its sensor drifts downwards, as long as that is not excluded.

A drift downwards is easily named a leak, a valve or a pump, and the tank fills while its reading stays. So the drift's
filter goes on beside the main one until the readings have excluded it, and while an alarm is open its replay does. The
interlocks act by the level that it implies; control does not use it.
"""

from __future__ import annotations

from math import inf, sqrt

from hil.core.diagnosis.glr import ambiguity
from hil.core.diagnosis.glr.ambiguity import LOWER
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.hypotheses import JUMPS, drift_of, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Hidden
from hil.core.diagnosis.glr.model import DRIFT, LEVEL, Array
from hil.core.types import Pair

NONE: Pair = (-inf, -inf)
SURE_STDS = 2.0
"""The level is taken to be higher than found by so many of its standard deviations."""


def begin(config: DetectorConfig, m: Memory, winner: int) -> Hidden | None:
    """The drift downwards of a lower sensor that is not excluded although another fault is declared, or None.

    Of two the likelier. winner : the hypothesis that is declared.
    """
    if JUMPS[jumps_of(winner)[0]].state >= DRIFT:
        return None
    r = m.replays
    limit = config.tuning.detect + ambiguity.model_doubt(m, winner)
    least = float(r.evidence[winner]) - limit
    tanks = [tank for tank in range(LOWER) if _is_possible(m, tank, least)]
    if not tanks:
        return None
    tank = max(tanks, key=lambda i: float(r.evidence[drift_of(i + 1)]))
    number = drift_of(tank + 1)
    return Hidden(
        tank=tank,
        x=r.x[number].copy(),
        P=r.P[number].copy(),
        lead=float(r.evidence[winner] - r.evidence[number]),
        target=int(r.target[number]),
        limit=limit,
    )


def step(config: DetectorConfig, m: Memory, log_likelihood: float) -> None:
    """One step of the drift's filter. log_likelihood : of this step's readings in the main filter."""
    hidden = m.hidden
    if hidden is None:
        return
    if hidden.tank in m.lost:
        m.hidden = None
        return
    hidden.lead += log_likelihood - config.filter_beside(hidden.x, hidden.P, m.entry, hidden.target)
    if hidden.lead > hidden.limit or hidden.x[DRIFT + hidden.tank] >= 0.0:
        m.hidden = None


def levels_cm(config: DetectorConfig, m: Memory) -> Pair:
    """(2,) levels of the lower tanks by drifts that are not excluded; -inf where there is none."""
    if m.hidden is None and m.suspicion is None:
        return NONE
    found = [-inf, -inf]
    if m.hidden is not None:
        found[m.hidden.tank] = _highest_cm(m.hidden.x, m.hidden.P, m.hidden.tank)
    if m.suspicion is not None and m.suspicion.leader is not None:
        r, leader = m.replays, m.suspicion.leader
        least = float(r.evidence[leader]) - config.tuning.detect - ambiguity.model_doubt(m, leader)
        for tank in range(LOWER):
            if _is_possible(m, tank, least):
                number = drift_of(tank + 1)
                found[tank] = max(found[tank], _highest_cm(r.x[number], r.P[number], tank))
    return found[0], found[1]


def _highest_cm(x: Array, P: Array, tank: int) -> float:
    """The level of a tank that the filter of a drift finds, and what it may be higher."""
    state = LEVEL + tank
    return float(x[state]) + SURE_STDS * sqrt(max(float(P[state, state]), 0.0))


def _is_possible(m: Memory, tank: int, least: float) -> bool:
    """Whether the replay of the drift goes on, falls, and has at least this evidence."""
    r, number = m.replays, drift_of(tank + 1)
    is_alive = not r.dropped[number] and float(r.evidence[number]) >= least
    return bool(is_alive and m.usable[tank] and float(r.x[number, DRIFT + tank]) < 0.0)
