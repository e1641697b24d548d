"""The monotonic clock, arrival times on it, and a flag that signals set."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from types import FrameType

AWAKE_NS = 150_000
"""The last part of each wait is a busy loop; waking up seldom takes longer than this."""


class MonotonicClock:
    """Nanoseconds that never jump. This is the only class that sleeps."""

    def now_ns(self) -> int:
        """Now, from an arbitrary origin."""
        return time.monotonic_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at the deadline, or at once when it is past. Python's sleep is clock_nanosleep on Linux."""
        asleep_ns = deadline_ns - AWAKE_NS - time.monotonic_ns()
        if asleep_ns > 0:
            time.sleep(asleep_ns * 1e-9)
        while time.monotonic_ns() < deadline_ns:
            pass


class ArrivalClock:
    """Turns the kernel's receive stamps, on the wall clock, into monotonic times of arrival.

    A frame arrived after the one before it, and before now: so a wall clock that jumps makes no frame of the future and
    none older than the gap before it.
    """

    def __init__(self, wall_ns: Callable[[], int] = time.time_ns) -> None:
        self._wall_ns = wall_ns
        self._newest_ns = 0

    def arrived_ns(self, stamp_s: float, now_ns: int) -> int:
        """When a frame arrived. stamp_s : the kernel's, s since the epoch. now_ns : monotonic."""
        waited_ns = self._wall_ns() - round(stamp_s * 1e9)
        self._newest_ns = min(max(now_ns - waited_ns, self._newest_ns), now_ns)
        return self._newest_ns


class StopSignal:
    """SIGINT, SIGTERM and SIGHUP ask for an orderly stop; a second one raises KeyboardInterrupt. Use as a context.

    A SIGHUP that is ignored before (nohup) stays ignored. Only the main thread can take signals over; in any other one
    this does nothing.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None
        self._previous: dict[signal.Signals, object] = {}

    def __enter__(self) -> StopSignal:
        """Take the signals over."""
        self._previous = _taken_over((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), self._handle)
        return self

    def __exit__(self, *exc: object) -> None:
        """Give them back."""
        _give_back(self._previous)

    def _handle(self, number: int, _: FrameType | None) -> None:
        if self.received is not None:
            raise KeyboardInterrupt
        self.received = signal.Signals(number)


class EndingSignal:
    """SIGTERM and SIGHUP raise KeyboardInterrupt at once, as SIGINT does; `received` names them. Use as a context.

    For work that moves nothing: files are closed and processes ended on the way out. Otherwise as `StopSignal`.
    """

    def __init__(self) -> None:
        self.received = ""
        self._previous: dict[signal.Signals, object] = {}

    def __enter__(self) -> EndingSignal:
        """Take the signals over."""
        self._previous = _taken_over((signal.SIGTERM, signal.SIGHUP), self._handle)
        return self

    def __exit__(self, *exc: object) -> None:
        """Give them back."""
        _give_back(self._previous)

    def _handle(self, number: int, _: FrameType | None) -> None:
        self.received = self.received or signal.Signals(number).name
        raise KeyboardInterrupt


def _taken_over(
    numbers: Sequence[signal.Signals], handle: Callable[[int, FrameType | None], None]
) -> dict[signal.Signals, object]:
    """Handle signals in the main thread; what handled them before."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    is_hangup_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    wanted = [number for number in numbers if not (number == signal.SIGHUP and is_hangup_ignored)]
    return {number: signal.signal(number, handle) for number in wanted}


def _give_back(previous: Mapping[signal.Signals, object]) -> None:
    for number, handler in previous.items():
        signal.signal(number, handler)  # type: ignore[arg-type]
