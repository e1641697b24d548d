"""A rig that its file does not describe, as on its first day: a wide filter beside the main one learns it.

The main filter believes the rig file within its `[uncertainty]`. The wide filter leaves room for pumps with other
gains, dead zones, bent curves and lags, for other outlets, and for sensors of a slightly other gain. When the bank
finds something that the wide filter expected as well as the likeliest fault would explain it, then nothing has
happened: the rig is another one than its file says. The wide filter becomes the main one, and no alarm is raised.

Then a filter beside it that believes less of what was learned takes its place, and so on.

A filter with so much to learn linearises about values that are far off at first. So it forgets a part of what it has
learned at each doubling of its age in the first minute or two.
Why: `docs/decisions/0028-model-error.md`.
"""

from __future__ import annotations

from math import inf

import numpy as np

from hil.core.diagnosis.glr import kernels
from hil.core.diagnosis.glr.declaration import IDLE_V
from hil.core.diagnosis.glr.filter import PERIOD, VOLTAGE, StepResult
from hil.core.diagnosis.glr.hypotheses import BOTH, JUMPS, LAGS, PUMPS, jumps_of
from hil.core.diagnosis.glr.memory import DetectorConfig, Memory, Wide
from hil.core.diagnosis.glr.model import BIAS, GAIN, LEAK, OUTLET, PUMP, SCALE, ZONE, Array
from hil.core.diagnosis.glr.refilter import RING

WIDE_SHARE = 0.5
"""It is enough that the wide filter has this share of the likeliest fault's evidence: it explains what follows, too."""

KEEP_BESIDE, RENEW_S = 0.1, 60.0
"""Once the wide filter is the main one, the filter beside it believes this share of what was learned; it begins again
after this time."""

MOVED_V, BEFORE_STEPS = 0.5, 10
"""A rig that is not as its file says shows that when a voltage moves, by this at least, since so many steps before."""

BEGIN_S, OWN_STDS = 1.0, 2.0
"""A pump whose gain or lag differs since so soon after the first readings is no fault, if it differs by no more than so
many standard deviations of the wide filter."""

MAX_STDS = 4.0
"""Small leaks of an upper tank are learned up to so many standard deviations in all."""

SMALL = 0.1
"""On a rig that is proven not to be as its file says, a smaller jump while a voltage moves corrects the model."""

SMALL_NEAR_ZONE, NEAR_ZONE_V = 0.2, 1.0
"""So does a larger one of a pump whose voltage has been below this a little before: a dead zone ends in a bend."""

REFUTED_STDS, REFUTE_S, REFUTE_HOLD_S, REFUTE_STEPS = 3.0, 300.0, 5.0, 10
"""A rig is not as its file says if a pump's gain or an outlet turns out to be so many of the file's standard deviations
off, within this time: later that is a fault that grows. And for so long: before a large fault is found, the filter
follows it for some steps. It is looked at every so many steps."""

MINOR = 0.15
"""On such a rig, a smaller declared fault may be the rig's own, and does not end its learning."""

_OF_RIG = np.array([SCALE, SCALE + 1, *range(OUTLET, OUTLET + 4)])
_RESULT = StepResult.empty()


def step(config: DetectorConfig, m: Memory, log_likelihood: float) -> None:
    """One step of the wide filter. log_likelihood : of this step's readings in the main filter, as it has just been."""
    tuning = config.tuning
    if m.is_wide:
        age_s = m.now * float(m.entry[PERIOD])
        is_due = age_s >= max(2.0 * m.relearned_s, tuning.relearn_from_s)
        if is_due and age_s < tuning.relearn_until_s and m.suspicion is None:
            _forget_share(m.P, tuning.relearn_keep, config.wide_prior)
            m.relearned_s = age_s
            m.restart_bank()
            return
        if m.wide is not None and m.suspicion is None and (m.now - m.wide.began) * float(m.entry[PERIOD]) > RENEW_S:
            m.wide = None
    if m.wide is None:
        if m.suspicion is None and _is_learned_on(m):  # what follows a fault is no matter of the rig's own
            m.wide = _begin(config, m)
        return
    wide = m.wide
    likelihood = kernels.filter_step(config.model, wide.x, wide.P, m.entry, _RESULT)
    wide.lead[m.now % RING] = wide.lead[(m.now - 1) % RING] + likelihood - log_likelihood
    age_s = (m.now - wide.began) * float(m.entry[PERIOD])
    is_due = tuning.relearn_from_s <= age_s < tuning.relearn_until_s and age_s >= 2.0 * wide.relearned_s
    if is_due and not m.is_wide:
        _forget_share(wide.P, tuning.relearn_keep, config.wide_prior)
        wide.relearned_s = age_s
    if not m.is_wide and m.now % REFUTE_STEPS == 0:
        _watch_file(config, m, wide)


