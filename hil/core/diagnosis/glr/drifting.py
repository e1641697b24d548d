"""Whether a sensor drifts, or whether it is the rig's own, on a rig that its file does not describe.

A filter that relearns a part of what it knows takes a slow drift for an outlet that is a little wider, and learns it
away. So the same filter runs beside it with room for drifts of all four sensors. The two differ in nothing else:
what the second expects better, a drift explains and the rig does not.
Why: `docs/decisions/0057-drifts-beside-the-rig.md`.
"""

from __future__ import annotations

import numpy as np

from hil.core.diagnosis.glr import wide_filter
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, StepResult
from hil.core.diagnosis.glr.hypotheses import JUMPS, drift_of, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Drifting, Suspicion, Wide
from hil.core.diagnosis.glr.model import BIAS, DRIFT, Array
from hil.core.diagnosis.glr.refilter import RING

WALK_V = 3e-4
"""Random walk of the drifts in a second, V/s: 2 mV/s that have just begun are found in some ten seconds."""

LEAD, SHARE, STDS, ALONE = 5.0, 0.5, 2.0, 1.5
"""A drift is in question if it explains so much more than the rig's own does, as a log-likelihood ratio, and this share
of what the rig's own explains; and if it is so many standard deviations from none, and so many times as many as that of
any other sensor: where all four seem to drift, the model errs. Drifts of 2 mV/s led by 5 to 18, and 0.7 or more, when
the relearning filter would have learned them. Of healthy rigs one led by 9 with 1.1 and 0.9 mV/s in two sensors, one by
5.8, and 0.4."""

OVER_DRIFT = 2.0
"""What else explains the readings must then lead the drift by so many margins: a clogging outlet of an upper tank led a
drift by 6.5 after a step of the references, because it explained what the model of the rig erred by."""

_RESULT = StepResult.empty()


def beside(x: Array, P: Array) -> Drifting:
    """The filter that begins beside another with this state."""
    return Drifting(x=x.copy(), P=P.copy())


def step(config: DetectorConfig, m: Memory, wide: Wide, log_likelihood: float) -> None:
    """One step. log_likelihood : of this step's readings in the wide filter, as it has just been."""
    own = wide.drifting
    if own is None:
        return
    drifts = np.arange(DRIFT, DRIFT + 4)
    own.P[drifts, drifts] += WALK_V**2 * float(m.entry[PERIOD])
    likelihood = wide_filter.step(config, own.x, own.P, m.entry, _RESULT)
    own.lead[m.now % RING] = own.lead[(m.now - 1) % RING] + likelihood - log_likelihood


def sensor(m: Memory, onset: int) -> int | None:
    """The sensor, from 0, whose drift since a step explains the readings better than the rig's own does, or None."""
    if m.wide is None or m.wide.drifting is None:
        return None
    wide, own = m.wide, m.wide.drifting
    least = max(LEAD, SHARE * wide.gained(wide.lead, onset, m.now))
    if wide.gained(own.lead, onset, m.now) < least:
        return None
    stds = np.abs(own.x[DRIFT : DRIFT + 4]) / np.sqrt(own.P.diagonal()[DRIFT : DRIFT + 4])
    found = int(np.argmax(stds))
    return found if stds[found] >= max(STDS, ALONE * np.sort(stds)[-2]) else None


def watch(m: Memory, suspicion: Suspicion, onset: int) -> None:
    """Note whose drift is in question. It stays so while the alarm is open: the onset is not known well."""
    found = sensor(m, onset)
    suspicion.drift = suspicion.drift if found is None else found


def may_be_drift(config: DetectorConfig, m: Memory, number: int) -> bool:
    """Whether a fault of the process, or what may be the rig's own, leads such a drift by too little to be taken."""
    if m.suspicion is None or m.suspicion.drift is None or JUMPS[jumps_of(number)[0]].state >= BIAS:
        return False
    drift = drift_of(m.suspicion.drift + 1)
    lead = float(m.replays.evidence[number] - m.replays.evidence[drift])
    return not m.replays.dropped[drift] and lead < OVER_DRIFT * config.tuning.margin
