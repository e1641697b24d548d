"""From an alarm to a verdict: replay every hypothesis from its onset until one of them leads."""

from __future__ import annotations

from math import sqrt

import numpy as np

from hil.core.glr import bank, replay, verdict
from hil.core.glr.hypotheses import BOTH, JUMPS, PUMPS, H
from hil.core.glr.memory import Memory, Setup, Suspicion
from hil.core.glr.process import BIAS, DRIFT, Array
from hil.core.types import Alarm

NO_EVIDENCE = -1e300
"""Of what can't be; still a number, so that differences are."""

FAR_BEHIND = 0.5
"""A hypothesis with less than this share of the leader's ratio has no onset worth its own replay."""


def jumps_of(number: int) -> tuple[int, ...]:
    """The places in JUMPS that a hypothesis is about."""
    return PUMPS if number == BOTH else (number,)


def suspect(m: Memory) -> None:
    """Raise an alarm: put one filter a hypothesis at the onset that the bank finds likeliest for it.

    Hypotheses that lag far behind begin at the leader's onset: theirs may be long ago, and long replays cost time.
    """
    m.alarms += 1
    m.suspicion = Suspicion(m.alarms, m.t_s)
    leader = int(np.argmax(m.ratio))
    for number in range(H + 1):
        own = m.slot[number] >= 0 and m.ratio[number] >= FAR_BEHIND * m.statistic
        slot = int(m.slot[number if own else leader])
        _begin(m, number, number, slot)


def isolate(setup: Setup, m: Memory, suspicion: Suspicion) -> list[Alarm]:
    """One step towards a verdict; the alarms that it has come to."""
    tuning, r = setup.tuning, m.replays
    is_new = suspicion.detected_s == m.t_s
    if _catch_up(setup, m, H + 1, tuning.replay_budget):
        return [verdict.unresolved(m, suspicion, _likely_by_bank(setup, m))] if is_new else []
    evidence = np.array([value if _is_possible(m, number) else NO_EVIDENCE for number, value in enumerate(r.evidence)])
    order = [int(number) for number in np.argsort(-evidence)]
    is_bias = order[0] != BOTH and BIAS <= JUMPS[order[0]].state < DRIFT
    is_seen = m.now - int(r.onset[order[0]]) >= tuning.least_steps
    winner = None
    if is_seen or (is_bias and evidence[order[0]] - evidence[order[1]] >= tuning.jump_margin):
        winner = _leader(setup, m, evidence, order)
    if winner is None and m.t_s - suspicion.detected_s >= tuning.resolve_within_s:
        winner = order[0]
    if winner is not None:
        return _settle(setup, m, suspicion, winner)
    if not is_new:
        return []
    likely = [number for number in order if evidence[number] >= evidence[order[0]] - tuning.margin]
    return [verdict.unresolved(m, suspicion, likely + _likely_by_bank(setup, m))]


def _begin(m: Memory, row: int, number: int, slot: int) -> None:
    """Begin a replay of hypothesis `number`, its onset that of a slot of the bank."""
    reach = np.zeros(4)
    for j in jumps_of(number):
        energy = m.bank.energy[j, slot]
        size = min(max(m.bank.match[j, slot] / energy, -1.0), 1.0) if energy > 0.0 else 0.0
        reach += size * m.A[:4, JUMPS[j].state]
    m.replays.begin(row, number, m.history, slot, int(m.bank.onset[slot]), reach)


def _catch_up(setup: Setup, m: Memory, rows: int, budget: int) -> int:
    r = m.replays
    return replay.catch_up(
        setup.c, setup.walk, m.history.entries, m.history.none, r.x, r.P, r.evidence, r.seen, r.onset, m.now,
        budget, r.bias, rows,
    )  # fmt: skip


def _likely_by_bank(setup: Setup, m: Memory) -> list[int]:
    return [j for j in range(H + 1) if m.ratio[j] > 0.0 and m.ratio[j] >= m.statistic - setup.tuning.margin]


def _is_possible(m: Memory, number: int) -> bool:
    """Whether the sizes found are large enough and of a sign that the fault can have; pumps go together."""
    rise, fall = m.least_jumps()
    r = m.replays
    sizes = [(j, r.x[number, JUMPS[j].state] - r.before[number, JUMPS[j].state]) for j in jumps_of(number)]
    for j, size in sizes:
        least, most = (rise[j], JUMPS[j].rise[1]) if size > 0.0 else (fall[j], JUMPS[j].fall[1])
        if not least <= abs(size) <= most:
            return False
    return len({size > 0.0 for _, size in sizes}) == 1


def _leader(setup: Setup, m: Memory, evidence: Array, order: list[int]) -> int | None:
    """The hypothesis that leads by enough, or None."""
    tuning = setup.tuning
    first, second = [number for number in order if number != BOTH][:2]
    if first not in PUMPS:
        if evidence[BOTH] - evidence[first] >= tuning.margin:
            return BOTH
        return first if evidence[first] - max(evidence[second], evidence[BOTH]) >= tuning.margin else None
    if evidence[BOTH] - evidence[first] >= tuning.both_lead:
        return BOTH if evidence[BOTH] - evidence[first] >= tuning.margin else None
    other = JUMPS[PUMPS[1 - first]].state
    is_alone = sqrt(max(m.replays.P[BOTH, other, other], 0.0)) < tuning.second_pump_std
    return first if is_alone and evidence[first] - evidence[second] >= tuning.margin else None


def _settle(setup: Setup, m: Memory, suspicion: Suspicion, winner: int) -> list[Alarm]:
    """The winner's filter becomes the filter."""
    r = m.replays
    row = _refine(setup, m, winner)
    m.suspicion = None
    m.x[:], m.P[:] = r.x[row], r.P[row]
    before, onset = r.before[row].copy(), int(r.onset[row])
    _loosen(setup, m, winner, before)
    alarms = []
    for index, j in enumerate(jumps_of(winner)):
        m.alarms += index
        alarms.append(verdict.declare(setup, m, j, before, onset, suspicion, m.alarms if index else suspicion.number))
    m.restart_bank()
    m.verdicts_s = (*m.verdicts_s, m.t_s)[-setup.tuning.verdicts_max :]
    return alarms


def _refine(setup: Setup, m: Memory, winner: int) -> int:
    """Try the onsets around the winner's own; the row of the replay that explains the readings best.

    Each is judged against no jump from its own onset on, so that the ratios compare as they are.
    """
    onset = int(m.replays.onset[winner])
    slots = sorted((s for s in range(bank.SLOTS) if m.bank.onset[s] >= 0), key=lambda s: abs(m.bank.onset[s] - onset))
    near = [s for s in slots[: setup.tuning.refined_onsets] if m.bank.onset[s] < m.now - 1]
    if m.now - onset >= replay.RING - 64 or all(m.bank.onset[s] != onset for s in near):
        return winner
    for row, slot in enumerate(near):
        _begin(m, row, winner, slot)
    _catch_up(setup, m, len(near), 1 << 40)
    return int(np.argmax(m.replays.evidence[: len(near)]))


def _loosen(setup: Setup, m: Memory, winner: int, before: Array) -> None:
    """An onset off by part of a step has left its mark on levels and size: let the readings correct it."""
    tuning = setup.tuning
    for j in jumps_of(winner):
        jump = JUMPS[j]
        size = float(m.x[jump.state] - before[jump.state])
        m.P[jump.state, jump.state] += (tuning.size_doubt * abs(size) + tuning.prior_doubt * jump.prior) ** 2
        m.P[range(4), range(4)] += (size * m.A[:4, jump.state]) ** 2
