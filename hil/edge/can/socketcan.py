"""The kernel's CAN interfaces, by python-can, with what a controller needs beyond.

- An interface that is missing, down, bus-off or of another bit rate is refused before anything is sent.
- A command is refused while the one before it still waits in the kernel: at most that one can ever be late.
- The kernel says by rtnetlink when the link goes; every send looks, which costs a system call that finds nothing.

python-can itself asks for error frames and kernel stamps, has the kernel filter, and leaves out our own frames and the
CAN FD frames of others.
"""

from __future__ import annotations

import errno
import socket
import struct
import time
from dataclasses import dataclass
from typing import Any

import can
from can.interfaces.socketcan.socketcan import SocketcanBus, create_socket
from can.typechecking import CanFilters
from pyroute2 import IPRoute, NetlinkError
from pyroute2.netlink.rtnl import RTM_DELLINK, RTMGRP_LINK
from pyroute2.netlink.rtnl.ifinfmsg import IFF_LOWER_UP, IFF_UP, ifinfmsg

SO_MEMINFO = 55
"""asm-generic/socket.h; the kernel answers with u32 of linux/sock_diag.h, of which the third is `WMEM_ALLOC`."""
MEMINFO = struct.Struct("3I")
LARGEST_NETLINK_MESSAGE = 1 << 16
QUEUE_PATIENCE_S = 0.002
"""How long a command waits for the one before it, which a driver may take up in a thread of its own."""
CAN_KINDS = frozenset({"can", "vcan", "vxcan"})


class LinkError(OSError):
    """An interface that can't be used as it is; the message says what to do."""

    def __str__(self) -> str:
        """Return the message without the system's number."""
        return str(self.strerror)


@dataclass(frozen=True, slots=True)
class Link:
    """What the kernel knows of a CAN interface.

    kind : can, vcan... bitrate : bit/s, None when it has none (vcan). restart_ms : after how long the kernel restarts a
    controller that is bus-off, 0 for never. state : ERROR_ACTIVE, ERROR_WARNING, ERROR_PASSIVE, BUS_OFF..., "" unknown.
    """

    name: str
    index: int
    kind: str
    is_up: bool
    has_carrier: bool
    bitrate: int | None = None
    restart_ms: int = 0
    state: str = ""

    @classmethod
    def read(cls, name: str) -> Link:
        """Ask the kernel. Raises LinkError when there is no such interface."""
        try:
            with IPRoute() as route:
                (answer,) = route.link("get", ifname=name)
        except (NetlinkError, ValueError):
            raise LinkError(errno.ENODEV, f"there is no interface {name}") from None
        return cls.of(name, answer)

    @classmethod
    def of(cls, name: str, answer: Any) -> Link:
        """From a message of rtnetlink."""

        def detail(*keys: str) -> Any:
            return answer.get(("linkinfo", "data", *keys))

        timing = detail("can_bittiming")
        return cls(
            name,
            answer["index"],
            answer.get(("linkinfo", "kind")) or "",
            bool(answer["flags"] & IFF_UP),
            bool(answer["flags"] & IFF_LOWER_UP),
            (timing["bitrate"] or None) if timing else None,
            detail("can_restart_ms") or 0,
            detail("can_state") or "",
        )

    def require(self, bitrate: int) -> None:
        """Raise LinkError when no run may begin on it. bitrate : bit/s, checked where the kernel knows it."""
        bring_up = f"ip link set {self.name} up" + (f" type can bitrate {bitrate}" if self.kind == "can" else "")
        if self.kind not in CAN_KINDS:
            raise LinkError(errno.EINVAL, f"{self.name} is no CAN interface")
        if not self.is_up:
            raise LinkError(errno.ENETDOWN, f"{self.name} is down; as root: {bring_up}")
        if self.bitrate not in (None, bitrate):
            reset = f"ip link set {self.name} down; {bring_up}"
            raise LinkError(errno.EINVAL, f"{self.name} runs at {self.bitrate} bit/s; as root: {reset}")
        if self.state == "BUS_OFF":
            restart = f"ip link set {self.name} type can restart"
            raise LinkError(errno.ENETDOWN, f"{self.name} is bus-off; mend the bus, then as root: {restart}")

    def warnings(self) -> tuple[str, ...]:
        """What a run may begin with, and the user should know."""
        said = []
        if self.restart_ms:
            mend = f"ip link set {self.name} down; ip link set {self.name} type can restart-ms 0"
            said.append(
                f"{self.name}: the kernel restarts a controller that is bus-off after {self.restart_ms} ms by itself "
                f"(restart-ms); as root: {mend}"
            )
        if self.state in ("ERROR_WARNING", "ERROR_PASSIVE"):
            said.append(
                f"{self.name}: the CAN controller is {self.state.replace('_', '-').lower()} before anything is sent"
            )
        return tuple(said)


