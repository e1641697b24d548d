"""One fault in time: onset, growth, appearances, end.

A fault with `ramp_s` grows: its share of the full size is (t - onset) / ramp_s, then 1. The plant takes the share in
steps of a thousandth of the ramp, but of no less than 10 ms and no more than 0.1 s. An intermittent fault is there for
the first duty * period_s of each period, counted from its onset. Growth does not wait while the fault is away: when it
comes back, it has the size that a fault without pauses would have.
"""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np

from firmware_sim.faults.effects import NS_PER_S, Change

FAULT_STREAM = 3
RAMP_STEPS = 1000
MIN_STEP_NS = 10_000_000
MAX_STEP_NS = 100_000_000

T = TypeVar("T")


class Timed(Protocol):
    """When a fault is there; times in seconds from its origin."""

    @property
    def at_s(self) -> float:
        """Onset."""

    @property
    def until_s(self) -> float | None:
        """End, or None: the fault lasts to the end of the run."""

    @property
    def ramp_s(self) -> float:
        """Time of growth, 0 for an abrupt fault."""

    @property
    def period_s(self) -> float | None:
        """Period of an intermittent fault, or None: it does not go away before its end."""

    @property
    def duty(self) -> float | None:
        """Share of each period in which the fault is there, or None."""


class Episode:
    """One fault's time from onset to end, with its own random stream and its own state.

    begin_ns : begin of the appearance that `advance` has reached, the onset until then. share : of its full size.
    """

    def __init__(self, seed: int, index: int, origin_ns: int, fault: Timed) -> None:
        self.onset_ns = self.begin_ns = origin_ns + round(fault.at_s * NS_PER_S)
        self.end_ns = None if fault.until_s is None else origin_ns + round(fault.until_s * NS_PER_S)
        self.share = 1.0
        self._ramp_ns = round(fault.ramp_s * NS_PER_S)
        self._step_ns = min(max(self._ramp_ns // RAMP_STEPS, MIN_STEP_NS), MAX_STEP_NS)
        self._period_ns = None if fault.period_s is None else round(fault.period_s * NS_PER_S)
        self._present_ns = 0 if fault.period_s is None else round(fault.period_s * (fault.duty or 0.0) * NS_PER_S)
        self._source = (seed, index)
        self._random: np.random.Generator | None = None
        self._memory: Any = None

    @property
    def gone_ns(self) -> int | None:
        """End of the appearance that `advance` has reached, or None."""
        if self._period_ns is None:
            return self.end_ns
        gone_ns = self.begin_ns + self._present_ns
        return gone_ns if self.end_ns is None else min(gone_ns, self.end_ns)

    @property
    def random(self) -> np.random.Generator:
        """The fault's own stream, fixed by the run's seed and the fault's number."""
        if self._random is None:
            seed, index = self._source
            self._random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FAULT_STREAM, index)))
        return self._random

    def memory(self, make: Callable[[], T]) -> T:
        """The state that the fault made when it first applied in this appearance."""
        if self._memory is None:
            self._memory = make()
        kept: T = self._memory
        return kept

    def advance(self, now_ns: int) -> bool:
        """Bring `begin_ns` and `share` to now; whether the fault is there now."""
        if not self.is_present(now_ns):
            return False
        if self._period_ns is not None:
            begin_ns = now_ns - (now_ns - self.onset_ns) % self._period_ns
            if begin_ns != self.begin_ns:
                self.begin_ns, self._memory = begin_ns, None
        self.share = 1.0 if self._has_grown(now_ns) else (now_ns - self.onset_ns) / self._ramp_ns
        return True

    def grown(self, healthy: float, value: float) -> float:
        """The size now of a fault that grows from healthy to value."""
        return Change(value, self.share).of(healthy)

    def grown_ns(self, now_ns: int) -> float:
        """Integral of the share from the onset to now, in ns."""
        run_ns, ramp_ns = now_ns - self.onset_ns, self._ramp_ns
        return run_ns - 0.5 * ramp_ns if run_ns >= ramp_ns else 0.5 * run_ns * run_ns / ramp_ns

    def is_active(self, now_ns: int) -> bool:
        """Whether the fault has begun and not ended; an intermittent one may be away."""
        return self.onset_ns <= now_ns and (self.end_ns is None or now_ns < self.end_ns)

    def is_present(self, now_ns: int) -> bool:
        """Whether the fault is there."""
        if not self.is_active(now_ns):
            return False
        return self._period_ns is None or (now_ns - self.onset_ns) % self._period_ns < self._present_ns

    def next_change_ns(self, after_ns: int) -> int | None:
        """When the fault next begins, grows by a step, goes away, comes back or ends; None if nothing changes again."""
        if after_ns < self.onset_ns:
            return self.onset_ns
        if self.end_ns is not None and after_ns >= self.end_ns:
            return None
        times_ns = [] if self.end_ns is None else [self.end_ns]
        run_ns = after_ns - self.onset_ns
        if not self._has_grown(after_ns):
            times_ns.append(self.onset_ns + min((run_ns // self._step_ns + 1) * self._step_ns, self._ramp_ns))
        if self._period_ns is not None:
            phase_ns = run_ns % self._period_ns
            times_ns.append(
                after_ns - phase_ns + (self._present_ns if phase_ns < self._present_ns else self._period_ns)
            )
        return min(times_ns, default=None)

    def _has_grown(self, now_ns: int) -> bool:
        return now_ns - self.onset_ns >= self._ramp_ns
