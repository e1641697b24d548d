"""A bus of two ends in one thread: python-can's interface, frames handed over as they are.

For lockstep. python-can's virtual bus copies and filters each frame, which makes a run an eighth longer.
"""

from __future__ import annotations

from collections import deque

import can


class PairEnd(can.BusABC):
    """One end; what it sends, the other receives."""

    def __init__(self, inbox: deque[can.Message], outbox: deque[can.Message]) -> None:
        super().__init__(channel="pair")
        self._inbox, self._outbox = inbox, outbox

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a frame over; it keeps its timestamp."""
        del timeout
        self._outbox.append(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The oldest frame that waits, or None; never waits."""
        del timeout
        if not self._inbox:
            return None
        message = self._inbox.popleft()
        message.is_rx = True
        return message

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), True

    def shutdown(self) -> None:
        """Drop what waits."""
        self._inbox.clear()
        super().shutdown()


def pair() -> tuple[PairEnd, PairEnd]:
    """Both ends."""
    here: deque[can.Message] = deque()
    there: deque[can.Message] = deque()
    return PairEnd(here, there), PairEnd(there, here)
