"""A bus with two ends in one thread, for lockstep: python-can's interface, frames passed on without a copy.

python-can's virtual bus copies and filters each frame, which makes a run longer by an eighth. See
docs/decisions/0007-lean-virtual-bus.md.
"""

from __future__ import annotations

from collections import deque

import can


class PairEnd(can.BusABC):
    """One end; the other end receives what it sends."""

    def __init__(self, inbox: deque[can.Message], outbox: deque[can.Message]) -> None:
        super().__init__(channel="pair")
        self._inbox, self._outbox = inbox, outbox

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Pass a frame to the other end; it keeps its time stamp."""
        del timeout
        self._outbox.append(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The oldest waiting frame, or None; never blocks."""
        del timeout
        if not self._inbox:
            return None
        message = self._inbox.popleft()
        message.is_rx = True
        return message

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), True

    def shutdown(self) -> None:
        """Drop the waiting frames."""
        self._inbox.clear()
        super().shutdown()


def pair() -> tuple[PairEnd, PairEnd]:
    """Both ends."""
    here: deque[can.Message] = deque()
    there: deque[can.Message] = deque()
    return PairEnd(here, there), PairEnd(there, here)
