"""The ports of the rig: a python-can bus, an slcan adapter on a TCP port, an slcan adapter on a pseudo-terminal.

Every port gives the frames that it reads to the rig and sends the rig's frames. No port blocks.
"""

import os
import select
import socket
from collections import Counter
from typing import Protocol

from can import BusABC, CanError, Message

from firmware_sim.links import SOCKET_BUFFER_BYTES, SlcanLink, discard_unread, open_pty
from firmware_sim.rig import Rig

# python-can's buses raise more than CanError, the slcan bus most of all.
BUS_ERRORS = (CanError, OSError, ValueError, IndexError)


class Port(Protocol):
    """What the service needs of a port."""

    def filenos(self) -> list[int]:
        """Descriptors to wait for; none if the port has to be polled."""

    def read(self, now_ns: int) -> bool:
        """Give all waiting frames to the rig as received now; False if the port failed."""

    def send(self, frames: list[Message]) -> None:
        """Send the rig's frames; those that can't be sent are lost."""

    def close(self) -> None:
        """Close the descriptors that the port opened itself."""


class BusPort:
    """Connects a rig to a python-can bus; the caller owns both, and the clock.

    Errors of the bus are counted in `errors` ("receive", "send"); a frame that could not be sent is lost, as
    on a real bus. Frames carry the rig's own time, which a virtual bus keeps if it was opened with
    preserve_timestamps=True.
    """

    def __init__(self, rig: Rig, bus: BusABC) -> None:
        self.rig = rig
        self.bus = bus
        self.errors: Counter[str] = Counter()

    def step(self, now_ns: int) -> None:
        """Give every waiting frame to the rig as received now, advance the rig to now, send its frames.

        Raises ValueError if now_ns lies in the past.
        """
        self.read(now_ns)
        self.send(self.rig.advance(now_ns))

    def filenos(self) -> list[int]:
        """Return the bus's descriptor if it has one."""
        try:
            fd = self.bus.fileno()
        except (NotImplementedError, *BUS_ERRORS):
            return []
        return [fd] if fd >= 0 else []

    def read(self, now_ns: int) -> bool:
        """Give every waiting frame to the rig; False if the bus failed."""
        while True:
            try:
                frame = self.bus.recv(0)
            except BUS_ERRORS:
                self.errors["receive"] += 1
                return False
            if frame is None:
                return True
            self.rig.receive(frame, now_ns)

    def send(self, frames: list[Message]) -> None:
        """Send frames; one that the bus refuses is lost and counted."""
        for frame in frames:
            try:
                self.bus.send(frame, timeout=0)
            except BUS_ERRORS:
                self.errors["send"] += 1

    def close(self) -> None:
        """Do nothing: the bus belongs to the caller."""


class TcpPort:
    """An slcan adapter on a TCP listener. One host at a time; a new one replaces one that is gone or stuck."""

    def __init__(self, rig: Rig, listener: socket.socket) -> None:
        self._rig = rig
        self._listener = listener
        self._client: socket.socket | None = None
        self._link: SlcanLink | None = None
        self.refused = 0

    def filenos(self) -> list[int]:
        """Return the listener's descriptor and the host's."""
        return [self._listener.fileno(), *([] if self._client is None else [self._client.fileno()])]

    def read(self, now_ns: int) -> bool:
        """Read from the host, then accept new hosts."""
        self._read_link(now_ns)
        while True:
            try:
                client, _ = self._listener.accept()
            except BlockingIOError:
                return True
            except OSError:
                return False
            self._admit(client)

    def send(self, frames: list[Message]) -> None:
        """Queue frames for the host and write as much as it accepts."""
        if self._link is not None and not _is_sent(self._link, frames):
            self._drop_client()

    def close(self) -> None:
        """Close the host's connection and the listener."""
        self._drop_client()
        self._listener.close()

    def _read_link(self, now_ns: int) -> None:
        if self._link is None:
            return
        frames = self._link.read()
        if frames is None:
            self._drop_client()
            return
        for frame in frames:
            self._rig.receive(frame, now_ns)

    def _admit(self, client: socket.socket) -> None:
        if self._link is not None and not self._link.is_stuck:
            self.refused += 1
            client.close()
            return
        self._drop_client()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER_BYTES)
        self._client = client
        self._link = SlcanLink(client.fileno())

    def _drop_client(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = self._link = None


class PtyPort:
    """An slcan adapter on a pseudo-terminal; a host opens `path`. The channel closes when the host goes."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._master, self.path = open_pty()
        self._link: SlcanLink | None = None

    def filenos(self) -> list[int]:
        """Return the master's descriptor while a host is there (it would always be readable otherwise)."""
        return [] if self._link is None else [self._master]

    def read(self, now_ns: int) -> bool:
        """Notice that a host came or went, and read from it."""
        if self._link is None:
            if self._is_hung_up():
                return True
            self._link = SlcanLink(self._master)
        frames = self._link.read()
        if frames is None:
            self._drop_host()
            return True
        for frame in frames:
            self._rig.receive(frame, now_ns)
        return True

    def send(self, frames: list[Message]) -> None:
        """Queue frames for the host and write as much as it accepts."""
        if self._link is not None and not _is_sent(self._link, frames):
            self._drop_host()

    def close(self) -> None:
        """Close the pseudo-terminal."""
        self._link = None
        os.close(self._master)

    def _drop_host(self) -> None:
        self._link = None
        discard_unread(self._master)

    def _is_hung_up(self) -> bool:
        poll = select.poll()
        poll.register(self._master, 0)
        return any(events & select.POLLHUP for _, events in poll.poll(0))


def _is_sent(link: SlcanLink, frames: list[Message]) -> bool:
    """Queue frames and write as much as the host accepts; False if the host is gone."""
    for frame in frames:
        link.send(frame)
    return link.flush()
