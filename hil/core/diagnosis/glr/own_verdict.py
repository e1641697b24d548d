"""Whether a verdict says what the rig has always been: then it is learned, and not reported.

On a rig that is proven not to be as its file says, what may be its own is likelier than a fault that explains the
readings no better.
Why: `docs/decisions/0040-what-was-always-so.md`, `docs/decisions/0043-learning-goes-on.md`,
`docs/decisions/0054-own-before-a-fault.md`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.core.diagnosis.glr import drifting
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, VOLTAGE
from hil.core.diagnosis.glr.hypotheses import ALL, BOTH, JUMPS, LAGS, PUMPS, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import BIAS, GAIN, LAG, LEAK, OUTLET, SCALE, SPLIT, Array
from hil.core.diagnosis.glr.refilter import RING
from hil.core.diagnosis.glr.strength import REPORT_S

MOVED_V, BEFORE_STEPS, BEFORE_S, BEFORE_PROVEN_S = 0.5, 10, 1.0, 5.0
"""A rig that is not as its file says shows that when a voltage moves, by this at least, since so many steps before, or
since this time before if that is more: a pump follows with its lag. The last is for a rig that is proven to be so: its
levels still move after a step of the voltages."""

BEGIN_S, OWN_STDS = 1.0, 2.0
"""A pump whose gain or lag differs since so soon after the first readings is no fault, if it differs by no more than so
many standard deviations of the wide filter."""

MAX_STDS = 4.0
"""Small leaks of an upper tank are learned up to so many standard deviations in all."""

SMALL = 0.1
"""On a rig that is proven not to be as its file says, a smaller jump while a voltage moves corrects the model."""

SMALL_RISE = 0.15
"""So does a larger one with which a pump gives more: no fault does that, but one that has stuck seems to."""

MINOR, EARLY_MINOR = 0.15, 0.3
"""A smaller declared change of a pump may be the rig's own, and does not end its learning; the second where it was
declared in the first `REPORT_S`, in which a rig shows what its pumps give at each voltage. A valve, an outlet or a leak
ends it: while one grows, learning took its growth for the rig's own."""


MOVED_FACTOR = 1.5
"""On a rig that is proven not to be as its file says, the limit of the test is so many times as high for what begins
after a movement: what its model still errs by shows then. Questions that were asked for nothing were at 20 to 22, and
died away."""

FAR_OUTLET, FAR_SPLIT = 0.1, 0.05
"""Outlets and splits of a rig that has been learned are its own if they differ by no more, as a share. On ten healthy
rigs of 30 minutes they differed by 0.07 and 0.01 at most; an outlet that clogged was learned in steps of 0.05."""

DRIFTS = "sensor_drift"

OF_PUMPS = (*PUMPS, BOTH, *LAGS)
"""What differs since the first readings where the pumps are not as in the file."""


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
    sizes = [float(r.x[winner, state] - r.before[winner, state]) for state in states]
    if winner in OF_PUMPS and is_learned_on(m) and is_from_begin(m, onset):
        spans = [config.wide_prior[state if winner in LAGS else SCALE + state - GAIN] for state in states]
        return all(abs(size) <= OWN_STDS * span for size, span in zip(sizes, spans, strict=True))
    return _is_small(config, m, winner, onset, sizes, float(r.x[winner, states[0]]))


def is_above_limit(config: DetectorConfig, m: Memory) -> bool:
    """Whether the greatest ratio of the bank raises an alarm, or a suspicion."""
    detect = config.tuning.detect
    if m.max_ratio < detect or m.max_ratio >= MOVED_FACTOR * detect or not m.is_wide:
        return m.max_ratio >= detect
    onset = int(m.bank.onset[m.best.slot[int(np.argmax(m.best.ratio))]])
    return moved_by(m, onset) < MOVED_V or drifting.sensor(m, onset) is not None


def may_be_own(config: DetectorConfig, m: Memory) -> bool:
    """Whether the verdict on what the bank has just found may be that it is the rig's own, see `own_instead`.

    On a rig that is proven not to be as its file says, the likeliest fault of pumps, valves and tanks may be, if no
    sensor's leads it by the margin. On any other, only what differs since the first readings where the pumps are not as
    in the file, and only if nothing else is likelier.
    """
    ratio = m.best.ratio
    if not m.is_wide:
        near = [n for n in OF_PUMPS if ratio[n] > max(m.max_ratio - config.tuning.margin, 0.0)]
        begin = any(is_from_begin(m, int(m.bank.onset[m.best.slot[n]])) for n in near)
        return begin and int(np.argmax(ratio)) in OF_PUMPS and is_learned_on(m)
    leader = max((n for n in range(BOTH + 1) if not _is_sensor(n)), key=lambda n: float(ratio[n]))
    if ratio[leader] <= 0.0 or float(ratio[leader]) < m.max_ratio - config.tuning.margin:
        return False
    is_new = not any(j in m.declared for j in (*jumps_of(leader), *jumps_of(int(np.argmax(ratio)))))
    onset = int(m.bank.onset[m.best.slot[leader]])
    return is_new and is_learned_on(m) and moved_by(m, onset) >= MOVED_V


def own_instead(config: DetectorConfig, m: Memory, leader: int) -> int | None:
    """What may be the rig's own and explains the readings about as well as the likeliest fault; None if nothing does.

    On a rig that is proven not to be as its file says that is the likelier one. It is never chosen before a sensor.
    """
    return None if _is_sensor(leader) else own_near(config, m, leader)


