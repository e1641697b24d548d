"""Which hypothesis explains the readings, once every one has been replayed from its onset; or that none does yet.

Why this method: `docs/decisions/0009-diagnosis-by-likelihood-ratios.md`.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from hil.core.diagnosis.glr import ambiguity, drifting, onsets, own_verdict, pairs, unknown
from hil.core.diagnosis.glr.ambiguity import NO_EVIDENCE
from hil.core.diagnosis.glr.declaration import IDLE_V
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import VOLTAGE
from hil.core.diagnosis.glr.hypotheses import ALL, BOTH, JUMPS, PUMPS, VARIANTS, H, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Suspicion
from hil.core.diagnosis.glr.model import BIAS, DRIFT, GAIN, Array
from hil.core.diagnosis.glr.refilter import Replays

RIVALS = 2
"""The number of the leader's rivals whose onsets are tried before a verdict."""

SHARPEN_WAIT = 20
"""Other onsets are tried again after this share of the time since the onset: they take time of the processor."""

MAX_BACK_STEPS = 100
"""Filtering more steps than this again would take longer than a control step may."""

MIN_GAIN, SURE_STDS = -0.1, 3.0
"""No pump runs backwards; the estimated gain of one at rest may be a little below zero, at first with a large error."""

VARIANT_MARGIN = 1.0
"""By how much another variant of a hypothesis must explain the readings better to take its place."""

QUIET_S, OWN_S = 5.0, 0.5
"""What may be the rig's own is learned after the first time, unless a fault explains the readings better by then; after
the second, if it leads all else."""


class Lead(NamedTuple):
    """How far the replays have come.

    evidence : (ALL,) log-likelihood ratios, NO_EVIDENCE for the impossible. order : the hypotheses' numbers, the
    likeliest first. winner : the one that leads by the margin. is_seen : whether enough steps of the likeliest were
    replayed. is_late : whether the time for isolation is over. open_s : time since the alarm.
    """

    evidence: Array
    order: list[int]
    winner: int | None
    is_seen: bool
    is_late: bool
    open_s: float

    @property
    def is_possible(self) -> bool:
        """Whether the likeliest hypothesis has a possible size."""
        return bool(self.evidence[self.order[0]] > NO_EVIDENCE)