class LinkWatch:
    """Hears from the kernel when an interface goes: taken down, bus-off, unplugged. Looking costs a system call."""

    def __init__(self, name: str) -> None:
        """Listen, then ask how things stand, so that nothing is missed. Raises LinkError, there being no such link."""
        self._socket = socket.socket(
            socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC, socket.NETLINK_ROUTE
        )
        self._socket.bind((0, RTMGRP_LINK))
        self.failure = ""
        try:
            self.link = Link.read(name)
        except LinkError:
            self._socket.close()
            raise

    def look(self) -> str:
        """Why the link has failed since it was opened; "" when it has not."""
        while not self.failure:
            try:
                data = self._socket.recv(LARGEST_NETLINK_MESSAGE)
            except BlockingIOError:
                break
            except OSError as error:  # ENOBUFS: the kernel had more to say than we took in
                if error.errno != errno.ENOBUFS:
                    raise
                self.failure = self._ask()
                continue
            message = ifinfmsg(data)
            message.decode()
            if message["index"] == self.link.index:
                self.failure = self._judge(message)
        return self.failure

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()

    def _ask(self) -> str:
        try:
            return self._fault(Link.read(self.link.name))
        except LinkError as error:
            return str(error)

    def _judge(self, message: Any) -> str:
        if message["header"]["type"] == RTM_DELLINK:
            return f"{self.link.name} is gone"
        return self._fault(Link.of(self.link.name, message))

    def _fault(self, link: Link) -> str:
        if link.index != self.link.index:
            return f"{link.name} is another interface now"
        if not link.is_up:
            return f"{link.name} was taken down"
        if not link.has_carrier:
            return f"{link.name} is off the bus ({link.state or 'no carrier'})"
        return ""


class SocketCan(SocketcanBus):
    """One interface. Raises LinkError and OSError at the start, can.CanError and OSError later.

    has_arrival_stamps : messages bear the wall-clock time at which the kernel took them in.
    """

    has_arrival_stamps = True

    def __init__(self, channel: str, bitrate: int, filters: CanFilters) -> None:
        create_socket().close()  # a kernel without AF_CAN says so, rather than that it lacks an interface
        self._watch = LinkWatch(channel)
        self.warnings = self._watch.link.warnings()
        try:
            self._watch.link.require(bitrate)
            super().__init__(channel, receive_own_messages=False, can_filters=filters)
        except BaseException:
            self._watch.close()
            raise

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame that passes the filters, or None after timeout seconds (None: waits).

        python-can's own counts them on the wall clock, and would wait for the hour by which that is set back.
        """
        end_s = None if timeout is None else time.monotonic() + timeout
        left_s = timeout
        while True:
            message, is_filtered = self._recv_internal(left_s)
            if message is not None and (is_filtered or self._matches_filters(message)):
                return message
            if end_s is not None:
                left_s = end_s - time.monotonic()
                if left_s <= 0.0:
                    return None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send now or not at all: the link must be there and our last frame out of the kernel's queue."""
        del timeout
        failure = self._watch.look()
        if failure:
            raise LinkError(errno.ENETDOWN, failure)
        if self._queued_bytes():
            time.sleep(QUEUE_PATIENCE_S)
        if self._queued_bytes():
            raise OSError(errno.ENOBUFS, "the last command still waits in the kernel")
        super().send(msg, timeout=0)

    def shutdown(self) -> None:
        """Close both sockets."""
        self._watch.close()
        super().shutdown()

    def _queued_bytes(self) -> int:
        """What of ours no driver has taken yet."""
        *_, waiting = MEMINFO.unpack(self.socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size))
        return int(waiting)
