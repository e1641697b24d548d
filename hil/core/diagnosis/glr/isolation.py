"""From an alarm to a verdict: replay every hypothesis from its onset until one of them leads.

Why this method: `docs/decisions/0009-diagnosis-by-likelihood-ratios.md`.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from hil.core.diagnosis.glr import (
    ambiguity,
    declaration,
    drift_review,
    drifting,
    first_day,
    growth,
    hidden_level,
    kernels,
    onsets,
    own_verdict,
    pairs,
    rollback,
    stuck_check,
    unknown,
)
from hil.core.diagnosis.glr.ambiguity import NO_EVIDENCE
from hil.core.diagnosis.glr.declaration import IDLE_V
from hil.core.diagnosis.glr.filter import VOLTAGE
from hil.core.diagnosis.glr.growth import NO_GROWTH
from hil.core.diagnosis.glr.hypotheses import ALL, BOTH, JUMPS, PLAIN, PUMPS, ROWS, VARIANTS, H, jumps_of
from hil.core.diagnosis.glr.memory import Checkpoint, DetectorConfig, Memory, Suspicion
from hil.core.diagnosis.glr.model import BIAS, DRIFT, GAIN, Array
from hil.core.diagnosis.glr.refilter import Replays
from hil.core.types import Alarm

RIVALS = 2
"""The number of the leader's rivals whose onsets are tried before a verdict."""

SHARPEN_WAIT = 20
"""Other onsets are tried again after this share of the time since the onset: they take time of the processor."""

OPEN_MARGIN = 12.0
"""Hypotheses that lag by no more are still candidates when the time for isolation is over, see `ambiguity`."""

CHECKPOINT_STEPS = 10
"""The checkpoint is at least this many steps before the onset of what is declared."""

MAX_BACK_STEPS = 100
"""Filtering more steps than this again would take longer than a control step may."""

MIN_GAIN, SURE_STDS = -0.1, 3.0
"""No pump runs backwards; the estimated gain of one at rest may be a little below zero, at first with a large error."""

VARIANT_MARGIN = 1.0
"""By how much another variant of a hypothesis must explain the readings better to take its place."""

QUIET_S, FIRST_S, OWN_S = 5.0, 2.0, 0.5
"""What may be the rig's own is learned after the first time, unless a fault explains the readings better by then; after
the last, if it leads all else."""

START_QUIET_S = 1.0
"""In a start phase, which an open alarm ends, no alarm is kept back for longer."""

FAR_BEHIND = 0.25
"""A hypothesis with less than this share of the leader's ratio has no onset worth its own replay."""


