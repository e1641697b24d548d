"""The kernel's CAN interfaces, by python-can, with three checks that a controller needs in addition.

- An interface that is missing, down, bus-off or of another bit rate is refused before anything is sent.
- A command is refused while the one before it still waits in the kernel, so that at most one command can be late.
- The kernel reports by rtnetlink when the link fails; each send checks this with one system call.

python-can requests error frames and the kernel's time stamps, lets the kernel filter, and leaves out frames of this
program and CAN FD frames. See docs/decisions/0013-socketcan.md.
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
"""asm-generic/socket.h; the kernel answers with u32 values (linux/sock_diag.h), the third is `WMEM_ALLOC`."""
MEMINFO = struct.Struct("3I")
MAX_NETLINK_BYTES = 1 << 16
QUEUE_WAIT_S = 0.002
"""How long a command waits for the one before it: some drivers send in a thread of their own."""
CAN_KINDS = frozenset({"can", "vcan", "vxcan"})


class LinkError(OSError):
    """An interface that can't be used in its present state; the message says what to do."""

    def __str__(self) -> str:
        """Return the message without the system's number."""
        return str(self.strerror)


@dataclass(frozen=True, slots=True)
class Link:
    """State of a CAN interface in the kernel.

    kind : can, vcan... bitrate : bit/s; None if it has none (vcan). restart_ms : time after which the kernel restarts a
    controller that is bus-off; 0 for never. state : ERROR_ACTIVE, ERROR_WARNING, ERROR_PASSIVE, BUS_OFF...; or "".
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
        """Ask the kernel. Raises LinkError if there is no such interface."""
        try:
            with IPRoute() as route:
                (answer,) = route.link("get", ifname=name)
        except (NetlinkError, ValueError):
            raise LinkError(errno.ENODEV, f"there is no interface {name}") from None
        return cls.of(name, answer)

    @classmethod
    def of(cls, name: str, answer: Any) -> Link:
        """From an rtnetlink message."""

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
        """Raise LinkError if no run may begin on it. bitrate : bit/s, checked if the kernel knows it."""
        bring_up = f"ip link set {self.name} up" + (f" type can bitrate {bitrate}" if self.kind == "can" else "")
        if self.kind not in CAN_KINDS:
            raise LinkError(errno.EINVAL, f"{self.name} is not a CAN interface")
        if not self.is_up:
            raise LinkError(errno.ENETDOWN, f"{self.name} is down; as root: {bring_up}")
        if self.bitrate not in (None, bitrate):
            reset = f"ip link set {self.name} down; {bring_up}"
            raise LinkError(errno.EINVAL, f"{self.name} runs at {self.bitrate} bit/s; as root: {reset}")
        if self.state == "BUS_OFF":
            restart = f"ip link set {self.name} type can restart"
            raise LinkError(errno.ENETDOWN, f"{self.name} is bus-off; fix the bus, then as root: {restart}")

    def warnings(self) -> tuple[str, ...]:
        """States in which a run may begin, but that the user should know."""
        texts = []
        if self.restart_ms:
            fix = f"ip link set {self.name} down; ip link set {self.name} type can restart-ms 0"
            texts.append(
                f"{self.name}: the kernel restarts a bus-off controller automatically after {self.restart_ms} ms "
                f"(restart-ms); as root: {fix}"
            )
        if self.state in ("ERROR_WARNING", "ERROR_PASSIVE"):
            texts.append(
                f"{self.name}: the CAN controller is {self.state.replace('_', '-').lower()} before anything is sent"
            )
        return tuple(texts)


class LinkWatch:
    """Receives from the kernel that an interface fails: taken down, bus-off, unplugged. A check is one system call."""

    def __init__(self, name: str) -> None:
        """Subscribe first, then read the state, so that no change is missed. Raises LinkError if there is none."""
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

    def check(self) -> str:
        """Why the link has failed since it was opened; "" if it has not."""
        while not self.failure:
            try:
                data = self._socket.recv(MAX_NETLINK_BYTES)
            except BlockingIOError:
                break
            except OSError as error:  # ENOBUFS: messages of the kernel were lost
                if error.errno != errno.ENOBUFS:
                    raise
                self.failure = self._read_again()
                continue
            message = ifinfmsg(data)
            message.decode()
            if message["index"] == self.link.index:
                self.failure = self._judge(message)
        return self.failure

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _read_again(self) -> str:
        try:
            return self._fault(Link.read(self.link.name))
        except LinkError as error:
            return str(error)

    def _judge(self, message: Any) -> str:
        if message["header"]["type"] == RTM_DELLINK:
            return f"{self.link.name} was removed"
        return self._fault(Link.of(self.link.name, message))

    def _fault(self, link: Link) -> str:
        if link.index != self.link.index:
            return f"{link.name} was replaced by another interface"
        if not link.is_up:
            return f"{link.name} was taken down"
        if not link.has_carrier:
            return f"{link.name} is off the bus ({link.state or 'no carrier'})"
        return ""


class SocketCan(SocketcanBus):
    """One interface. Raises LinkError and OSError when it is opened, can.CanError and OSError later.

    has_arrival_stamps : messages have the wall-clock time at which the kernel received them.
    """

    has_arrival_stamps = True

    def __init__(self, channel: str, bitrate: int, filters: CanFilters) -> None:
        create_socket().close()  # reports a kernel without AF_CAN before a missing interface
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

        python-can's own method uses the wall clock, and would wait an hour longer when that is set back by an hour.
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
        """Send now or not at all. The link must be up, and the frame before must have left the kernel's queue."""
        del timeout
        failure = self._watch.check()
        if failure:
            raise LinkError(errno.ENETDOWN, failure)
        if self._queued_bytes():
            time.sleep(QUEUE_WAIT_S)
        if self._queued_bytes():
            raise OSError(errno.ENOBUFS, "the last command still waits in the kernel")
        super().send(msg, timeout=0)

    def shutdown(self) -> None:
        """Close both sockets."""
        self._watch.close()
        super().shutdown()

    def _queued_bytes(self) -> int:
        """Bytes of this socket that no driver has accepted yet."""
        *_, waiting = MEMINFO.unpack(self.socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size))
        return int(waiting)
