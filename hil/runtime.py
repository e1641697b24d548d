"""The loop in real time: one thread, absolute deadlines, a late step skipped and recorded, never made up for.

Between deadlines the thread waits for frames, but for the very last moments, which the clock waits out: a wait for
frames ends as late as the thread wakes up. Whatever ends the loop, the last thing it sends is 0 V.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hil.core.types import Timing
from hil.edge.can.bus import BusPort
from hil.edge.host.clock import AWAKE_NS
from hil.loop import ControlLoop, Outcome

STALL_NS = 10_000_000
"""A step that begins later than this first takes in the frames that have piled up, or they would count as too old."""

DOWN_POLL_S = 0.005
"""A bus that is down returns at once; look again after this long."""


class Clock(Protocol):
    """What the runtime needs of a clock."""

    def now_ns(self) -> int:
        """Monotonic time."""
        ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Wait for a time to come."""
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

    stop_reason : "" as long as nobody has asked to stop. housekeeping : called when a step is over; should take less
    than the rest of the period.
    """
    period_ns = round(period_s * 1e9)
    early_ns = min(AWAKE_NS, period_ns // 8)
    skipped = 0
    deadline_ns = clock.now_ns() + period_ns
    try:
        while loop.outcome is None:
            _listen(loop, port, clock, deadline_ns - early_ns)
            clock.sleep_until(deadline_ns)
            if clock.now_ns() - deadline_ns > STALL_NS:
                _catch_up(loop, port, clock)
            now_ns = clock.now_ns()
            late_ns = now_ns - deadline_ns
            missed = late_ns // period_ns
            skipped += missed
            for event in port.news():
                loop.note(event)
            loop.tick(now_ns, Timing(late_ns * 1e-9, skipped), stop_reason())
            deadline_ns += period_ns * (missed + 1)
            housekeeping()
    finally:
        loop.make_safe(clock.now_ns())
    return loop.outcome


def _listen(loop: ControlLoop, port: BusPort, clock: Clock, until_ns: int) -> None:
    """Take in frames as they come."""
    while (remaining_ns := until_ns - clock.now_ns()) > 0:
        if not port.is_up:
            clock.sleep_until(min(until_ns, clock.now_ns() + int(DOWN_POLL_S * 1e9)))
            continue
        message = port.receive(remaining_ns * 1e-9)
        if message is not None:
            loop.receive(message, port.arrived_ns(message, clock.now_ns()))


def _catch_up(loop: ControlLoop, port: BusPort, clock: Clock) -> None:
    """Take in what has piled up during a stall, so that the step sees what the nodes did meanwhile."""
    for message in port.waiting():
        loop.receive(message, port.arrived_ns(message, clock.now_ns()))