def _watch_file(config: DetectorConfig, m: Memory, wide: Wide) -> None:
    """Let the wide filter become the main one when the rig file has been refuted for long enough."""
    wide.refuted_s = min(wide.refuted_s, m.t_s) if _is_refuted(config, m, wide) else inf
    if m.t_s - wide.refuted_s >= REFUTE_HOLD_S:
        _become_main(m, wide)


def _is_refuted(config: DetectorConfig, m: Memory, wide: Wide) -> bool:
    """Whether the main filter itself has found the rig to be as its file excludes, and the wide one explains it."""
    if m.suspicion is not None or m.t_s - m.begun_s > REFUTE_S or wide.lead[m.now % RING] < 0.0:
        return False
    off = np.abs(m.x[_OF_RIG] - 1.0) > REFUTED_STDS * config.prior[_OF_RIG]
    return bool(off.any())


def explains_alarm(config: DetectorConfig, m: Memory) -> bool:
    """Whether the wide filter expected what the bank has just found, or always had it; it is the main filter then."""
    leader = int(np.argmax(m.best.ratio))
    slot = int(m.best.slot[leader])
    onset = int(m.bank.onset[slot])
    if explains(config, m, onset, m.max_ratio):
        return True
    wide = m.wide
    if _is_idle(m, leader, onset) and all(float(m.bank.match[j, slot]) < 0.0 for j in jumps_of(leader)):
        if wide is not None and wide.lead[m.now % RING] >= 0.0:
            _become_main(m, wide)
        m.restart_bank()
        return True
    if wide is None or leader not in (*PUMPS, BOTH, *LAGS) or not _is_from_begin(m, onset):
        return False
    gains, stds = wide.x[SCALE : SCALE + 2], config.wide_prior[SCALE : SCALE + 2]
    if np.any(np.abs(gains - 1.0) > OWN_STDS * stds) or wide.lead[m.now % RING] < 0.0:
        return False
    _become_main(m, wide)
    return True


def is_own(config: DetectorConfig, m: Memory, winner: int) -> bool:
    """Whether a verdict says what the rig has always been, so that it is learned and not reported.

    That is a lag that is as the file says within its uncertainty; a pump that differs since the first readings by no
    more than pumps do; and, on a rig that is proven not to be as its file says, a small jump while a voltage moves.
    """
    r, jumps = m.replays, jumps_of(winner)
    if any(j in m.declared for j in jumps):
        return False
    states = [JUMPS[j].state for j in jumps]
    if winner in LAGS and float(r.x[winner, states[0]]) <= 1.0 + float(config.prior[states[0]]):
        return True
    onset = int(r.onset[winner])
    if not _is_learned_on(m) or max(states) >= BIAS:
        return False
    if max(states) >= LEAK:
        std = float(config.wide_prior[states[0]])
        size = float(r.x[winner, states[0]] - r.before[winner, states[0]])
        return m.is_wide and size <= OWN_STDS * std and float(r.x[winner, states[0]]) <= MAX_STDS * std
    sizes = [abs(float(r.x[winner, state] - r.before[winner, state])) for state in states]
    if winner in (*PUMPS, BOTH, *LAGS) and _is_from_begin(m, onset):
        spans = [config.wide_prior[state if winner in LAGS else SCALE + state - GAIN] for state in states]
        return all(size <= OWN_STDS * span for size, span in zip(sizes, spans, strict=True))
    most = SMALL_NEAR_ZONE if _has_left_zone(m, winner, onset) else SMALL
    return m.is_wide and winner not in LAGS and max(sizes) <= most and _moved_by(m, onset) >= MOVED_V


def shows_nothing(m: Memory, winner: int) -> bool:
    """Whether a verdict says that a pump gives less, and it has hardly been driven since: that is a dead zone."""
    r = m.replays
    jumps = jumps_of(winner)
    states = [JUMPS[j].state for j in jumps]
    is_less = bool(np.all(r.x[winner, states] < r.before[winner, states]))
    return is_less and _is_idle(m, winner, int(r.onset[winner])) and not any(j in m.declared for j in jumps)


