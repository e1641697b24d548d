"""The checks of a frame before it is used: kind, length, CRC, counter, range. Refusals are counted by cause.

The counter increases by one from frame to frame of an identifier. Its difference to that of the last accepted frame:
    0          the same frame again: refused          1..8   accepted; each step after the first is a lost frame
    9..15      an older frame: refused                any, after 150 ms without an accepted frame: accepted

Only a frame whose counter has changed ends a run of refusals: of a sender whose counter does not change, one frame is
accepted after each silence, but the run goes on. See docs/decisions/0001-wire.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from hil.wire.contract import Decoded, FrameSpec, crc8

RESYNCHRONISE_NS = 150_000_000
MAX_COUNTER_STEP = 8


class Frame(Protocol):
    """The fields of a frame that are checked; python-can's Message has them."""

    arbitration_id: int
    data: bytearray
    is_extended_id: bool
    is_remote_frame: bool
    is_error_frame: bool
    is_fd: bool


def is_plain(frame: Frame) -> bool:
    """Whether it is a classic data frame with an 11-bit identifier, as all frames of the bench are."""
    return not (frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame or frame.is_fd)


class Rejection(StrEnum):
    """Why a frame was refused."""

    ERROR_FRAME = "error_frame"
    KIND = "kind"
    UNKNOWN_ID = "unknown_id"
    LENGTH = "length"
    CRC = "crc"
    DUPLICATE = "duplicate"
    OLD = "old"
    RANGE = "range"


@dataclass(slots=True)
class FrameCheck:
    """The checks of one identifier, with the counter and time of the last frame accepted.

    refused_run : number of consecutive frames that were refused or whose counter did not change.
    """

    spec: FrameSpec
    counter: int = -1
    accepted_ns: int = 0
    lost: int = 0
    refused_run: int = 0

    def admit(self, frame: Frame, received_ns: int) -> Decoded | Rejection:
        """The frame's values in their units, or why it is refused; then only the run of refusals gets longer."""
        if not is_plain(frame):
            return Rejection.KIND  # not sent by this node
        values = self._checked(frame, received_ns)
        if isinstance(values, Rejection):
            self.refused_run += 1
        return values

    def _checked(self, frame: Frame, received_ns: int) -> Decoded | Rejection:
        spec = self.spec
        data = bytes(frame.data)
        if len(data) != spec.length:
            return Rejection.LENGTH
        if crc8(data[:-1], spec.crc_start) != data[-1]:
            return Rejection.CRC
        values = spec.decode(data)
        if values is None:
            return Rejection.RANGE
        counter = int(values["Counter"])
        step = (counter - self.counter) % 16 if self.counter >= 0 else 1
        if received_ns - self.accepted_ns <= RESYNCHRONISE_NS:
            if not 1 <= step <= MAX_COUNTER_STEP:
                return Rejection.DUPLICATE if step == 0 else Rejection.OLD
            self.lost += step - 1
        self.refused_run = 0 if step else self.refused_run + 1
        self.counter = counter
        self.accepted_ns = received_ns
        return values