def suspect(config: DetectorConfig, m: Memory) -> None:
    """Raise an alarm: put one filter a hypothesis at the onset that the bank finds likeliest for it.

    Hypotheses with much smaller ratios begin at the leader's onset: theirs may be long ago, and long replays cost time.
    If the leader may be a fault that is known already, no alarm is raised before the verdict; if it may be the rig's
    own, not for a short time.
    """
    leader = int(np.argmax(m.best.ratio))
    m.suspicion = Suspicion(number=None, detected_s=m.t_s, is_quiet=own_verdict.may_be_own(config, m))
    drifting.watch(m, m.suspicion, int(m.bank.onset[m.best.slot[leader]]))
    if not m.suspicion.is_quiet and not any(j in m.declared for j in jumps_of(leader)):
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
    tuning, r = config.tuning, m.replays
    if kernels.catch_up(config.model, m.history, r, ROWS, m.now, tuning.replay_budget):
        return _candidates(m, suspicion, _likely_by_bank(config, m))
    evidence, order = _evidence(m)
    suspicion.leader = order[0]
    drifting.watch(m, suspicion, int(r.onset[order[0]]))
    _speak(config, m, suspicion)
    state = JUMPS[jumps_of(order[0])[0]].state
    is_bias, is_drift = BIAS <= state < DRIFT, state >= DRIFT
    is_seen = m.now - int(r.onset[order[0]]) >= (tuning.min_drift_steps if is_drift else tuning.min_steps)
    winner = None
    if m.is_doubtful:
        pass  # after some more readings a sensor may be found stuck: then none of these is true
    elif is_seen or (is_bias and evidence[order[0]] - evidence[order[1]] >= tuning.jump_margin):
        winner = _leader(config, m, evidence, order)
    if winner is not None and m.now < suspicion.sharpen_at:
        winner = None
    if winner is not None:
        suspicion.sharpen_at = m.now + max(1, (m.now - int(r.onset[winner])) // SHARPEN_WAIT)
        rivals = [n for n in order if n != winner and evidence[n] >= evidence[winner] - tuning.drop_margin]
        for number in dict.fromkeys((winner, *rivals[:RIVALS], *onsets.alike(winner))):
            onsets.sharpen(config, m, number)
        evidence, order = _evidence(m)
        winner = _leader(config, m, evidence, order)
    is_late = m.t_s - suspicion.detected_s >= tuning.resolve_within_s
    if is_late and winner is None and _has_died_away(config, m):
        m.suspicion = None
        m.restart_bank()
        return [] if suspicion.number is None else [declaration.withdrawn(m, suspicion.number, ())]
    is_possible = evidence[order[0]] > NO_EVIDENCE
    is_overtaken = is_possible and _is_overtaken(config, m, order[0]) and not m.is_doubtful
    is_overtaken = is_overtaken and not ambiguity.is_led_by_small(m, order[0])  # it explains what overtook the other
    is_single_late = is_late and order[0] <= BOTH  # two other faults at once are not declared for lack of time
    if winner is None and is_possible and (is_single_late or is_overtaken):
        winner = ambiguity.safer(config, m, order[0], evidence) if is_overtaken else order[0]
    if is_late and winner is not None and not is_overtaken and ambiguity.is_led_by_small(m, winner):
        winner = None
    if winner is not None and not is_overtaken and ambiguity.is_drift_or_level(config, m, winner, is_late=is_late):
        winner = None
    open_s = m.t_s - suspicion.detected_s
    if winner is None and suspicion.is_quiet and is_seen and not m.is_doubtful and open_s >= OWN_S:
        winner = own_verdict.leads_as_own(config, m, evidence)
    if not m.is_doubtful and (winner is not None or open_s >= QUIET_S):
        small = ambiguity.leading_small(m, evidence[order[0]])
        own = _own_instead(config, m, order[0] if small is None else small, open_s)
        winner = winner if own is None else own
    if winner is not None and not is_overtaken and drifting.may_be_drift(config, m, winner):
        winner = None
    likeliest = order[0] if is_possible else int(np.argmax(r.evidence[:ALL]))
    best = likeliest if winner is None else winner
    if not m.is_doubtful and unknown.fits_badly(m, best, at_fit=_has_explained(config, m, best)):
        winner = None
        if m.t_s - suspicion.detected_s >= unknown.WAIT_S:
            before = unknown.first_checkpoint(m) or _checkpoint(m, int(r.onset[best]))
            return unknown.declare(config, m, suspicion, best, order, before)
    if winner is not None and unknown.contradicts(m, winner):
        before = unknown.first_checkpoint(m) or _checkpoint(m, int(r.onset[winner]))
        return unknown.declare(config, m, suspicion, winner, order, before)
    if winner is not None:
        return _settle(config, m, suspicion, winner, order)
    small = ambiguity.leading_small(m, evidence[order[0]]) if is_late else None
    if small is not None and _may_learn(config, m, small):
        return _settle(config, m, suspicion, small, order)
    _drop(config, m, evidence)
    if is_late:
        return _still_open(m, suspicion, _open_candidates(m, evidence))
    likely = [number for number in order if evidence[number] >= evidence[order[0]] - tuning.margin]
    return _candidates(m, suspicion, likely + _likely_by_bank(config, m))


def _has_died_away(config: DetectorConfig, m: Memory) -> bool:
    """Whether nothing explains the readings any more by as much as raises an alarm: it was no fault.

    A leak of 3 % led by 10.8 against 10.6 when the time for a name was over, and ended the learning of a healthy rig.
    """
    return not m.is_doubtful and float(m.replays.evidence[:ALL].max()) < config.tuning.detect


def _speak(config: DetectorConfig, m: Memory, suspicion: Suspicion) -> None:
    """Raise the alarm of a quiet suspicion when nothing that may be the rig's own is near the likeliest fault.

    What is near a sensor's fault counts for the first seconds only.
    """
    if not suspicion.is_quiet or suspicion.leader is None:
        return
    open_s, is_start = m.t_s - suspicion.detected_s, m.t_s < 0.0
    if open_s < FIRST_S:
        may_be_own = own_verdict.own_near(config, m, suspicion.leader) is not None
    else:
        may_be_own = _own_instead(config, m, suspicion.leader, open_s) is not None
    if may_be_own and not (is_start and open_s >= START_QUIET_S):
        return
    m.alarms += 1
    suspicion.quiet_s = m.t_s - suspicion.detected_s
    suspicion.number, suspicion.detected_s, suspicion.is_quiet = m.alarms, m.t_s, False


def _own_instead(config: DetectorConfig, m: Memory, leader: int, open_s: float) -> int | None:
    """What may be the rig's own, see `own_verdict.own_instead`; after QUIET_S not what may be a drift as well.

    An outlet that is learned while the sensor of its tank drifts hides the drift.
    """
    own = own_verdict.own_instead(config, m, leader)
    if own is not None and drifting.may_be_drift(config, m, own):
        return None
    if own is not None and open_s >= QUIET_S and ambiguity.is_drift_or_level(config, m, own, is_late=True):
        return None
    return own


def _may_learn(config: DetectorConfig, m: Memory, small: int) -> bool:
    """Whether what is too small to be declared may be learned as the rig's own, when the time for a name is over."""
    if unknown.fits_badly(m, small, at_fit=False) or drifting.may_be_drift(config, m, small):
        return False
    if ambiguity.is_drift_or_level(config, m, small, is_late=True):
        return False
    return own_verdict.is_own(config, m, small)


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
    is_alone = _is_known(config, m, other) or float(m.entry[VOLTAGE + other]) < IDLE_V
    return first if is_alone and evidence[first] - max(evidence[second], pair) >= margin else None


def _is_overtaken(config: DetectorConfig, m: Memory, number: int) -> bool:
    """Whether a hypothesis explained the readings until something else happened."""
    return _has_explained(config, m, number) and float(m.replays.misfit[number]) > config.tuning.overtaken


def _has_explained(config: DetectorConfig, m: Memory, number: int) -> bool:
    fit = int(m.replays.fit[number])
    return fit - m.replays.onset[number] >= config.tuning.min_fit_steps and m.now - fit <= MAX_BACK_STEPS


def _has_same_sign(r: Replays, number: int) -> bool:
    """Whether the sizes had the sign that they have now when the replay last explained the readings."""
    states = [JUMPS[j].state for j in jumps_of(number)]
    return bool(np.all((r.x_fit[number] - r.before[number])[states] * (r.x[number] - r.before[number])[states] > 0.0))


def _is_known(config: DetectorConfig, m: Memory, pump: int) -> bool:
    """Whether a loss of this pump, beside the other's, would be known."""
    state = JUMPS[pump].state
    return sqrt(max(m.replays.P[BOTH, state, state], 0.0)) < config.tuning.second_pump_std


def _settle(config: DetectorConfig, m: Memory, suspicion: Suspicion, winner: int, order: list[int]) -> list[Alarm]:
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
    m.checkpoint = _checkpoint(m, onset)
    has_explained = _has_explained(config, m, winner) and _has_same_sign(r, winner)
    x, P = (r.x_fit, r.P_fit) if has_explained else (r.x, r.P)
    m.x[:], m.P[:], m.growing = x[winner], P[winner], int(r.target[winner])
    _loosen(config, m, winner, before)
    stuck_check.credit(m, float(r.evidence[winner]))
    if is_own:
        alarms = _learn(m, suspicion, winner)
    else:
        if winner in PUMPS and not _is_known(config, m, 1 - winner):
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


def _refilter(config: DetectorConfig, m: Memory, start: int) -> None:
    """Filter again from a step on, without the sensors that are no longer used."""
    for sensor in m.lost:
        rollback.set_reading_variance(m, start, sensor, None)
    rollback.refilter(config, m, start, m.now)


def _checkpoint(m: Memory, onset: int) -> Checkpoint:
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


def _evidence(m: Memory) -> tuple[Array, list[int]]:
    """(ALL,) log-likelihood ratios, NO_EVIDENCE for the impossible; the hypotheses' numbers, the likeliest first."""
    r = m.replays
    for row, variant in enumerate(VARIANTS, ALL):
        if not r.dropped[row] and r.evidence[row] > r.evidence[variant.number] + VARIANT_MARGIN:
            r.swap(variant.number, row)
    ratios = enumerate(r.evidence[:ALL])
    evidence = np.array([value if _is_possible(m, number) else NO_EVIDENCE for number, value in ratios])
    return evidence, [int(number) for number in np.argsort(-evidence)]


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
