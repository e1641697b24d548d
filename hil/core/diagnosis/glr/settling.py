"""What a verdict changes: the winner's filter becomes the filter, and its fault is declared or learned."""

from __future__ import annotations

import numpy as np

from hil.core.diagnosis.glr import (
    ambiguity,
    declaration,
    drift_review,
    first_day,
    growth,
    hidden_level,
    onsets,
    own_verdict,
    rollback,
    stuck_check,
    unknown,
    verdict,
)
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.growth import NO_GROWTH
from hil.core.diagnosis.glr.hypotheses import JUMPS, PUMPS, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Checkpoint, Suspicion
from hil.core.diagnosis.glr.model import Array
from hil.core.diagnosis.glr.refilter import Replays
from hil.core.types import Alarm

CHECKPOINT_STEPS = 10
"""The checkpoint is at least this many steps before the onset of what is declared."""


def settle(config: DetectorConfig, m: Memory, suspicion: Suspicion, winner: int, order: list[int]) -> list[Alarm]:
    """The winner's filter becomes the filter.

    If it has explained the readings for long enough, its filter of some steps ago is used, and those steps are filtered
    again with the bank: a fault that has begun meanwhile is then seen from its onset on.
    """
    r, has_moved = m.replays, ambiguity.has_moved(m)
    is_own = own_verdict.is_own(config, m, winner)
    if suspicion.is_quiet:
        suspicion.detected_s = m.t_s  # nobody has heard of it before
    m.suspicion = None
    before, onset = r.before[winner].copy(), int(r.onset[winner])
    m.checkpoint = checkpoint(m, onset)
    has_explained = verdict.has_explained(config, m, winner) and _has_same_sign(r, winner)
    x, P = (r.x_fit, r.P_fit) if has_explained else (r.x, r.P)
    m.x[:], m.P[:], m.growing = x[winner], P[winner], int(r.target[winner])
    _loosen(config, m, winner, before)
    stuck_check.credit(m, float(r.evidence[winner]))
    if is_own:
        alarms = _learn(m, suspicion, winner)
    else:
        if winner in PUMPS and not verdict.is_known(config, m, 1 - winner):
            m.unproven = (1 - winner, 0.0)
        alarms = [declaration.declare(config, m, j, before, onset, suspicion) for j in jumps_of(winner)]
        unknown.note(m, alarms)
        alarms += declaration.close(m, suspicion, alarms)
    declaration.end_growth(m)
    m.restart_bank()
    if has_explained:
        _refilter(config, m, int(r.fit[winner]))
    number, detected_s = (alarms[0].number, alarms[0].detected_s) if alarms else (None, m.t_s)
    told = Suspicion(number=number, detected_s=detected_s)
    m.rival = drift_review.rival_of(config, m, winner, order, told, has_moved=has_moved)
    m.hidden = hidden_level.begin(config, m, winner)
    m.verdicts_s = (*m.verdicts_s, m.t_s)[-config.tuning.verdicts_max :]
    return alarms


def _learn(m: Memory, suspicion: Suspicion, winner: int) -> list[Alarm]:
    """What the rig has always been becomes part of the filter; the end of the alarm, if one was raised."""
    for j in jumps_of(winner):
        if j in PUMPS:
            first_day.fold_gain(m, j)
    if suspicion.number is None or suspicion.detected_s == m.t_s:
        return []
    return [declaration.withdrawn(m, suspicion.number, ())]


def _has_same_sign(r: Replays, number: int) -> bool:
    """Whether the sizes had the sign that they have now when the replay last explained the readings."""
    states = [JUMPS[j].state for j in jumps_of(number)]
    return bool(np.all((r.x_fit[number] - r.before[number])[states] * (r.x[number] - r.before[number])[states] > 0.0))


def _refilter(config: DetectorConfig, m: Memory, start: int) -> None:
    """Filter again from a step on, without the sensors that are no longer used."""
    for sensor in m.lost:
        rollback.set_reading_variance(m, start, sensor, None)
    rollback.refilter(config, m, start, m.now)


def checkpoint(m: Memory, onset: int) -> Checkpoint:
    """The filter as it was before a fault began, with a margin of some steps."""
    b = m.bank
    slots = onsets.slots_in_use(m)
    early = [s for s in slots if b.onset[s] <= onset - CHECKPOINT_STEPS]
    slot = max(early, key=lambda s: int(b.onset[s])) if early else min(slots, key=lambda s: int(b.onset[s]))
    return Checkpoint(
        onset=onset,
        step=int(b.onset[slot]),
        x=m.history.x[slot].copy(),
        P=m.history.P[slot].copy(),
        declared=dict(m.declared),
    )


def _loosen(config: DetectorConfig, m: Memory, winner: int, before: Array) -> None:
    """Raise the variance of levels and size: the onset may be off by part of a step, and the readings correct that.

    Growth does not begin abruptly: its size is known as well as the replay says.
    """
    tuning = config.tuning
    if m.growing != NO_GROWTH and all(growth.covers(m.growing, j) for j in jumps_of(winner)):
        return
    for j in jumps_of(winner):
        jump = JUMPS[j]
        size = float(m.x[jump.state] - before[jump.state])
        m.P[jump.state, jump.state] += (tuning.size_doubt * abs(size) + tuning.prior_doubt * jump.prior) ** 2
        m.P[range(4), range(4)] += (size * m.result.A[:4, jump.state]) ** 2
