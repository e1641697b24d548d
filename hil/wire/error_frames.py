"""What an error frame reports: the classes of the kernel's include/uapi/linux/can/error.h, as text.

Class bits are in the identifier, details in the payload. A frame can have several classes.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

CONTROLLER = 0x4
"""Class bit for data[1]: the state of the CAN controller, and frames that it lost."""


class ErrorKind(StrEnum):
    """One thing that an error frame can report."""

    TX_TIMEOUT = "tx_timeout"
    LOST_ARBITRATION = "lost_arbitration"
    OVERFLOW = "overflow"
    WARNING = "error_warning"
    PASSIVE = "error_passive"
    ACTIVE = "error_active"
    PROTOCOL = "protocol_violation"
    TRANSCEIVER = "transceiver"
    NO_ACK = "no_ack"
    BUS_OFF = "bus_off"
    BUS_ERROR = "bus_error"
    RESTARTED = "restarted"
    OTHER = "other"


DESCRIPTIONS = {
    ErrorKind.TX_TIMEOUT: "a frame could not be sent in time",
    ErrorKind.LOST_ARBITRATION: "arbitration lost",
    ErrorKind.OVERFLOW: "the CAN controller has lost frames",
    ErrorKind.WARNING: "the CAN controller counts many errors",
    ErrorKind.PASSIVE: "the CAN controller is error-passive",
    ErrorKind.ACTIVE: "the CAN controller is error-active again",
    ErrorKind.PROTOCOL: "a frame broke the protocol",
    ErrorKind.TRANSCEIVER: "the transceiver reports a fault of the wires",
    ErrorKind.NO_ACK: "nobody acknowledges",
    ErrorKind.BUS_OFF: "the CAN controller is bus-off",
    ErrorKind.BUS_ERROR: "bus error",
    ErrorKind.RESTARTED: "the CAN controller was restarted",
    ErrorKind.OTHER: "an error frame of no known kind",
}
"""Text for messages."""

_CLASSES = {
    0x1: ErrorKind.TX_TIMEOUT,
    0x2: ErrorKind.LOST_ARBITRATION,
    0x8: ErrorKind.PROTOCOL,
    0x10: ErrorKind.TRANSCEIVER,
    0x20: ErrorKind.NO_ACK,
    0x40: ErrorKind.BUS_OFF,
    0x80: ErrorKind.BUS_ERROR,
    0x100: ErrorKind.RESTARTED,
}
_CONTROLLER = {0x03: ErrorKind.OVERFLOW, 0x0C: ErrorKind.WARNING, 0x30: ErrorKind.PASSIVE, 0x40: ErrorKind.ACTIVE}


def read(arbitration_id: int, data: Sequence[int]) -> tuple[ErrorKind, ...]:
    """Kinds that an error frame reports, at least `OTHER`. arbitration_id : its class bits. data : up to 8 bytes."""
    kinds = [kind for bit, kind in _CLASSES.items() if arbitration_id & bit]
    if arbitration_id & CONTROLLER and len(data) > 1:
        kinds += [kind for bits, kind in _CONTROLLER.items() if data[1] & bits]
    return tuple(kinds) or (ErrorKind.OTHER,)
