"""The noise, learned from the innovations: that of the process, and what the readings have beyond their scatter.

The noise of the process is how much each level wanders beyond what the model predicts.
Turbulence and waves add water to a tank and take it away at random: a random walk of the level. With too small a walk
the filter follows its readings too slowly, and its innovations become correlated. So beside the filter, for every tank,
there is a small bank of candidate walks. A candidate assumes that the level has another walk than the filter's; what
that leaves in the innovations is one number a tank, followed by a Kalman filter of one state. It gives the likelihood
of the readings under the candidate. The evidence fades, so that only the last minutes count.

The filter uses an upper quantile of the candidates' probability. It starts near the largest candidate and falls as the
readings exclude the large ones. It may rise by no more than a share of the time since the start, and later only slowly:
so a fault is not taken for noise.

Why: `docs/decisions/0024-process-noise.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.core.diagnosis.glr.compiled import compiled
from hil.core.diagnosis.glr.filter import PERIOD, READING, WALK, WEIGHT, StepResult, whitened
from hil.core.diagnosis.glr.model import Array

CANDIDATES, RATIO = 10, 1.5
"""Walks that are compared; each is this many times the one before in standard deviation."""

MEMORY_S = 200.0
"""Evidence fades with this time constant."""

MIN_EVIDENCE = -15.0
"""Log-likelihood that the evidence of a candidate may fall behind the best one: so soon can it come back."""

MIN_TAIL, MAX_TAIL, TAIL_S = 0.02, 0.1, 10.0
"""Probability of a walk above the one that the filter uses: at first, at last, and the time until it begins to grow."""

MAX_RISE_S = 0.03
"""Largest growth of the logarithm of the walk's standard deviation in a second, late in a run."""

MAX_SQUARE, MAX_SCALE = 9.0, 25.0
"""One innovation counts for no more than three standard deviations; how much a sensor's variance may grow."""

MIN_SHARE = 0.05
"""A candidate with a smaller walk than the filter's expects at least this share of the innovations' variance."""


class ProcessNoise(NamedTuple):
    """The candidates of the four tanks; all arrays change in place.

    walk : (4,) variance of the levels' walk that the filter uses, cm^2/s. candidate : (CANDIDATES,) walks that are
    compared, cm^2/s, rising. offset, variance : (4, CANDIDATES) cm, cm^2, of the filter's level, that the candidate's
    walk leaves. evidence : (4, CANDIDATES) log-likelihood, less that of the best candidate.
    """

    walk: Array
    candidate: Array
    offset: Array
    variance: Array
    evidence: Array

    @classmethod
    def begin(cls, min_walk_cm_sqrt_s: float) -> ProcessNoise:
        """Every candidate is equally likely."""
        candidate = np.array([(min_walk_cm_sqrt_s * RATIO**m) ** 2 for m in range(CANDIDATES)])
        shape = (4, CANDIDATES)
        evidence = np.zeros(shape)
        walk = np.array([_quantile(candidate, evidence[i], MIN_TAIL) for i in range(4)])
        return cls(walk=walk, candidate=candidate, offset=np.zeros(shape), variance=np.zeros(shape), evidence=evidence)

    def restart(self) -> None:
        """The filter has just been corrected: nothing is known of where another walk would have led."""
        self.offset[:] = 0.0
        self.variance[:] = 0.0


@compiled
def learn_process_noise(
    level_gain: float, entry: Array, result: StepResult, noise: ProcessNoise, age_s: float, is_calm: bool
) -> None:
    """Take in one filter step, `result` as `filter_step` wrote it. The evidence changes only where is_calm.

    age_s : since the filter started, s; above 0.
    """
    dt = entry[PERIOD]
    tail = min(MIN_TAIL * max(age_s / TAIL_S, 1.0), MAX_TAIL)
    for i in range(4):
        if not np.isfinite(entry[READING + i]):
            continue
        for m in range(noise.candidate.shape[0]):
            log_likelihood = _follow(level_gain, entry, result, noise, i, m)
            if is_calm:
                noise.evidence[i, m] += log_likelihood - dt / MEMORY_S * noise.evidence[i, m]
        if is_calm:
            best = noise.evidence[i].max()
            for m in range(noise.candidate.shape[0]):
                noise.evidence[i, m] = max(noise.evidence[i, m] - best, MIN_EVIDENCE)
            most = noise.walk[i] * np.exp(2.0 * (MAX_RISE_S + 1.0 / age_s) * dt)
            noise.walk[i] = min(_quantile(noise.candidate, noise.evidence[i], tail), most)


@compiled
def _follow(level_gain: float, entry: Array, result: StepResult, noise: ProcessNoise, i: int, m: int) -> float:
    """One step of candidate m of tank i; the log-likelihood of the reading but for a constant.

    The innovation is that of the filter, white, plus what the difference of the walks leaves in it. The difference may
    be negative: the equations hold, as long as the innovation's variance stays positive.
    """
    dt, weight = entry[PERIOD], entry[WEIGHT]
    extra = noise.candidate[m] * dt - entry[WALK + i]
    a, k = result.A[i, i], result.K[i, i]
    offset, variance = noise.offset[i, m], noise.variance[i, m]
    seen = level_gain * (1.0 - weight + weight * a)
    left = a - k * seen
    by_reading = level_gain * weight * extra
    reading_V2 = level_gain * level_gain * weight * (1.0 + 2.0 * weight) / 3.0 * extra
    moved = left * left * variance + extra - 2.0 * k * by_reading + k * k * reading_V2
    cross = left * seen * variance + by_reading - k * reading_V2
    own = result.variance[i]
    S = max(own + seen * seen * variance + reading_V2, MIN_SHARE * own)
    e = result.innovation[i] - seen * offset
    noise.offset[i, m] = left * offset + cross / S * e
    noise.variance[i, m] = max(moved - cross * cross / S, -own / (seen * seen))
    return float(-0.5 * (np.log(S) + min(e * e / S, MAX_SQUARE)))


@compiled
def _quantile(candidate: Array, evidence: Array, tail: float) -> float:
    """The walk that is exceeded with this probability, interpolated in the logarithm."""
    total = 0.0
    for m in range(candidate.shape[0]):
        total += np.exp(evidence[m])
    below = 0.0
    for m in range(candidate.shape[0]):
        share = np.exp(evidence[m]) / total
        if below + share >= 1.0 - tail:
            part = (1.0 - tail - below) / share
            return max(float(candidate[m] * RATIO ** (2.0 * part - 1.0)), float(candidate[0]))
        below += share
    return float(candidate[-1])


@compiled
def learn_scale(entry: Array, result: StepResult, scale: Array, pace: float) -> float:
    """Mean square of the whitened innovations, -1 without readings; scale (4,) follows each where it exceeds 1."""
    total, count = 0.0, 0
    for i in range(4):
        if np.isfinite(entry[READING + i]):
            value = whitened(result.whitener, result.innovation, i)
            square = value * value
            total += square
            count += 1
            grown = scale[i] * np.exp(pace * (min(square, MAX_SQUARE) - 1.0))
            scale[i] = min(max(grown, 1.0), MAX_SCALE)
    return total / count if count > 0 else -1.0
