"""A rig that its file does not describe, as on its first day: a wide filter beside the main one learns it.

The main filter believes the rig file within its `[uncertainty]`. The wide filter leaves room for pumps with other
gains, dead zones, bent curves and lags, for other outlets, and for sensors of a slightly other gain. When the bank
finds something that the wide filter expected as well as the likeliest fault would explain it, then nothing has
happened: the rig is another one than its file says. The wide filter becomes the main one, and no alarm is raised.

Then a filter beside it that believes less of what was learned takes its place, and so on.

A filter with so much to learn linearises about values that are far off at first. So it forgets a part of what it has
learned at each doubling of its age in the first minute or two.
Why: `docs/decisions/0028-model-error.md`, `docs/decisions/0062-known-before-it-is-kept.md`.
"""

from __future__ import annotations

from math import inf

import numpy as np

from hil.core.diagnosis.glr import drifting, own_verdict, wide_filter
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, StepResult
from hil.core.diagnosis.glr.hypotheses import BOTH, LAGS, PUMPS
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Wide
from hil.core.diagnosis.glr.model import GAIN, OUTLET, PUMP, SCALE, SPLIT, ZONE, Array
from hil.core.diagnosis.glr.refilter import RING

WIDE_SHARE = 0.5
"""It is enough that the wide filter has this share of the likeliest fault's evidence: it explains what follows, too."""

LATER_SHARE = 0.75
"""The same in the time in which a rig shows what it is, for what begins some seconds after a step, as a pump with three
times the file's lag gives water for as long; and for what seems older than the step, if the wide filter has gained as
much since then. Before it, all that the wide filter shows is what more room costs: on a rig at rest for 90 s that was
16, and a leak since the first reading was named that led it by 17."""

PROVEN_SHARE = 0.35
"""The same on a rig that is proven not to be as its file says. At the alarm, errors of its model had shares of 0.3 to
0.5, faults of 0.2 at most."""

KEEP_BESIDE, RENEW_S = 0.1, 60.0
"""Once the wide filter is the main one, the filter beside it believes this share of what was learned; it begins again
after this time."""

REFUTED_STDS, REFUTE_S, REFUTE_HOLD_S, REFUTE_STEPS = 3.0, 300.0, 5.0, 10
"""A rig is not as its file says if a pump's gain or an outlet turns out to be so many of the file's standard deviations
off, within this time: later that is a fault that grows. And for so long: before a large fault is found, the filter
follows it for some steps. It is looked at every so many steps."""

CONFIRMED_V = 2.0
"""A rig is as its file says if REFUTE_S have passed without a refutation, and each pump was driven over so many volts.
What differs then is a fault. A pump that lost a quarter of its gain while it stood still was once taken for the rig's
own, 900 s after the start."""

LEARNED_S, KNOWN_SHARE = 60.0, 0.25
"""A rig has been learned when it has been known for so long not to be as its file says, and nothing is forgotten any
more. Its outlets and valves stay what they are then, see `own_verdict.is_far`, or once their standard deviations are at
most this share of what they may differ by: while tanks still fill, an outlet was known to 6 %, and was 11 % off."""

AGAIN_S = 20.0
"""Such a rig need not be learned twice in this time. A drift of 10 mV/s was, three times in 5 s, then an outlet."""

_SPLITS, _OUTLETS = np.arange(SPLIT, SPLIT + 2), np.arange(OUTLET, OUTLET + 4)
_OF_RIG = np.array([SCALE, SCALE + 1, *_OUTLETS])
_RESULT = StepResult.empty()


