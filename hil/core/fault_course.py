"""The course of a scenario's fault in time: onset, growth, pauses, end.

A fault with `ramp_s` grows linearly from nothing at its onset to its full size ramp_s later. An intermittent fault is
there for the first duty * period_s of each period, counted from the onset; its growth does not wait while it is away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FaultCourse:
    """Times in seconds of the run; fields as in a scenario's [[fault]].

    until_s : inf for a fault that does not end. ramp_s : 0 for an abrupt one. period_s : None for one without pauses.
    duty : share of each period in which the fault is there, in (0, 1); 1 without a period.
    """

    at_s: float
    until_s: float = math.inf
    ramp_s: float = 0.0
    period_s: float | None = None
    duty: float = 1.0

    def is_present(self, t_s: float) -> bool:
        """Whether the fault is there at t_s."""
        if not self.at_s <= t_s < self.until_s:
            return False
        return self.period_s is None or (t_s - self.at_s) % self.period_s < self.duty * self.period_s

    def size(self, t_s: float, healthy: float, value: float) -> float:
        """What has grown from `healthy` towards `value` at t_s, in their unit; `healthy` while the fault is away."""
        if not self.is_present(t_s):
            return healthy
        run_s = t_s - self.at_s
        return value if run_s >= self.ramp_s else healthy + (value - healthy) * run_s / self.ramp_s
