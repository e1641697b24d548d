"""The loop in real time: one thread, absolute deadlines; a late step is skipped and recorded, never repeated.

Between deadlines the thread waits for frames. Shortly before a deadline the clock waits instead, because a wait for
frames ends late if the thread wakes up late. Whatever ends the loop, the last command is 0 V. See
docs/decisions/0015-real-time.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hil.core.types import Timing
from hil.edge.can.bus import BusPort
from hil.edge.host.clock import AWAKE_NS
from hil.loop import ControlLoop, Outcome

STALL_NS = 10_000_000
"""A step that begins later than this first receives all waiting frames, which would otherwise be too old.

So does one before which there was no time to receive any: a law may take a little longer than a period at every step.
"""

DOWN_POLL_S = 0.005
"""A bus that is down returns at once; try again after this long."""


class Clock(Protocol):
    """The clock that the runtime needs."""

    def now_ns(self) -> int:
        """Monotonic time."""
        ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Wait until this time."""
        ...


def run(
    loop: ControlLoop,
    port: BusPort,
    clock: Clock,
    period_s: float,
    stop_reason: Callable[[], str],
    housekeeping: Callable[[], None] = lambda: None,
) -> Outcome:
    """Run to the end.

    stop_reason : returns "" until a stop is requested. housekeeping : called after each step; should take less than the
    rest of the period.
    """
    period_ns = round(period_s * 1e9)
    early_ns = min(AWAKE_NS, period_ns // 8)
    skipped = 0
    deadline_ns = clock.now_ns() + period_ns
    try:
        while loop.outcome is None:
            has_time = clock.now_ns() < deadline_ns - early_ns
            _listen(loop, port, clock, deadline_ns - early_ns)
            clock.sleep_until(deadline_ns)
            if not has_time or clock.now_ns() - deadline_ns > STALL_NS:
                _catch_up(loop, port, clock)
            now_ns = clock.now_ns()
            late_ns = now_ns - deadline_ns
            missed = late_ns // period_ns
            skipped += missed
            for event in port.take_events():
                loop.note(event)
            loop.tick(now_ns, Timing(late_ns * 1e-9, skipped), stop_reason())
            deadline_ns += period_ns * (missed + 1)
            housekeeping()
    finally:
        loop.make_safe(clock.now_ns())
    return loop.outcome


def _listen(loop: ControlLoop, port: BusPort, clock: Clock, until_ns: int) -> None:
    """Receive frames until this time."""
    while (remaining_ns := until_ns - clock.now_ns()) > 0:
        if not port.is_up:
            clock.sleep_until(min(until_ns, clock.now_ns() + int(DOWN_POLL_S * 1e9)))
            continue
        message = port.receive(remaining_ns * 1e-9)
        if message is not None:
            loop.receive(message, port.arrived_ns(message, clock.now_ns()))


def _catch_up(loop: ControlLoop, port: BusPort, clock: Clock) -> None:
    """Receive the frames that arrived during a stall, so that the step knows what the nodes did."""
    for message in port.waiting():
        loop.receive(message, port.arrived_ns(message, clock.now_ns()))
