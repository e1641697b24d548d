"""The contract of the wire: the layout of the bench's frames, read from the DBC.

`Contract.from_dbc(text)` refuses a DBC without a frame, signal or attribute that the controller needs. See
docs/decisions/0001-wire.md and 0002-codec-from-the-dbc.md.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property

import cantools
from cantools.database.can import Database, Signal
from crccheck.crc import Crc8Autosar

SIGNALS = {
    "PumpCommand": ("Command1", "Command2", "Enable", "ClearTrip", "StartPhase", "Counter", "Crc"),
    "PumpStatus": ("Applied1", "Applied2", "State", "TripCause", "Echo", "Counter", "Accepted", "Crc"),
    "LowerLevels": ("Level1", "Level2", "Status1", "Status2", "Counter", "Crc"),
    "UpperLevels": ("Level3", "Level4", "Status3", "Status4", "Counter", "Crc"),
    "PumpHeartbeat": ("State", "Counter", "BootCount", "Contract", "Crc"),
    "LevelHeartbeat": ("State", "Counter", "BootCount", "Contract", "Crc"),
}

COUNTS = {"Counter": 15, "Echo": 15, "Accepted": 255, "State": 3, "Contract": 2**32 - 1, "Crc": 255}
"""Highest values of signals with a fixed meaning, which the counter rules and the state machines rely on."""


class ContractError(ValueError):
    """A DBC that does not fit the bench; the message says what is missing or wrong."""


Decoded = dict[str, float]


@dataclass(frozen=True, slots=True)
class SignalLayout:
    """An unsigned little-endian signal: (payload >> shift & mask) * scale, valid up to highest (a raw value)."""

    name: str
    shift: int
    mask: int
    scale: float
    highest: int


@dataclass(frozen=True)
class FrameSpec:
    """One frame of the bench. crc_start : the CRC register after its data id. cycle_s : 0 if it is not periodic."""

    name: str
    frame_id: int
    length: int
    crc_start: int
    signals: tuple[SignalLayout, ...]
    cycle_s: float = 0.0

    def decode(self, data: bytes) -> Decoded | None:
        """Payload to signal values in their units; None if one is out of its range.

        The same as cantools' decode (a test compares them), in half its time; it is called for every frame.
        """
        payload = int.from_bytes(data, "little")
        values: Decoded = {}
        for name, shift, mask, scale, highest in self._rows:
            raw = payload >> shift & mask
            if raw > highest:
                return None
            values[name] = raw * scale
        return values

    def encode(self, values: Decoded) -> bytes:
        """Signal values in units (Crc left out) to a payload with its CRC; the same as cantools' encode.

        Raises ValueError for a value outside the signal's range.
        """
        payload = 0
        for name, shift, _, scale, highest in self._rows:
            if name == "Crc":
                continue
            raw = round(values[name] / scale)
            if not 0 <= raw <= highest:
                raise ValueError(f"{self.name}.{name} {values[name]!r} is outside 0..{highest * scale:g}")
            payload |= raw << shift
        body = payload.to_bytes(self.length, "little")[:-1]
        return body + bytes((crc8(body, self.crc_start),))

    @cached_property
    def _rows(self) -> tuple[tuple[str, int, int, float, int], ...]:
        return tuple((s.name, s.shift, s.mask, s.scale, s.highest) for s in self.signals)


@dataclass(frozen=True)
class Contract:
    """All frames by name, and the fingerprint that nodes carry in their heartbeats."""

    frames: dict[str, FrameSpec]
    fingerprint: int

    @classmethod
    def from_dbc(cls, text: str) -> Contract:
        """Read a DBC. Raises ContractError, which names the frame, signal or attribute that is wrong."""
        try:
            database = cantools.database.load_string(text, database_format="dbc")
        except Exception as error:  # noqa: BLE001 - cantools raises its parser's own errors, of many kinds
            raise ContractError(f"is not a DBC: {str(error).splitlines()[0]}") from None
        if not isinstance(database, Database):
            raise ContractError("is not a CAN database")
        return cls({name: _spec(database, name) for name in SIGNALS}, fingerprint(text))

    @property
    def ids(self) -> tuple[int, ...]:
        """Identifiers of all frames of the bench."""
        return tuple(spec.frame_id for spec in self.frames.values())


def fingerprint(text: str) -> int:
    """CRC-32 of the DBC without line ends and white space at the ends of lines."""
    return zlib.crc32("\n".join(line.rstrip() for line in text.splitlines()).encode())


def crc8(data: bytes | bytearray, start: int = 0xFF) -> int:
    """AUTOSAR 8H2F CRC over data: polynomial 0x2F, initial value and final XOR 0xFF.

    start : the first value of the register; for a frame's payload `crc_start(data_id)`.
    """
    table, register = _TABLE, start
    if len(data) == 6:  # the levels, seven frames of ten: without a loop
        a, b, c, d, e, f = data
        return table[table[table[table[table[table[register ^ a] ^ b] ^ c] ^ d] ^ e] ^ f] ^ 0xFF
    for byte in data:
        register = table[register ^ byte]
    return register ^ 0xFF


def crc_start(data_id: int) -> int:
    """The register after a frame's data id, low byte first."""
    return crc8(data_id.to_bytes(2, "little")) ^ 0xFF


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
    data_id = attributes["DataId"].value
    if not isinstance(data_id, int) or not 0 <= data_id <= 0xFFFF:
        raise ContractError(f"frame {name} has DataId {data_id!r}, must be 0..65535")
    signals = tuple(_layout(name, signal) for signal in message.signals if signal.name in SIGNALS[name])
    cycle_s = (message.cycle_time or 0) * 1e-3
    return FrameSpec(name, message.frame_id, message.length, crc_start(data_id), signals, cycle_s)


def _layout(frame: str, signal: Signal) -> SignalLayout:
    if signal.byte_order != "little_endian" or signal.is_signed or signal.is_float or signal.offset != 0:
        raise ContractError(f"signal {signal.name} of {frame} must be little-endian, unsigned and without offset")
    if signal.start < 0:
        raise ContractError(f"signal {signal.name} of {frame} must start at bit 0 or later")
    if signal.scale <= 0:
        raise ContractError(f"signal {signal.name} of {frame} must have a scale above 0")
    if signal.minimum not in (None, 0):
        raise ContractError(f"signal {signal.name} of {frame} must start at 0")
    mask = 2**signal.length - 1
    highest = mask if signal.maximum is None else min(mask, round(float(signal.maximum) / float(signal.scale)))
    if signal.name in COUNTS and (highest, signal.scale) != (COUNTS[signal.name], 1):
        raise ContractError(f"signal {signal.name} of {frame} must count 0..{COUNTS[signal.name]}")
    return SignalLayout(signal.name, signal.start, mask, float(signal.scale), highest)