def leads_as_own(config: DetectorConfig, m: Memory, evidence: Array) -> int | None:
    """What may be the rig's own, if it leads all that may not by the margin; None otherwise.

    All of it is learned alike, so that it need not be told apart. evidence : (ALL,) log-likelihood ratios.
    """
    best = int(np.argmax(m.replays.evidence[:ALL]))
    own = None if _is_sensor(best) else own_near(config, m, best)
    if own is None:
        return None
    rivals = (float(evidence[n]) for n in range(ALL) if not is_own(config, m, n))
    return own if float(m.replays.evidence[own]) - max(rivals) >= config.tuning.margin else None


def own_near(config: DetectorConfig, m: Memory, leader: int) -> int | None:
    """The same beside any likeliest fault; where the likeliest is one of the pumps, on any rig, see `may_be_own`."""
    r = m.replays
    least = float(r.evidence[leader]) - config.tuning.margin
    alive = (n for n in range(ALL) if not r.dropped[n] and float(r.evidence[n]) >= least)
    if m.is_wide:
        near = [n for n in alive if is_own(config, m, n) or _is_lag_that_shows(m, n)]
    elif leader in OF_PUMPS:
        near = [n for n in alive if n in OF_PUMPS and is_from_begin(m, int(r.onset[n])) and is_own(config, m, n)]
    else:
        near = []
    return max(near, key=lambda n: float(r.evidence[n]), default=None)


def _is_lag_that_shows(m: Memory, number: int) -> bool:
    """Whether a lag is longer than learned, in the time in which a rig shows what it is.

    It is reported as what it is, but it is likelier than another fault that explains the readings no better.
    """
    if number not in LAGS or number in m.declared or not is_learned_on(m) or m.t_s - m.begun_s > REPORT_S:
        return False
    is_longer = m.replays.x[number, LAG + number - LAGS[0]] > m.replays.before[number, LAG + number - LAGS[0]]
    return bool(is_longer) and moved_by(m, int(m.replays.onset[number])) >= MOVED_V


def _is_sensor(number: int) -> bool:
    return JUMPS[jumps_of(number)[0]].state >= BIAS


def _is_small(config: DetectorConfig, m: Memory, number: int, onset: int, sizes: Sequence[float], whole: float) -> bool:
    """Whether jumps of these sizes correct the model of a rig that is proven not to be as its file says.

    whole : the first state with its jump, for a leak.
    """
    states = [JUMPS[j].state for j in jumps_of(number)]
    if not m.is_wide or max(states) >= BIAS or not is_learned_on(m):
        return False
    if number in LAGS:  # no fault makes a pump quicker
        return sizes[0] < 0.0 and moved_by(m, onset) >= MOVED_V
    if max(states) >= LEAK:
        std = float(config.wide_prior[states[0]])
        return max(sizes) <= OWN_STDS * std and whole <= MAX_STDS * std
    is_rise = number in (*PUMPS, BOTH) and min(sizes) > 0.0
    most = SMALL_RISE if is_rise else SMALL
    is_small = max(abs(size) for size in sizes) <= most and moved_by(m, onset) >= MOVED_V
    return is_small and not is_far(m, m.replays.x[number])


def is_far(m: Memory, x: Array) -> bool:
    """Whether outlets or splits of this state (N,) are not those of the rig as it was learned: then a fault grows."""
    if m.learned is None:
        return False
    off = np.abs(x[SPLIT:LEAK] / m.learned[SPLIT:LEAK] - 1.0)  # not a number while it is not known well enough
    return bool((off[: LAG - SPLIT] > FAR_SPLIT).any() or (off[OUTLET - SPLIT :] > FAR_OUTLET).any())


def is_learned_on(m: Memory) -> bool:
    """Whether the rig goes on to be learned.

    No more may be declared than lags, biases of sensors, and minor changes of pumps. A lost sensor ends it, too, but
    not on a rig that is proven not to be as its file says if its own readings show that it has failed: that says
    nothing of the process, which a drift may.
    """
    if not m.declared and not m.lost:
        return True
    own = (j in LAGS or JUMPS[j].state >= BIAS or _is_minor(m, j) for j in m.declared)
    is_sure = m.is_wide and all(lost.kind != DRIFTS for lost in m.lost.values())
    return (not m.lost or is_sure) and all(own)


def _is_minor(m: Memory, number: int) -> bool:
    """Whether a declared fault is a change of a pump that the rig may have had before."""
    one = m.declared[number]
    most = EARLY_MINOR if one.declared_s - m.begun_s <= REPORT_S else MINOR
    return number in PUMPS and abs(one.size) <= most


def is_from_begin(m: Memory, onset: int) -> bool:
    """Whether a step is so early that what begins there may have been there before the first reading."""
    return m.time_of(onset) - m.begun_s <= BEGIN_S


def moved_by(m: Memory, onset: int, before_s: float | None = None) -> float:
    """By how many volts a pump's voltage has moved since a little before a step: since before_s, if given."""
    before = _steps_of(m, before_s or (BEFORE_PROVEN_S if m.is_wide else BEFORE_S))
    steps = np.arange(max(onset - before, m.now - RING + 1, 1), m.now + 1) % RING
    return float(np.max(np.ptp(m.history.entries[steps, VOLTAGE : VOLTAGE + 2], axis=0)))


def _steps_of(m: Memory, time_s: float) -> int:
    return max(BEFORE_STEPS, round(time_s / float(m.entry[PERIOD])))
