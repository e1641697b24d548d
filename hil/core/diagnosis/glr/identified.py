"""What the filter has identified of the rig, for the control law."""

from __future__ import annotations

from hil.core.diagnosis.glr.hypotheses import JUMPS, PUMPS
from hil.core.diagnosis.glr.memory import DetectorConfig, Memory
from hil.core.diagnosis.glr.model import BIAS, GAIN, LEAK, OUTLET, SCALE, SPLIT
from hil.core.types import Waterways


def waterways(config: DetectorConfig, m: Memory) -> Waterways | None:
    """What the filter has identified, if a leak or a blocked outlet was declared, otherwise None."""
    if not any(OUTLET <= JUMPS[j].state < BIAS for j in m.declared):
        return None
    x = m.x
    left = (m.declared[j].healthy if j in m.declared else float(x[GAIN + j]) for j in PUMPS)
    gain1, gain2 = (part * float(x[SCALE + j]) for j, part in zip(PUMPS, left, strict=True))
    o1, o2, o3, o4 = (max(float(x[OUTLET + i]), 0.0) for i in range(4))
    split1, split2 = (min(max(float(config.model.valve_split[i] * x[SPLIT + i]), 0.0), 1.0) for i in range(2))
    return Waterways(
        outlet=(o1, o2, o3, o4),
        leak=(max(float(x[LEAK]), 0.0), max(float(x[LEAK + 1]), 0.0)),
        gain=(gain1, gain2),
        split=(split1, split2),
    )
