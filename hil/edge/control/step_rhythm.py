"""When the process that serves clients leaves the processors to the control thread: shortly before each control step.

A step hands an update over when it ends, so the next one is due a period later. What a client asks for is taken in the
next step anyway; so a pause before it costs a request nothing, but for those of the last milliseconds.
"""

from __future__ import annotations

from math import floor

PAUSE_S = 5e-3
"""Before a step, and as long after it if its update does not come. A round of work is shorter than that."""

SHARE = 8
"""At most one part in so many of a period."""

MIN_PAUSE_S = 5e-4
"""For shorter ones, so at periods under 4 ms, there is no pause: the system does not wake a process up so exactly."""


class StepRhythm:
    """period_s : of the control steps; 0 for none."""

    def __init__(self, period_s: float) -> None:
        pause_s = min(PAUSE_S, period_s / SHARE)
        self._period_s = period_s if pause_s >= MIN_PAUSE_S else 0.0
        self._pause_s = pause_s
        self._stepped_at_s: float | None = None

    def stepped(self, now_s: float) -> None:
        """A step has just been made."""
        self._stepped_at_s = now_s

    def pause_s(self, now_s: float) -> float:
        """For how long to leave the clients alone; 0 for not at all. At fast periods not every step tells of itself."""
        since_s = self._since_s(now_s)
        if since_s is None:
            return 0.0
        periods = floor((since_s + self._pause_s) / self._period_s)
        end_s = periods * self._period_s + self._pause_s
        return max(end_s - since_s, 0.0) if periods > 0 else 0.0

    def free_s(self, now_s: float) -> float | None:
        """How long it is to the next pause; None for ever."""
        since_s = self._since_s(now_s)
        if since_s is None:
            return None
        periods = floor((since_s + self._pause_s) / self._period_s)
        return max((periods + 1) * self._period_s - self._pause_s - since_s, 0.0)

    def _since_s(self, now_s: float) -> float | None:
        return None if self._stepped_at_s is None or self._period_s == 0.0 else now_s - self._stepped_at_s
