"""The contract of the wire: what a frame of ours looks like, read from the DBC.

`Contract.from_dbc(text)` refuses a DBC that lacks a frame, a signal or an attribute that the controller lives on.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import cantools
from cantools.database.can import Database, Message
from crccheck.crc import Crc8Autosar

SIGNALS = {
    "PumpCommand": ("Command1", "Command2", "Enable", "ClearTrip", "Counter", "Crc"),
    "PumpStatus": ("Applied1", "Applied2", "State", "TripCause", "Echo", "Counter", "Accepted", "Crc"),
    "LowerLevels": ("Level1", "Level2", "Status1", "Status2", "Counter", "Crc"),
    "UpperLevels": ("Level3", "Level4", "Status3", "Status4", "Counter", "Crc"),
    "PumpHeartbeat": ("State", "Counter", "BootCount", "Contract", "Crc"),
    "LevelHeartbeat": ("State", "Counter", "BootCount", "Contract", "Crc"),
}


class ContractError(ValueError):
    """A DBC that is not the bench's; the message says what is missing or wrong."""


Decoded = dict[str, float]


@dataclass(frozen=True)
class FrameSpec:
    """One frame of ours. decode : payload to signal values in units. ranges : (signal, lowest, highest) in units."""

    name: str
    frame_id: int
    length: int
    data_id: bytes
    ranges: tuple[tuple[str, float, float], ...]
    decode: Callable[[bytes], Decoded]
    message: Message


@dataclass(frozen=True)
class Contract:
    """All frames by name, and the fingerprint that nodes carry in their heartbeats."""

    frames: dict[str, FrameSpec]
    fingerprint: int

    @classmethod
    def from_dbc(cls, text: str) -> Contract:
        """Raises ContractError naming the frame, signal or attribute that is not as it must be."""
        try:
            database = cantools.database.load_string(text, database_format="dbc")
        except Exception as error:  # noqa: BLE001 - cantools raises its parser's own errors, of many kinds
            raise ContractError(f"is not a DBC: {str(error).splitlines()[0]}") from None
        if not isinstance(database, Database):
            raise ContractError("is not a CAN database")
        return cls({name: _spec(database, name) for name in SIGNALS}, fingerprint(text))

    @property
    def ids(self) -> tuple[int, ...]:
        """Identifiers of all frames of ours."""
        return tuple(spec.frame_id for spec in self.frames.values())


def fingerprint(text: str) -> int:
    """CRC-32 of the DBC, blind to line endings and to white space at the ends of lines."""
    return zlib.crc32("\n".join(line.rstrip() for line in text.splitlines()).encode())


def crc8(data: bytes | bytearray) -> int:
    """AUTOSAR 8H2F CRC over data: polynomial 0x2F, initial value and final XOR 0xFF."""
    register = 0xFF
    for byte in data:
        register = _TABLE[register ^ byte]
    return register ^ 0xFF


_TABLE = bytes(Crc8Autosar.calc(bytes((index ^ 0xFF,))) ^ 0xFF for index in range(256))


def _spec(database: Database, name: str) -> FrameSpec:
    try:
        message = database.get_message_by_name(name)
    except KeyError:
        raise ContractError(f"has no frame {name}") from None
    for signal in SIGNALS[name]:
        if signal not in message.signal_tree:
            raise ContractError(f"frame {name} has no signal {signal}")
    crc = message.get_signal_by_name("Crc")
    if message.is_extended_frame or (crc.start, crc.length) != (8 * (message.length - 1), 8):
        raise ContractError(f"frame {name} must have an 11-bit id and its Crc in the last byte")
    attributes = message.dbc.attributes if message.dbc is not None else {}
    if "DataId" not in attributes:
        raise ContractError(f"frame {name} has no attribute DataId")
    ranges = tuple(
        (s.name, float(s.minimum), float(s.maximum))
        for s in message.signals
        if s.minimum is not None and s.maximum is not None and not _covers(s.length, s.scale, s.maximum)
    )
    data_id = int(attributes["DataId"].value).to_bytes(2, "little")
    return FrameSpec(name, message.frame_id, message.length, data_id, ranges, _decoder(message), message)


def _covers(length: int, scale: float, maximum: float) -> bool:
    """Whether a signal's range is all that its bits can say, so that there is nothing to check."""
    return bool(float(maximum) >= (2**length - 1) * scale)


def _decoder(message: Message) -> Callable[[bytes], Decoded]:
    def decode(data: bytes) -> Decoded:
        return message.decode(data, decode_choices=False)  # type: ignore[return-value]

    return decode
