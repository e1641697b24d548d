"""From an alarm to a verdict: replay every hypothesis from its onset until one of them leads.

Why this method: `docs/decisions/0009-diagnosis-by-likelihood-ratios.md`.
"""

from __future__ import annotations

import numpy as np

from hil.core.diagnosis.glr import (
    ambiguity,
    declaration,
    drifting,
    kernels,
    onsets,
    own_verdict,
    pairs,
    settling,
    unknown,
    verdict,
)
from hil.core.diagnosis.glr.ambiguity import NO_EVIDENCE
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.hypotheses import ALL, BOTH, PLAIN, ROWS, VARIANTS, H, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Suspicion
from hil.core.diagnosis.glr.model import Array
from hil.core.types import Alarm

OPEN_MARGIN = 12.0
"""Hypotheses that lag by no more are still candidates when the time for isolation is over, see `ambiguity`."""

FIRST_S = 2.0
"""An alarm is kept back for so long while anything that may be the rig's own is as likely as its leader."""

START_QUIET_S = 1.0
"""In a start phase, which an open alarm ends, no alarm is kept back for longer."""

WEAK, HELD_S = 2.0, 10.0
"""On a rig that is not as its file says a question with less than so many times the evidence for an alarm is kept back
for so long: most of those that were asked for nothing had died away by then. A name that is found meanwhile is told.
With less than raises an alarm it is neither asked nor given a name later."""

FAR_BEHIND = 0.25
"""A hypothesis with less than this share of the leader's ratio has no onset worth its own replay."""


def suspect(config: DetectorConfig, m: Memory) -> None:
    """Raise an alarm: put one filter a hypothesis at the onset that the bank finds likeliest for it.

    Hypotheses with much smaller ratios begin at the leader's onset: theirs may be long ago, and long replays cost time.
    If the leader may be a fault that is known already, no alarm is raised before the verdict; if it may be the rig's
    own, or is weak on a rig that is not as its file says, not for a short time.
    """
    leader = int(np.argmax(m.best.ratio))
    is_new = not any(j in m.declared for j in jumps_of(leader))
    is_quiet = own_verdict.may_be_own(config, m) or (is_new and _is_weak(config, m, m.max_ratio))
    m.suspicion = Suspicion(number=None, detected_s=m.t_s, is_quiet=is_quiet)
    drifting.watch(m, m.suspicion, int(m.bank.onset[m.best.slot[leader]]))
    if not is_quiet and is_new:
        m.alarms += 1
        m.suspicion.number = m.alarms
    slots = []
    for number in range(H + 1):
        own = m.best.slot[number] >= 0 and m.best.ratio[number] >= FAR_BEHIND * m.max_ratio
        slots.append(int(m.best.slot[number if own else leader]))
        onsets.begin(m, m.replays, number, number, PLAIN, slots[number])
    pairs.begin(config, m)
    for place, variant in enumerate(VARIANTS):
        slot = slots[variant.number] if variant.rate == 0.0 else onsets.earlier(m, slots[variant.number], slots[leader])
        slot = slot if variant.onset_of is None else slots[variant.onset_of]
        onsets.begin(m, m.replays, ALL + place, variant.number, place, slot)


def isolate(config: DetectorConfig, m: Memory, suspicion: Suspicion) -> list[Alarm]:
    """One step towards a verdict; the alarms that it has come to."""
    r = m.replays
    if kernels.catch_up(config.model, m.history, r, ROWS, m.now, config.tuning.replay_budget):
        return _candidates(m, suspicion, _likely_by_bank(config, m))
    evidence, order = verdict.evidence_of(m)
    suspicion.leader = order[0]
    drifting.watch(m, suspicion, int(r.onset[order[0]]))
    _speak(config, m, suspicion)
    lead = verdict.leading(config, m, suspicion, evidence, order)
    if lead.is_late and lead.winner is None and _has_died_away(config, m):
        m.suspicion = None
        m.restart_bank()
        return [] if suspicion.number is None else [declaration.withdrawn(m, suspicion.number, ())]
    winner = verdict.choose(config, m, suspicion, lead)
    if winner is not None and _may_die_away(config, m, suspicion, winner):
        winner = None
    likeliest = lead.order[0] if lead.is_possible else int(np.argmax(r.evidence[:ALL]))
    best = likeliest if winner is None else winner
    if not m.is_doubtful and unknown.fits_badly(m, best, at_fit=verdict.has_explained(config, m, best)):
        winner = None
        if lead.open_s >= unknown.WAIT_S:
            return _declare_unknown(config, m, suspicion, best, lead)
    if winner is not None and unknown.contradicts(m, winner):
        return _declare_unknown(config, m, suspicion, winner, lead)
    if winner is None and lead.is_late:
        small = ambiguity.leading_small(m, lead.evidence[lead.order[0]])
        winner = small if small is not None and verdict.may_learn(config, m, small) else None
    if winner is not None:
        return settling.settle(config, m, suspicion, winner, lead.order)
    _drop(config, m, lead.evidence)
    if lead.is_late:
        return _still_open(m, suspicion, _open_candidates(m, lead.evidence))
    near = float(lead.evidence[lead.order[0]]) - config.tuning.margin
    likely = [number for number in lead.order if lead.evidence[number] >= near]
    return _candidates(m, suspicion, likely + _likely_by_bank(config, m))