def step(config: DetectorConfig, m: Memory, log_likelihood: float) -> None:
    """One step of the wide filter. log_likelihood : of this step's readings in the main filter, as it has just been."""
    tuning = config.tuning
    if m.now % REFUTE_STEPS == 0:
        _note_voltages(m)
    if m.is_wide:
        age_s = m.now * float(m.entry[PERIOD])
        is_due = age_s >= max(2.0 * m.relearned_s, tuning.relearn_from_s)
        if is_due and age_s < tuning.relearn_until_s and m.suspicion is None:
            _forget_share(m.P, tuning.relearn_keep, config.wide_prior)
            m.relearned_s = age_s
            m.restart_bank()
            return
        if m.now % REFUTE_STEPS == 0 and age_s >= tuning.relearn_until_s and _is_learned(config, m):
            _keep_learned(m)
        if m.wide is not None and m.max_ratio < tuning.calm and _is_old(m, m.wide):
            m.wide = None
    if m.wide is None:
        if m.suspicion is None and own_verdict.is_learned_on(m):  # what follows a fault is no matter of the rig's own
            m.wide = _begin(config, m)
        return
    wide = m.wide
    likelihood = wide_filter.step(config, wide.x, wide.P, m.entry, _RESULT)
    wide.lead[m.now % RING] = wide.lead[(m.now - 1) % RING] + likelihood - log_likelihood
    drifting.step(config, m, wide, likelihood)
    age_s = (m.now - wide.began) * float(m.entry[PERIOD])
    is_due = tuning.relearn_from_s <= age_s < tuning.relearn_until_s and age_s >= 2.0 * wide.relearned_s
    if is_due and not m.is_wide:
        _forget_share(wide.P, tuning.relearn_keep, config.wide_prior)
        wide.relearned_s = age_s
    if not m.is_wide and m.now % REFUTE_STEPS == 0:
        _watch_file(config, m, wide)


def _note_voltages(m: Memory) -> None:
    """Keep the least and the greatest voltage that each pump was driven by."""
    for j, voltage_V in enumerate(m.applied_V):
        low, high = m.driven_V[j]
        m.driven_V[j] = (min(low, voltage_V), max(high, voltage_V))


def _is_confirmed(m: Memory) -> bool:
    """Whether the rig has shown that it is as its file says."""
    is_driven = all(high - low >= CONFIRMED_V for low, high in m.driven_V)
    return not m.is_wide and is_driven and m.t_s - m.begun_s > REFUTE_S


def _is_learned(config: DetectorConfig, m: Memory) -> bool:
    """Whether a rig that is not as its file says has been known for long enough, and no fault of its process is.

    What has just been learned may still be on its way, with small standard deviations.
    """
    if m.t_s - m.proven_s < LEARNED_S or m.suspicion is not None or m.max_ratio >= config.tuning.calm:
        return False
    return m.t_s - max((m.taught_s, *m.verdicts_s[-1:])) >= AGAIN_S and own_verdict.is_learned_on(m)


def _keep_learned(m: Memory) -> None:
    """Keep the splits and outlets that are known well enough by now, each as it is when it is first."""
    if m.learned is None or m.is_keep_due:
        m.learned, m.is_keep_due = np.full(len(m.x), np.nan), False
    for places, far in ((_SPLITS, own_verdict.FAR_SPLIT), (_OUTLETS, own_verdict.FAR_OUTLET)):
        is_known = np.sqrt(m.P[places, places]) <= KNOWN_SHARE * far
        is_new = np.isnan(m.learned[places]) & is_known
        m.learned[places[is_new]] = m.x[places[is_new]]


def _watch_file(config: DetectorConfig, m: Memory, wide: Wide) -> None:
    """Let the wide filter become the main one when the rig file has been refuted for long enough."""
    wide.refuted_s = min(wide.refuted_s, m.t_s) if _is_refuted(config, m, wide) else inf
    if m.t_s - wide.refuted_s >= REFUTE_HOLD_S:
        become_main(m, wide)