def leading(config: DetectorConfig, m: Memory, suspicion: Suspicion, evidence: Array, order: list[int]) -> Lead:
    """What leads by the margin, with the likeliest hypotheses at the onsets that suit them best.

    While a sensor may still be found stuck nothing does: then none of the hypotheses is true.
    """
    tuning = config.tuning
    state = JUMPS[jumps_of(order[0])[0]].state
    is_bias, is_drift = BIAS <= state < DRIFT, state >= DRIFT
    steps = m.now - int(m.replays.onset[order[0]])
    is_seen = steps >= (tuning.min_drift_steps if is_drift else tuning.min_steps)
    is_clear = is_seen or (is_bias and evidence[order[0]] - evidence[order[1]] >= tuning.jump_margin)
    winner = None
    if is_clear and not m.is_doubtful and m.now >= suspicion.sharpen_at:
        winner = _leader(config, m, evidence, order)
    if winner is not None:
        suspicion.sharpen_at = m.now + max(1, (m.now - int(m.replays.onset[winner])) // SHARPEN_WAIT)
        rivals = [n for n in order if n != winner and evidence[n] >= evidence[winner] - tuning.drop_margin]
        for number in dict.fromkeys((winner, *rivals[:RIVALS], *onsets.alike(winner))):
            onsets.sharpen(config, m, number)
        evidence, order = evidence_of(m)
        winner = _leader(config, m, evidence, order)
    open_s = m.t_s - suspicion.detected_s
    return Lead(evidence, order, winner, is_seen, open_s >= tuning.resolve_within_s, open_s)


def choose(config: DetectorConfig, m: Memory, suspicion: Suspicion, lead: Lead) -> int | None:
    """The hypothesis to settle on: what leads, what is taken for lack of time, or what may be the rig's own."""
    first, evidence, winner = lead.order[0], lead.evidence, lead.winner
    is_overtaken = lead.is_possible and _is_overtaken(config, m, first)
    if winner is None and is_overtaken:
        winner = ambiguity.safer(config, m, first, evidence)
    if winner is None and lead.is_late and lead.is_possible and first <= BOTH:
        winner = first  # two other faults at once are not declared for lack of time
    if winner is not None and not is_overtaken and _is_ambiguous(config, m, winner, is_late=lead.is_late):
        winner = None
    if not m.is_doubtful:
        winner = _or_own(config, m, suspicion, lead, winner)
    if winner is not None and not is_overtaken and drifting.may_be_drift(config, m, winner):
        return None
    return winner


def _or_own(config: DetectorConfig, m: Memory, suspicion: Suspicion, lead: Lead, winner: int | None) -> int | None:
    """What may be the rig's own in place of the winner, or where there is none; else the winner."""
    if winner is None and suspicion.is_quiet and lead.is_seen and lead.open_s >= OWN_S:
        winner = own_verdict.leads_as_own(config, m, lead.evidence)
    if winner is None and lead.open_s < QUIET_S:
        return None
    small = ambiguity.leading_small(m, lead.evidence[lead.order[0]])
    own = own_instead(config, m, lead.order[0] if small is None else small, lead.open_s)
    return winner if own is None else own


def _is_ambiguous(config: DetectorConfig, m: Memory, winner: int, *, is_late: bool) -> bool:
    if is_late and ambiguity.is_led_by_small(m, winner):
        return True
    return ambiguity.is_drift_or_level(config, m, winner, is_late=is_late)


def own_instead(config: DetectorConfig, m: Memory, leader: int, open_s: float) -> int | None:
    """What may be the rig's own, see `own_verdict.own_instead`; after QUIET_S not what may be a drift as well.

    An outlet that is learned while the sensor of its tank drifts hides the drift.
    """
    own = own_verdict.own_instead(config, m, leader)
    if own is not None and drifting.may_be_drift(config, m, own):
        return None
    if own is not None and open_s >= QUIET_S and ambiguity.is_drift_or_level(config, m, own, is_late=True):
        return None
    return own


def may_learn(config: DetectorConfig, m: Memory, small: int) -> bool:
    """Whether what is too small to be declared may be learned as the rig's own, when the time for a name is over."""
    if unknown.fits_badly(m, small, at_fit=False) or drifting.may_be_drift(config, m, small):
        return False
    if ambiguity.is_drift_or_level(config, m, small, is_late=True):
        return False
    return own_verdict.is_own(config, m, small)


def evidence_of(m: Memory) -> tuple[Array, list[int]]:
    """(ALL,) log-likelihood ratios, NO_EVIDENCE for the impossible; the hypotheses' numbers, the likeliest first."""
    r = m.replays
    for row, variant in enumerate(VARIANTS, ALL):
        if not r.dropped[row] and r.evidence[row] > r.evidence[variant.number] + VARIANT_MARGIN:
            r.swap(variant.number, row)
    ratios = enumerate(r.evidence[:ALL])
    evidence = np.array([value if _is_possible(m, number) else NO_EVIDENCE for number, value in ratios])
    return evidence, [int(number) for number in np.argsort(-evidence)]


def _is_possible(m: Memory, number: int) -> bool:
    """Whether the sizes found are large enough and of a sign that the fault can have; two pumps must have one sign."""
    rise, fall = m.min_jumps()
    r = m.replays
    sizes = [(j, r.x[number, JUMPS[j].state] - r.before[number, JUMPS[j].state]) for j in jumps_of(number)]
    if any(_runs_backwards(r, number, GAIN + pump) for pump in PUMPS):
        return False
    for j, size in sizes:
        least, most = (rise[j], JUMPS[j].rise[1]) if size > 0.0 else (fall[j], JUMPS[j].fall[1])
        if not least <= abs(size) <= most:
            return False
    return len({size > 0.0 for _, size in sizes}) == 1


def _runs_backwards(r: Replays, number: int, state: int) -> bool:
    std = sqrt(max(r.P[number, state, state], 0.0))
    return bool(r.x[number, state] + SURE_STDS * std < MIN_GAIN)


def _leader(config: DetectorConfig, m: Memory, evidence: Array, order: list[int]) -> int | None:
    """The hypothesis that leads by enough, or None."""
    if order[0] > BOTH:
        return pairs.leader(config, m, evidence, order)
    first, second = [number for number in order if number < H][:2]
    margin = config.tuning.margin * unknown.dispersion(m, first)
    if evidence[first] - ambiguity.best_small(m) < margin:
        return None
    pair = pairs.best_without(evidence, first)
    if first not in PUMPS:
        if evidence[BOTH] - evidence[first] >= margin:
            return BOTH if evidence[BOTH] - pair >= margin else None
        return first if evidence[first] - max(evidence[second], evidence[BOTH], pair) >= margin else None
    if evidence[BOTH] - evidence[first] >= config.tuning.both_lead:
        return BOTH if evidence[BOTH] - max(evidence[first], pair) >= margin else None
    other = PUMPS[1 - first]
    is_alone = is_known(config, m, other) or float(m.entry[VOLTAGE + other]) < IDLE_V
    return first if is_alone and evidence[first] - max(evidence[second], pair) >= margin else None


def _is_overtaken(config: DetectorConfig, m: Memory, number: int) -> bool:
    """Whether a hypothesis explained the readings until something else happened; and nothing too small leads it."""
    if m.is_doubtful or ambiguity.is_led_by_small(m, number):
        return False
    return has_explained(config, m, number) and float(m.replays.misfit[number]) > config.tuning.overtaken


def has_explained(config: DetectorConfig, m: Memory, number: int) -> bool:
    """Whether a hypothesis explained the readings for long enough, until not long ago."""
    fit = int(m.replays.fit[number])
    return fit - m.replays.onset[number] >= config.tuning.min_fit_steps and m.now - fit <= MAX_BACK_STEPS


def is_known(config: DetectorConfig, m: Memory, pump: int) -> bool:
    """Whether a loss of this pump, beside the other's, would be known."""
    state = JUMPS[pump].state
    return sqrt(max(m.replays.P[BOTH, state, state], 0.0)) < config.tuning.second_pump_std
