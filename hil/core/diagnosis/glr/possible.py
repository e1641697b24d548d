"""What the rig may be while an alarm stands unresolved: one rig for each candidate that is no sensor's fault.

The control law follows what is declared. Until then it does not know which candidate is true, and aims at nothing that
one of them could not hold, see `hil.core.worst_target`.
"""

from __future__ import annotations

from hil.core.diagnosis.glr import declaration, identified
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.hypotheses import ALL, JUMPS, LAGS, PUMPS, SPLITS, jumps_of
from hil.core.diagnosis.glr.isolation import OPEN_MARGIN
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import BIAS, GAIN, OUTLET, SPLIT
from hil.core.types import Pair, PossibleRig

STANDS_S = 5.0
"""An alarm that is open for a shorter time changes nothing yet: most have their name within a second."""


def rigs(config: DetectorConfig, m: Memory) -> tuple[PossibleRig, ...]:
    """The rigs of all candidates that lag the likeliest by no more than OPEN_MARGIN; none if no alarm stands open."""
    suspicion = m.suspicion
    if suspicion is None or suspicion.number is None or suspicion.leader is None:
        return ()
    if m.t_s - suspicion.detected_s + suspicion.quiet_s < STANDS_S:
        return ()
    r = m.replays
    least = float(r.evidence[suspicion.leader]) - OPEN_MARGIN
    near = (n for n in range(ALL) if n not in LAGS and not r.dropped[n] and float(r.evidence[n]) >= least)
    return tuple(_rig(config, m, n) for n in near if JUMPS[jumps_of(n)[0]].state < BIAS)


def _rig(config: DetectorConfig, m: Memory, number: int) -> PossibleRig:
    x, before = m.replays.x[number], m.replays.before[number]
    left = list(declaration.effectiveness(m))
    for pump in set(PUMPS).intersection(jumps_of(number)):
        share = float(x[GAIN + pump]) / max(float(before[GAIN + pump]), declaration.PROVEN_SHARE)
        left[pump] = min(max(left[pump] * share, 0.0), declaration.MAX_EFFECTIVENESS)
    split = declaration.valve_split(config, m)
    if set(SPLITS).intersection(jumps_of(number)):
        g1, g2 = (min(max(float(config.model.valve_split[v] * x[SPLIT + v]), 0.0), 1.0) for v in range(2))
        split = (g1, g2)
    is_of_tank = JUMPS[jumps_of(number)[0]].state >= OUTLET
    return PossibleRig(
        names=tuple(_name(m, j, number) for j in jumps_of(number)),
        effectiveness=_pair(left),
        valve_split=split,
        waterways=identified.of_state(config, m, x) if is_of_tank else identified.waterways(config, m),
    )


def _pair(values: list[float]) -> Pair:
    first, second = values
    return first, second


def _name(m: Memory, j: int, number: int) -> str:
    jump = JUMPS[j]
    is_more = float(m.replays.x[number, jump.state]) > float(m.replays.before[number, jump.state])
    return f"{(jump.rises if is_more else jump.falls) or jump.rises or jump.falls} {jump.target}"
