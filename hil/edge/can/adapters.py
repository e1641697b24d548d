"""The table of CAN interfaces: by name, what the channel is, what is needed, how to open it, what to do about errors.

It feeds the check of `bus.interface` in rig.toml, the help of `-i` and `-c`, error messages, docs/how-to/real-bus.md.
The names are python-can's. Its other interfaces can be used too; python-can opens those itself.
Background: docs/decisions/0012-slcan-of-our-own.md and 0013-socketcan.md.

Nothing here imports python-can or a driver before a bus is opened or an unknown name is looked up.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from hil.core.errors import HilError

if TYPE_CHECKING:
    import can
    from can.typechecking import CanFilters

Opener = Callable[[str, int, "CanFilters"], "can.BusABC"]
"""Opens (channel, bit rate in bit/s, filters); raises what python-can, the driver or the system raise."""


class BusError(HilError):
    """A bus that can't be opened; the message says which and why."""


@dataclass(frozen=True)
class Adapter:
    """A row of the table.

    channel : what `-c` may be. needs : what must be there before it can be opened. hints : what to do, by the number of
    the system's error (errno). default_hint : for all other errors. has_kernel_link : whether the channel is a network
    interface of the kernel, whose state can be read.
    """

    channel: str
    needs: str
    open: Opener
    hints: Mapping[int, str] = field(default_factory=dict)
    default_hint: str = ""
    has_kernel_link: bool = False

    def hint(self, error: Exception) -> str:
        """What to do about an error of `open`, or ""."""
        number = getattr(error, "errno", None) or getattr(error, "error_code", None)
        return self.hints.get(number, self.default_hint) if isinstance(number, int) else self.default_hint


def _open_socketcan(channel: str, bitrate: int, filters: CanFilters) -> can.BusABC:
    from hil.edge.can.socketcan import SocketCan  # needs netlink

    return SocketCan(channel, bitrate, filters)


def _open_slcan(channel: str, bitrate: int, filters: CanFilters) -> can.BusABC:
    from hil.edge.can.slcan_bus import SlcanBus  # needs a serial driver

    return SlcanBus(channel, bitrate, filters)


def _open_virtual(channel: str, bitrate: int, filters: CanFilters) -> can.BusABC:
    import can

    del bitrate  # a virtual bus has none
    return can.Bus(
        interface="virtual",
        channel=channel,
        can_filters=filters,
        receive_own_messages=False,
        ignore_config=True,
    )


def _open_with_python_can(interface: str, channel: str, bitrate: int, filters: CanFilters) -> can.BusABC:
    import can

    try:
        return can.Bus(
            interface=interface,
            channel=channel,
            bitrate=bitrate,
            can_filters=filters,
            receive_own_messages=False,
            ignore_config=True,
        )
    except Exception as error:  # noqa: BLE001 - without their driver these raise errors of every kind
        raise can.CanInitializationError(f"{type(error).__name__}: {error}") from None


ADAPTERS: dict[str, Adapter] = {
    "socketcan": Adapter(
        channel="can0 or another CAN interface of the kernel",
        needs="a kernel with SocketCAN; the interface up, at the bit rate",
        open=_open_socketcan,
        hints={
            errno.EAFNOSUPPORT: "this kernel has no SocketCAN",
            errno.EPROTONOSUPPORT: "load the kernel's module: modprobe can_raw",
            errno.EPERM: "your user may not open CAN sockets",
        },
        has_kernel_link=True,
    ),
    "slcan": Adapter(
        channel="/dev/ttyACM0 or another serial device (with @BAUD if not 115200), or socket://HOST:PORT",
        needs="read and write access to the device (group dialout); no slcand or other program on it",
        open=_open_slcan,
        hints={
            errno.EACCES: "add your user to the group that owns the device (dialout) and log in again",
            errno.ENOENT: "is the adapter plugged in? /dev/serial/by-id lists serial devices; "
            "can0 and other CAN interfaces of the kernel need -i socketcan",
            errno.ENOTTY: "it is no serial device; /dev/serial/by-id lists them",
            errno.EAGAIN: "stop the other program that uses the device",
            errno.EBUSY: "stop the other program that uses the device",
            errno.ECONNREFUSED: "no program listens on this TCP port; start it first (firmware-sim --slcan PORT)",
        },
    ),
    "virtual": Adapter(
        channel="any name",
        needs="nothing; it connects buses within one process only",
        open=_open_virtual,
    ),
}
"""Name of the interface -> its row."""


def find(interface: str) -> Adapter:
    """The row of an interface; one made for it if only python-can knows it. Raises BusError for an unknown name."""
    if interface in ADAPTERS:
        return ADAPTERS[interface]
    others = _others()
    if interface not in others:
        raise BusError(f"bus interface {interface!r} is unknown: use {known()}; or, by python-can, {', '.join(others)}")
    return Adapter(
        channel="as python-can's documentation of this interface says",
        needs="the driver that python-can needs for it",
        open=partial(_open_with_python_can, interface),
        default_hint=f"see python-can's documentation of {interface} for its driver and channel",
    )


def known() -> str:
    """The names in the table, for help and messages."""
    return ", ".join(ADAPTERS)


def channels() -> str:
    """What a channel may be, for each interface in the table."""
    return "; ".join(f"{name}: {adapter.channel}" for name, adapter in ADAPTERS.items())


def _others() -> list[str]:
    """Interfaces that only python-can knows."""
    from can.interfaces import VALID_INTERFACES

    return sorted(name for name in VALID_INTERFACES if name not in ADAPTERS)
