"""What can go wrong, in the detector's eyes: each hypothesis is a jump of one state of the filter.

A row of `JUMPS` is one state that may jump. What a jump is called depends on its sign, and on what has already been
declared of that state: a pump that has lost gain may gain some again, one that hasn't can't.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.glr.process import BIAS, DRIFT, GAIN, LAG, LEAK, OUTLET, SPLIT


@dataclass(frozen=True, slots=True)
class Jump:
    """One state that may jump.

    state : its index. target : pump, tank or sensor, from 1. rises, falls : kind of fault that a jump up or down means,
    "" where the process can't do that. prior : standard deviation of a jump before anything is known of it.
    least_rise, least_fall : the smallest jump that is declared.
    """

    state: int
    target: int
    rises: str
    falls: str
    prior: float
    least_rise: float
    least_fall: float


BIAS_PRIOR_V = 0.5

JUMPS: tuple[Jump, ...] = (
    *(Jump(GAIN + j, j + 1, "pump_stuck_on", "pump_effectiveness", 0.5, 0.05, 0.01) for j in range(2)),
    *(Jump(SPLIT + j, j + 1, "valve_split", "valve_split", 0.2, 0.01, 0.01) for j in range(2)),
    *(Jump(LAG + j, j + 1, "pump_lag", "", 4.0, 0.5, 0.5) for j in range(2)),
    *(Jump(OUTLET + i, i + 1, "leak" if i < 2 else "", "outlet_block", 0.4, 0.01, 0.01) for i in range(4)),
    *(Jump(LEAK + i, i + 3, "leak", "", 0.4, 0.01, 0.01) for i in range(2)),
    *(Jump(BIAS + i, i + 1, "sensor_bias", "sensor_bias", BIAS_PRIOR_V, 0.005, 0.005) for i in range(4)),
    *(Jump(DRIFT + i, i + 1, "sensor_drift", "sensor_drift", 0.02, 0.001, 0.001) for i in range(4)),
)
H = len(JUMPS)
PUMPS = (0, 1)
"""Where the two pumps stand in JUMPS."""

BOTH = H
"""Number of the hypothesis that both pumps jumped at once."""