def _declare_unknown(
    config: DetectorConfig, m: Memory, suspicion: Suspicion, number: int, lead: verdict.Lead
) -> list[Alarm]:
    before = unknown.first_checkpoint(m) or settling.checkpoint(m, int(m.replays.onset[number]))
    return unknown.declare(config, m, suspicion, number, lead.order, before)


def _has_died_away(config: DetectorConfig, m: Memory) -> bool:
    """Whether nothing explains the readings any more by as much as raises an alarm: it was no fault.

    A leak of 3 % led by 10.8 against 10.6 when the time for a name was over, and ended the learning of a healthy rig.
    """
    return not m.is_doubtful and float(m.replays.evidence[:ALL].max()) < config.tuning.detect


def _may_die_away(config: DetectorConfig, m: Memory, suspicion: Suspicion, winner: int) -> bool:
    """Whether this is no fault yet: on a rig that is not as its file says, unheard of, and with too little evidence.

    It has less than raises an alarm. The alarm came with 30; a bias of 7 mV, known to 26 mV, had a name with 12.8.
    """
    if not (m.is_wide and suspicion.is_quiet) or own_verdict.is_own(config, m, winner):
        return False
    return _has_died_away(config, m)


def _is_weak(config: DetectorConfig, m: Memory, evidence: float) -> bool:
    return m.is_wide and evidence < WEAK * config.tuning.detect


def _speak(config: DetectorConfig, m: Memory, suspicion: Suspicion) -> None:
    """Raise the alarm of a quiet suspicion when nothing that may be the rig's own is near, and it is strong or old.

    What is near a sensor's fault counts for the first seconds only.
    """
    if not suspicion.is_quiet or suspicion.leader is None:
        return
    open_s, is_start = m.t_s - suspicion.detected_s, m.t_s < 0.0
    if open_s < FIRST_S:
        may_be_own = own_verdict.own_near(config, m, suspicion.leader) is not None
    else:
        may_be_own = verdict.own_instead(config, m, suspicion.leader, open_s) is not None
    is_fresh_or_over = open_s < HELD_S or _has_died_away(config, m)
    is_held = is_fresh_or_over and _is_weak(config, m, float(m.replays.evidence[:ALL].max()))
    if (may_be_own or is_held) and not (is_start and open_s >= START_QUIET_S):
        return
    m.alarms += 1
    suspicion.quiet_s = m.t_s - suspicion.detected_s
    suspicion.number, suspicion.detected_s, suspicion.is_quiet = m.alarms, m.t_s, False


def _still_open(m: Memory, suspicion: Suspicion, likely: list[int]) -> list[Alarm]:
    """Report once what cannot be told apart, when the time for it is over: the search goes on."""
    if suspicion.is_told or suspicion.number is None:
        return []
    suspicion.is_told = True
    return [declaration.unresolved(m, suspicion, likely)]


def _open_candidates(m: Memory, evidence: Array) -> list[int]:
    """The hypotheses that may still be true, the likeliest first; also those that are too small so far."""
    found = {number: float(value) for number, value in enumerate(evidence) if value > NO_EVIDENCE}
    found |= ambiguity.too_small(m)
    best = max(found.values(), default=0.0)
    likely = (number for number, value in found.items() if value >= best - OPEN_MARGIN)
    return sorted(likely, key=lambda number: -found[number])


def _candidates(m: Memory, suspicion: Suspicion, likely: list[int]) -> list[Alarm]:
    """The unresolved alarm, once."""
    is_new = suspicion.number is not None and suspicion.detected_s == m.t_s
    return [declaration.unresolved(m, suspicion, likely)] if is_new else []


def _drop(config: DetectorConfig, m: Memory, evidence: Array) -> None:
    """Drop hypotheses that are far behind; both pumps together is kept, it is needed to judge a single pump.

    One whose size is impossible so far is kept as long as it explains the readings.
    """
    r = m.replays
    behind = r.evidence < evidence.max() - config.tuning.drop_margin
    r.dropped[behind & (m.now - r.onset > config.tuning.min_steps)] = 1
    r.dropped[BOTH] = 0


def _likely_by_bank(config: DetectorConfig, m: Memory) -> list[int]:
    return [j for j in range(H + 1) if m.best.ratio[j] > 0.0 and m.best.ratio[j] >= m.max_ratio - config.tuning.margin]
