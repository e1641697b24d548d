"""The border to CAN: opens python-can's buses, catches and counts their errors.

A command is sent once or lost; nothing is queued here. Errors of a bus never reach the loop: the port counts them and,
when the link has failed, sets `is_up` to False, which trips the supervisor. See docs/decisions/0001-wire.md.
"""

from __future__ import annotations

import errno
from collections import Counter
from dataclasses import dataclass

import can
from can.typechecking import CanFilter

from hil.core.types import Event, Severity
from hil.edge.can import adapters
from hil.edge.can.adapters import BusError as BusError
from hil.edge.can.slcan_bus import SlcanBus
from hil.edge.host.clock import ArrivalClock
from hil.wire import error_frames, rejections
from hil.wire.error_frames import DESCRIPTIONS, ErrorKind

BUS_ERRORS = (can.CanError, OSError, ValueError, IndexError)
"""What python-can's interfaces raise for a bad line, a lost adapter, a full queue."""

LINK_GONE = frozenset({errno.ENETDOWN, errno.ENODEV, errno.ENXIO})
"""Errors of an interface that was taken down or unplugged; the port sends nothing more."""

SEND_FAILURES_IN_A_ROW = 3
MAX_BATCH = 1000


@dataclass(frozen=True, slots=True)
class BusAddress:
    """A bus, named as in python-can: interface, channel, bit/s. Raises BusError for an unknown interface."""

    interface: str
    channel: str
    bitrate: int

    def __post_init__(self) -> None:
        adapters.find(self.interface)

    def open(self, ids: tuple[int, ...]) -> can.BusABC:
        """Open it. Let through frames with these identifiers only, and none of our own.

        Configuration files and variables of python-can are not read. Raises BusError.
        """
        filters: list[CanFilter] = [{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in ids]
        adapter = adapters.find(self.interface)
        try:
            return adapter.open(self.channel, self.bitrate, filters)
        except (*BUS_ERRORS, NotImplementedError, TypeError) as error:
            hint = adapter.hint(error)
            raise BusError(
                f"bus {self.interface} {self.channel!r} at {self.bitrate} bit/s can't be opened: {error}"
                + (f" ({hint})" if hint else "")
            ) from None


class BusPort:
    """An open bus as the control loop uses it. `is_up` becomes False when the link fails, and stays False."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._failed_sends = 0
        self.send_failures = 0
        self.receive_failures = 0
        self.is_up = True
        self.last_error = ""
        self.bus_errors: Counter[str] = Counter()
        self._arrival = ArrivalClock() if getattr(bus, "has_arrival_stamps", False) else None
        self._events = [Event(Severity.WARNING, "bus_setting", text) for text in getattr(bus, "warnings", ())]

    @property
    def line_counts(self) -> dict[str, int]:
        """Commands that an slcan adapter refused, and what was dropped, by cause; empty for other buses."""
        return self._bus.counts if isinstance(self._bus, SlcanBus) else {}

    @property
    def lines_rejected(self) -> str:
        """`line_counts` in words, for messages; "" while all counts are zero."""
        if not isinstance(self._bus, SlcanBus) or not self._bus.has_counted:
            return ""
        return rejections.lines_rejected(self._bus.counts)

    def receive(self, timeout_s: float) -> can.Message | None:
        """The next frame, or None after timeout_s or a failure."""
        try:
            message = self._bus.recv(timeout_s)
        except BUS_ERRORS as error:
            self.receive_failures += 1
            self.is_up = False
            self.last_error = str(error)
            return None
        if message is not None and message.is_error_frame:
            self._note_error_frame(message)
        return message

    def waiting(self) -> list[can.Message]:
        """The frames that have arrived, at most MAX_BATCH, so that a babbling node can't delay a step."""
        messages: list[can.Message] = []
        while len(messages) < MAX_BATCH and (message := self.receive(0.0)) is not None:
            messages.append(message)
        return messages

    def send(
        self, frame_id: int, data: bytes, timestamp_s: float, *, is_extended: bool = False, is_remote: bool = False
    ) -> bool:
        """Send one frame now or not at all; return whether it was sent. A remote frame has no data, only its length."""
        message = can.Message(
            timestamp_s,
            frame_id,
            is_extended_id=is_extended,
            is_remote_frame=is_remote,
            dlc=len(data),
            data=None if is_remote else data,
            is_rx=False,
        )
        try:
            self._bus.send(message, timeout=0)
        except BUS_ERRORS as error:
            self.send_failures += 1
            self._failed_sends += 1
            self.last_error = str(error)
            if self._failed_sends >= SEND_FAILURES_IN_A_ROW or _number(error) in LINK_GONE:
                self.is_up = False
            return False
        self._failed_sends = 0
        return True

    def arrived_ns(self, message: can.Message, now_ns: int) -> int:
        """When a frame arrived, on the monotonic clock: the kernel's time stamp if there is one, else now."""
        return now_ns if self._arrival is None else self._arrival.arrived_ns(message.timestamp, now_ns)

    def take_events(self) -> list[Event]:
        """Events of the bus since the last call: warnings about its settings at first, then each kind of error once."""
        events, self._events = self._events, []
        return events

    def close(self) -> None:
        """Shut the bus down; an error of a link that has already failed is ignored."""
        try:
            self._bus.shutdown()
        except BUS_ERRORS as error:
            self.last_error = str(error)

    def _note_error_frame(self, message: can.Message) -> None:
        """Count the kinds of an error frame; add an event for each new kind. Bus-off means that the link has failed."""
        for kind in error_frames.read(message.arbitration_id, message.data):
            if kind not in self.bus_errors:
                self._events.append(Event(Severity.WARNING, "bus_error", DESCRIPTIONS[kind], {"kind": kind.value}))
            self.bus_errors[kind] += 1
            self.last_error = DESCRIPTIONS[kind]
            if kind is ErrorKind.BUS_OFF:
                self.is_up = False
                return


def _number(error: Exception) -> int | None:
    """The system's error number (errno), if there is one."""
    return getattr(error, "error_code", None) or getattr(error, "errno", None)