def _is_refuted(config: DetectorConfig, m: Memory, wide: Wide) -> bool:
    """Whether the main filter itself has found the rig to be as its file excludes, and the wide one explains it."""
    if m.suspicion is not None or m.t_s - m.begun_s > REFUTE_S or wide.lead[m.now % RING] < 0.0:
        return False
    off = np.abs(m.x[_OF_RIG] - 1.0) > REFUTED_STDS * config.prior[_OF_RIG]
    return bool(off.any())


def explains_alarm(config: DetectorConfig, m: Memory) -> bool:
    """Whether the wide filter expected what the bank has just found, or always had it; it is the main filter then."""
    leader = int(np.argmax(m.best.ratio))
    onset = int(m.bank.onset[m.best.slot[leader]])
    if explains(config, m, onset, m.max_ratio):
        return True
    wide = m.wide
    if wide is None or leader not in (*PUMPS, BOTH, *LAGS) or not own_verdict.is_from_begin(m, onset):
        return False
    gains, stds = wide.x[SCALE : SCALE + 2], config.wide_prior[SCALE : SCALE + 2]
    if np.any(np.abs(gains - 1.0) > own_verdict.OWN_STDS * stds) or wide.lead[m.now % RING] < 0.0:
        return False
    become_main(m, wide)
    return True


def fold_gain(m: Memory, pump: int) -> None:
    """Make what a pump's gain has become its healthy gain."""
    T = np.eye(len(m.x))
    gain, scale = float(m.x[GAIN + pump]), float(m.x[SCALE + pump])
    T[SCALE + pump, SCALE + pump], T[SCALE + pump, GAIN + pump] = gain, scale
    T[GAIN + pump, GAIN + pump] = 0.0
    m.x[SCALE + pump], m.x[GAIN + pump] = gain * scale, 1.0
    m.P[:] = T @ m.P @ T.T


def _is_old(m: Memory, wide: Wide) -> bool:
    return m.suspicion is None and (m.now - wide.began) * float(m.entry[PERIOD]) > RENEW_S


def become_main(m: Memory, wide: Wide) -> None:
    """The wide filter becomes the main one: the rig is as it says."""
    m.proven_s = min(m.proven_s, m.t_s)
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
    if wide is None or _is_confirmed(m):
        return False
    is_early = m.t_s - m.begun_s < config.tuning.first_learning_s
    has_moved = is_early or own_verdict.moved_by(m, onset) >= own_verdict.MOVED_V
    lead = wide.gained(wide.lead, onset, m.now)
    share = PROVEN_SHARE if m.is_wide else WIDE_SHARE
    is_own = lead >= share * ratio and has_moved
    if not is_own and m.t_s - m.begun_s <= REFUTE_S:
        is_own = _shows_after_step(m, wide, onset, ratio)
    if is_own and m.learned is not None:
        is_own = m.t_s - m.taught_s >= AGAIN_S and not own_verdict.is_far(m, wide.x)
    if not is_own or drifting.sensor(m, onset) is not None:
        return False
    if m.learned is not None and not m.is_kept_again:  # what the first large steps teach
        m.is_keep_due, m.is_kept_again = True, m.t_s >= 0.0
    m.taught_s = m.t_s
    become_main(m, wide)
    return True


def _shows_after_step(m: Memory, wide: Wide, onset: int, ratio: float) -> bool:
    """Whether the wide filter has gained nearly as much since a step of the voltages, at the onset or after it."""
    lowest = wide.lowest(onset, m.now)
    if wide.gained(wide.lead, lowest, m.now) < LATER_SHARE * ratio:
        return False
    return own_verdict.moved_by(m, lowest, own_verdict.BEFORE_PROVEN_S) >= own_verdict.MOVED_V


def _begin(config: DetectorConfig, m: Memory) -> Wide:
    """The wide filter, from the main one as it is."""
    P = m.P.copy()
    if m.is_wide:
        _forget_share(P, KEEP_BESIDE, config.wide_prior)
        return Wide(x=m.x.copy(), P=P, began=m.now, drifting=drifting.beside(m.x, P))
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
