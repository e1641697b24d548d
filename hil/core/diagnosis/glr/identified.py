"""What the filter has identified of the rig, for the control law."""

from __future__ import annotations

from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.hypotheses import JUMPS, PUMPS
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import BIAS, GAIN, LEAK, OUTLET, SCALE, SPLIT, Array
from hil.core.types import Waterways

_WATERWAYS = frozenset(j for j, jump in enumerate(JUMPS) if OUTLET <= jump.state < BIAS)
"""Places in JUMPS of leaks and blocked outlets."""


def waterways(config: DetectorConfig, m: Memory) -> Waterways | None:
    """What the filter has identified, if a leak or a blocked outlet was declared, otherwise None."""
    return None if _WATERWAYS.isdisjoint(m.declared) else of_state(config, m, m.x)


def of_state(config: DetectorConfig, m: Memory, x: Array) -> Waterways:
    """The same of a filter's state x (N,), whatever was declared."""
    state = x.tolist()  # plain numbers: at every step once a leak is declared, numpy's take several times as long
    first, second = m.declared.get(PUMPS[0]), m.declared.get(PUMPS[1])
    left1, left2 = first.healthy if first else state[GAIN], second.healthy if second else state[GAIN + 1]
    scale1, scale2 = state[SCALE : SCALE + 2]
    o1, o2, o3, o4, leak3, leak4 = state[OUTLET : LEAK + 2]
    (g1, g2), (part1, part2) = config.model.valve_split.tolist(), state[SPLIT : SPLIT + 2]
    return Waterways(
        outlet=(max(o1, 0.0), max(o2, 0.0), max(o3, 0.0), max(o4, 0.0)),
        leak=(max(leak3, 0.0), max(leak4, 0.0)),
        gain=(left1 * scale1, left2 * scale2),
        split=(min(max(g1 * part1, 0.0), 1.0), min(max(g2 * part2, 0.0), 1.0)),
    )
