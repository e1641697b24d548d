"""A port on an interface of the kernel, SocketCAN, which may be taken down, unplugged and plugged in again.

Down and up again it is the same interface: frames sent meanwhile are lost, the rig's watchdog has its way. Unplugged it
never comes back, but another of the same name may: that one is opened anew.
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
LOOK_AGAIN_NS = NS_PER_S // 5


def is_there(channel: str) -> bool:
    """Whether the kernel has an interface of this name."""
    try:
        socket.if_nametoindex(channel)
    except OSError:
        return False
    return True


class InterfacePort(BusPort):
    """Ties a rig to a kernel's interface. `reopened` counts how often it came back.

    is_back : whether there is an interface to open. open_bus : opens it; may raise what buses raise.
    """

    def __init__(self, rig: Rig, bus: BusABC, is_back: Callable[[], bool], open_bus: Callable[[], BusABC]) -> None:
        super().__init__(rig, bus)
        self._is_back = is_back
        self._open_bus = open_bus
        self._is_gone = False
        self._look_again_ns = 0
        self._silence = os.eventfd(0)
        self.reopened = 0

    def filenos(self) -> list[int]:
        """Return the interface's descriptor; while it is away one on which nothing ever comes."""
        return [self._silence] if self._is_gone else super().filenos()

    def read(self, now_ns: int) -> bool:
        """Hand every waiting frame to the rig. That the interface is down or away is no failure of the rig's."""
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
        """Send frames; what the interface does not take now is lost and counted."""
        for frame in frames:
            if self._is_gone:
                self.errors["send"] += 1
                continue
            try:
                self.bus.send(frame, timeout=0)
            except BUS_ERRORS as error:
                self._note("send", error)

    def close(self) -> None:
        """Close what was opened here."""
        os.close(self._silence)
        if self.reopened:
            self.bus.shutdown()

    def _note(self, what: str, error: Exception) -> None:
        self.errors[what] += 1
        if (getattr(error, "error_code", None) or getattr(error, "errno", None)) in GONE:
            self._is_gone = True
            self.bus.shutdown()

    def _has_come_back(self, now_ns: int) -> bool:
        """Look from time to time; True once the interface is open again."""
        if now_ns < self._look_again_ns:
            return False
        self._look_again_ns = now_ns + LOOK_AGAIN_NS
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
