"""The edge to CAN: python-can's buses, their errors caught and counted.

A command goes out once or is lost; nothing is queued here. What a bus raises never reaches the loop: the port counts
it and, when the link is gone, says so in `is_up`, which trips the supervisor.
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
from hil.wire.error_frames import WORDS, ErrorKind

BUS_ERRORS = (can.CanError, OSError, ValueError, IndexError)
"""What python-can's interfaces raise on a bad line, a lost adapter, a full queue."""

LINK_GONE = frozenset({errno.ENETDOWN, errno.ENODEV, errno.ENXIO})
"""Errors of an interface that was taken down or unplugged; no further send is tried."""

SEND_FAILURES_IN_A_ROW = 3
LARGEST_BATCH = 1000


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
    """An open bus as the control loop sees it. `is_up` turns false when the link fails, and stays so."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._failed_sends = 0
        self.send_failures = 0
        self.receive_failures = 0
        self.is_up = True
        self.last_error = ""
        self.bus_errors: Counter[str] = Counter()
        self._arrival = ArrivalClock() if getattr(bus, "has_arrival_stamps", False) else None
        self._news = [Event(Severity.WARNING, "bus_setting", text) for text in getattr(bus, "warnings", ())]

    @property
    def line_counts(self) -> dict[str, int]:
        """What an slcan adapter has refused and we have dropped, by cause; empty on other buses."""
        return self._bus.counts if isinstance(self._bus, SlcanBus) else {}

    @property
    def lines_rejected(self) -> str:
        """The same in words; "" for nothing. Cheap as long as there is nothing to say."""
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
        """What has arrived so far; bounded, so that a babbling node can't hold a step up."""
        messages: list[can.Message] = []
        while len(messages) < LARGEST_BATCH and (message := self.receive(0.0)) is not None:
            messages.append(message)
        return messages

    def send(
        self, frame_id: int, data: bytes, timestamp_s: float, *, is_extended: bool = False, is_remote: bool = False
    ) -> bool:
        """Send one frame now or not at all; whether it went out. A remote frame keeps the length of data only."""
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
        """When a frame came, on the monotonic clock: the kernel's stamp where there is one, else now."""
        return now_ns if self._arrival is None else self._arrival.arrived_ns(message.timestamp, now_ns)

    def news(self) -> list[Event]:
        """What the bus has to say since the last call: its settings at first, then each kind of error once."""
        news, self._news = self._news, []
        return news

    def close(self) -> None:
        """Shut the bus down; a link that is gone already is no news."""
        try:
            self._bus.shutdown()
        except BUS_ERRORS as error:
            self.last_error = str(error)

    def _note_error_frame(self, message: can.Message) -> None:
        """Count what an error frame says, tell each kind once; a controller that is bus-off is a link that is gone."""
        for kind in error_frames.read(message.arbitration_id, message.data):
            if kind not in self.bus_errors:
                self._news.append(Event(Severity.WARNING, "bus_error", WORDS[kind], {"kind": kind.value}))
            self.bus_errors[kind] += 1
            self.last_error = WORDS[kind]
            if kind is ErrorKind.BUS_OFF:
                self.is_up = False
                return  # nothing else matters more


def _number(error: Exception) -> int | None:
    """The system's number of an error, if it has one."""
    return getattr(error, "error_code", None) or getattr(error, "errno", None)