def _is_idle(m: Memory, number: int, onset: int) -> bool:
    """Whether a hypothesis is about pumps whose voltage has not shown what they give since a step.

    Only on a rig that is proven not to be as its file says. On another one it hid an empty reservoir from two pumps
    at rest, and the first that started then ran dry for 3 s.
    """
    if number not in (*PUMPS, BOTH) or not m.is_wide:
        return False
    steps = np.arange(max(onset, m.now - RING + 1, 1), m.now + 1) % RING
    return all(float(m.history.entries[steps, VOLTAGE + j].max()) < IDLE_V for j in jumps_of(number))


def _has_left_zone(m: Memory, winner: int, onset: int) -> bool:
    """Whether a hypothesis is about pumps whose voltage was near their dead zone a little before a step, or since."""
    if winner not in (*PUMPS, BOTH):
        return False
    steps = np.arange(max(onset - BEFORE_STEPS, m.now - RING + 1, 1), m.now + 1) % RING
    return all(float(m.history.entries[steps, VOLTAGE + j].min()) < NEAR_ZONE_V for j in jumps_of(winner))


def fold_gain(m: Memory, pump: int) -> None:
    """Make what a pump's gain has become its healthy gain."""
    T = np.eye(len(m.x))
    gain, scale = float(m.x[GAIN + pump]), float(m.x[SCALE + pump])
    T[SCALE + pump, SCALE + pump], T[SCALE + pump, GAIN + pump] = gain, scale
    T[GAIN + pump, GAIN + pump] = 0.0
    m.x[SCALE + pump], m.x[GAIN + pump] = gain * scale, 1.0
    m.P[:] = T @ m.P @ T.T


def _is_learned_on(m: Memory) -> bool:
    """Whether the rig goes on to be learned: no sensor is lost, and no more than lags and what is MINOR is declared.

    The latter on a rig that is proven not to be as its file says.
    """
    return not m.lost and all(j in LAGS or (m.is_wide and abs(one.size) <= MINOR) for j, one in m.declared.items())


def _is_from_begin(m: Memory, onset: int) -> bool:
    """Whether a step is so early that what begins there may have been there before the first reading."""
    return m.time_of(onset) - m.begun_s <= BEGIN_S


def _become_main(m: Memory, wide: Wide) -> None:
    """The wide filter becomes the main one: the rig is as it says."""
    m.x[:], m.P[:], m.is_wide, m.relearned_s = wide.x, wide.P, True, wide.relearned_s
    m.scale[:] = 1.0
    m.mean_square = 1.0
    m.restart_bank()


def explains(config: DetectorConfig, m: Memory, onset: int, ratio: float) -> bool:
    """Whether the wide filter expected the readings since a step; it is the main filter then.

    ratio : log-likelihood ratio of the likeliest fault with this onset, against none. A voltage must have moved: what
    grows while the voltages rest is no matter of the rig's own parameters.
    """
    wide = m.wide
    if wide is None:
        return False
    is_early = m.t_s - m.begun_s < config.tuning.first_learning_s
    lead = wide.lead[m.now % RING] - wide.lead[max(onset, wide.began, m.now - RING + 1) % RING]
    if lead < WIDE_SHARE * ratio or not (is_early or _moved_by(m, onset) >= MOVED_V):
        return False
    _become_main(m, wide)
    return True


def _moved_by(m: Memory, onset: int) -> float:
    """By how many volts a pump's voltage has moved since a little before a step."""
    steps = np.arange(max(onset - BEFORE_STEPS, m.now - RING + 1, 1), m.now + 1) % RING
    return float(np.max(np.ptp(m.history.entries[steps, VOLTAGE : VOLTAGE + 2], axis=0)))


def _begin(config: DetectorConfig, m: Memory) -> Wide:
    """The wide filter, from the main one as it is."""
    P = m.P.copy()
    if m.is_wide:
        _forget_share(P, KEEP_BESIDE, config.wide_prior)
        return Wide(x=m.x.copy(), P=P, began=m.now)
    extra = config.wide_prior**2 - config.prior**2
    for j in range(2):
        if m.x[PUMP + j] > 0.0:
            extra[PUMP + j] = config.wide_prior[ZONE + j] ** 2
    P[np.diag_indices_from(P)] += extra
    return Wide(x=m.x.copy(), P=P, began=m.now)


def _forget_share(P: Array, keep: float, prior: Array) -> None:
    """Keep this share of what was learned, as if each reading had been worth so much less, in place.

    P : (N, N). prior : (N,) standard deviations before the first reading; what they say is kept whole.
    """
    states = np.flatnonzero(prior > 0.0)
    P /= keep
    S = P[np.ix_(states, states)] + np.diag(prior[states] ** 2 / (1.0 - keep))
    P -= P[:, states] @ np.linalg.solve(S, P[states])
    P[:] = 0.5 * (P + P.T)
