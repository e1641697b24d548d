"""A port on a SocketCAN interface, which may be taken down, unplugged and plugged in again.

An interface that was down is the same one when it is up again; frames sent meanwhile are lost, and the pump node's
watchdog trips. An interface that was unplugged does not come back, but another one of its name may: the port opens it.
"""

import errno
import os
import socket
from collections.abc import Callable

from can import BusABC, Message

from firmware_sim.faults import NS_PER_S
from firmware_sim.ports import BUS_ERRORS, BusPort
from firmware_sim.rig import Rig

GONE = frozenset({errno.ENODEV, errno.ENXIO})
RETRY_NS = NS_PER_S // 5


def is_there(channel: str) -> bool:
    """Whether the kernel has an interface of this name."""
    try:
        socket.if_nametoindex(channel)
    except OSError:
        return False
    return True


class InterfacePort(BusPort):
    """Connects a rig to a SocketCAN interface. `reopened` counts how often it came back.

    is_back : whether there is an interface to open. open_bus : opens it; may raise what buses raise.
    """

    def __init__(self, rig: Rig, bus: BusABC, is_back: Callable[[], bool], open_bus: Callable[[], BusABC]) -> None:
        super().__init__(rig, bus)
        self._is_back = is_back
        self._open_bus = open_bus
        self._is_gone = False
        self._retry_ns = 0
        self._silence = os.eventfd(0)
        self.reopened = 0

    def filenos(self) -> list[int]:
        """Return the interface's descriptor; while it is away, one that is never readable."""
        return [self._silence] if self._is_gone else super().filenos()

    def read(self, now_ns: int) -> bool:
        """Give every waiting frame to the rig; True even while the interface is down or away."""
        if self._is_gone and not self._has_come_back(now_ns):
            return True
        while True:
            try:
                frame = self.bus.recv(0)
            except BUS_ERRORS as error:
                self._note("receive", error)
                return True
            if frame is None:
                return True
            self.rig.receive(frame, now_ns)

    def send(self, frames: list[Message]) -> None:
        """Send frames; those that the interface does not take now are lost and counted."""
        for frame in frames:
            if self._is_gone:
                self.errors["send"] += 1
                continue
            try:
                self.bus.send(frame, timeout=0)
            except BUS_ERRORS as error:
                self._note("send", error)

    def close(self) -> None:
        """Close the buses that were opened here."""
        os.close(self._silence)
        if self.reopened:
            self.bus.shutdown()

    def _note(self, what: str, error: Exception) -> None:
        self.errors[what] += 1
        if (getattr(error, "error_code", None) or getattr(error, "errno", None)) in GONE:
            self._is_gone = True
            self.bus.shutdown()

    def _has_come_back(self, now_ns: int) -> bool:
        """Whether the interface is open again; tries it every RETRY_NS."""
        if now_ns < self._retry_ns:
            return False
        self._retry_ns = now_ns + RETRY_NS
        if not self._is_back():
            return False
        try:
            self.bus = self._open_bus()
        except BUS_ERRORS:
            self.errors["open"] += 1
            return False
        self._is_gone = False
        self.reopened += 1
        return True
