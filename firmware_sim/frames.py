"""The frames of config/bench.dbc as a node's firmware handles them: fixed layouts, a CRC table, own checks.

All frames are classic CAN with 11-bit identifiers, little endian. The last byte is a CRC-8 with polynomial
0x2F, initial value and final XOR 0xFF (AUTOSAR's 8H2F), over DataId (low, high byte) and the payload before it.
Voltages travel as whole multiples of 0.2 mV.
"""

import struct
import zlib
from dataclasses import dataclass
from enum import Enum, IntEnum

from can import Message

COMMAND_ID = 0x201
STATUS_ID = 0x181
LOWER_LEVELS_ID = 0x182
UPPER_LEVELS_ID = 0x282
PUMP_HEARTBEAT_ID = 0x701
LEVEL_HEARTBEAT_ID = 0x702

DATA_IDS = {
    COMMAND_ID: 10497,
    STATUS_ID: 10625,
    LOWER_LEVELS_ID: 10370,
    UPPER_LEVELS_ID: 10882,
    PUMP_HEARTBEAT_ID: 12033,
    LEVEL_HEARTBEAT_ID: 12034,
}

FRAME_IDS = {
    "PumpCommand": COMMAND_ID,
    "PumpStatus": STATUS_ID,
    "LowerLevels": LOWER_LEVELS_ID,
    "UpperLevels": UPPER_LEVELS_ID,
    "PumpHeartbeat": PUMP_HEARTBEAT_ID,
    "LevelHeartbeat": LEVEL_HEARTBEAT_ID,
}

# Byte of a frame's counter, and by how many bits it is shifted there.
COUNTER_AT = {
    COMMAND_ID: (4, 4),
    STATUS_ID: (5, 4),
    LOWER_LEVELS_ID: (5, 0),
    UPPER_LEVELS_ID: (5, 0),
    PUMP_HEARTBEAT_ID: (0, 4),
    LEVEL_HEARTBEAT_ID: (0, 4),
}

RAW_PER_V = 5000.0
COMMAND_LENGTH = 6
COMMAND_RAW_MAX = 50_000
COUNTER_MODULUS = 16
COUNTER_STEP_MAX = 8

_COMMAND = struct.Struct("<HHBB")
_STATUS = struct.Struct("<HHBBB")
_LEVELS = struct.Struct("<HHBB")
LEVELS_BODY = _LEVELS.size
_HEARTBEAT = struct.Struct("<BHI")


class NodeState(IntEnum):
    """State of a node, in the numbers of the wire."""

    BOOT = 0
    READY = 1
    RUN = 2
    TRIPPED = 3


class TripCause(IntEnum):
    """Why the pump node is tripped."""

    NONE = 0
    WATCHDOG = 1


class ChannelStatus(IntEnum):
    """Status that a level channel sends with its reading."""

    OK = 0
    UNDER_RANGE = 1
    OVER_RANGE = 2
    FAULT = 3


class Frame(Message):
    """A frame from a node: never changed after it was sent, so that it need not be copied.

    python-can's virtual bus makes a deep copy of each frame for each receiver, which would slow lockstep down.
    """

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, object] | None) -> "Frame":
        """Share instead of copying."""
        return self


def remade(
    frame: Message,
    *,
    timestamp_s: float | None = None,
    can_id: int | None = None,
    data: bytes | None = None,
    is_extended: bool = False,
    is_remote: bool = False,
) -> Frame:
    """Return a frame like this one but for what is given; a remote frame keeps the length and has no data."""
    payload = bytes(frame.data) if data is None else data
    becomes_remote = is_remote or frame.is_remote_frame
    return Frame(
        frame.timestamp if timestamp_s is None else timestamp_s,
        frame.arbitration_id if can_id is None else can_id,
        is_extended_id=is_extended or frame.is_extended_id,
        is_remote_frame=becomes_remote,
        is_error_frame=frame.is_error_frame,
        is_fd=frame.is_fd,
        dlc=frame.dlc if data is None else len(payload),
        data=None if becomes_remote else payload,
        is_rx=frame.is_rx,
    )


class Rejection(Enum):
    """Why a frame was not accepted as a command; lost: a fault kept it from the node."""

    LOST = "lost"
    FOREIGN = "foreign"
    ERROR = "error"
    FD = "fd"
    EXTENDED = "extended"
    REMOTE = "remote"
    LENGTH = "length"
    CRC = "crc"
    RANGE = "range"
    DUPLICATE = "duplicate"
    OLD = "old"
    BOOT = "boot"


@dataclass(frozen=True, slots=True)
class PumpCommand:
    """An intact command frame, its counter not yet checked. start_phase : before the controller's time 0."""

    command_V: tuple[float, float]
    enable: bool
    clear_trip: bool
    counter: int
    start_phase: bool = False


def _crc_table() -> bytes:
    def shifted(register: int) -> int:
        for _ in range(8):
            register = (register << 1) ^ 0x12F if register & 0x80 else register << 1
        return register

    return bytes(shifted(byte) for byte in range(256))


_TABLE = _crc_table()


def _crc_over(register: int, data: bytes | bytearray) -> int:
    table = _TABLE
    if len(data) == LEVELS_BODY:  # the frames that are sent most often
        first, second, third, fourth, fifth, sixth = data
        register = table[table[table[register ^ first] ^ second] ^ third]
        return table[table[table[register ^ fourth] ^ fifth] ^ sixth]
    for byte in data:
        register = table[register ^ byte]
    return register


_STARTS = {can_id: _crc_over(0xFF, struct.pack("<H", data_id)) for can_id, data_id in DATA_IDS.items()}


def crc8(can_id: int, payload: bytes | bytearray) -> int:
    """CRC of a frame from its identifier and all payload bytes before the CRC byte."""
    return _crc_over(_STARTS[can_id], payload) ^ 0xFF


def sealed(can_id: int, payload: bytes) -> bytes:
    """Return the payload followed by its CRC byte."""
    return payload + bytes((crc8(can_id, payload),))


def volts_to_raw(voltage_V: float) -> int:
    """Nearest multiple of 0.2 mV; the caller keeps to 0 .. 13.107 V."""
    return int(voltage_V * RAW_PER_V + 0.5)


def pack_command(command_V: tuple[float, float], counter: int) -> bytes:
    """PumpCommand with Enable = 1: voltages 0 .. 10 V, counter taken modulo 16."""
    flags = 1 | (counter % COUNTER_MODULUS) << 4
    payload = _COMMAND.pack(volts_to_raw(command_V[0]), volts_to_raw(command_V[1]), flags, 0)
    return sealed(COMMAND_ID, payload[:-1])


def pack_status(
    applied_V: tuple[float, float], state: NodeState, cause: TripCause, echo: int, counter: int, accepted: int
) -> bytes:
    """PumpStatus: applied voltages 0 .. 10 V, echo and counter 0 .. 15, accepted taken modulo 256."""
    raw1, raw2 = volts_to_raw(applied_V[0]), volts_to_raw(applied_V[1])
    payload = _STATUS.pack(raw1, raw2, state | cause << 4, echo | counter << 4, accepted & 0xFF)
    return sealed(STATUS_ID, payload)


def pack_levels(
    can_id: int, level_V: tuple[float, float], status: tuple[ChannelStatus, ChannelStatus], counter: int
) -> bytes:
    """LowerLevels or UpperLevels: two level voltages 0 .. 10.24 V with a status each."""
    raw1, raw2 = int(level_V[0] * RAW_PER_V + 0.5), int(level_V[1] * RAW_PER_V + 0.5)
    return sealed(can_id, _LEVELS.pack(raw1, raw2, status[0] | status[1] << 4, counter))


def unpack_levels(payload: bytes) -> list[tuple[float, ChannelStatus]]:
    """Both readings of a LowerLevels or UpperLevels payload that this node sent: V and status."""
    raw1, raw2, statuses, _ = _LEVELS.unpack(payload[:-1])
    return [(raw1 / RAW_PER_V, ChannelStatus(statuses & 0x0F)), (raw2 / RAW_PER_V, ChannelStatus(statuses >> 4))]


def pack_heartbeat(can_id: int, state: NodeState, counter: int, boot_count: int, contract: int) -> bytes:
    """Heartbeat of a node: boot count 0 .. 65535, contract as a CRC-32."""
    return sealed(can_id, _HEARTBEAT.pack(state | counter << 4, boot_count, contract))


def parse_command(frame: Message) -> PumpCommand | Rejection:
    """Check kind, length, CRC and range of a frame, in this order; spare bits are ignored."""
    if frame.is_error_frame:
        return Rejection.ERROR
    if frame.arbitration_id != COMMAND_ID:
        return Rejection.FOREIGN
    if (of_kind := _wrong_kind(frame)) is not None:
        return of_kind
    if frame.dlc != COMMAND_LENGTH or len(frame.data) != COMMAND_LENGTH:
        return Rejection.LENGTH
    raw1, raw2, flags, crc = _COMMAND.unpack(frame.data)
    if crc8(COMMAND_ID, frame.data[:-1]) != crc:
        return Rejection.CRC
    if raw1 > COMMAND_RAW_MAX or raw2 > COMMAND_RAW_MAX:
        return Rejection.RANGE
    return PumpCommand(
        (raw1 / RAW_PER_V, raw2 / RAW_PER_V), bool(flags & 1), bool(flags & 2), flags >> 4, bool(flags & 4)
    )


def _wrong_kind(frame: Message) -> Rejection | None:
    if frame.is_fd:
        return Rejection.FD
    if frame.is_extended_id:
        return Rejection.EXTENDED
    if frame.is_remote_frame:
        return Rejection.REMOTE
    return None


def counter_verdict(counter: int, last: int) -> int | Rejection:
    """How many commands were lost between the last accepted counter and this one, or why this one is refused.

    A step of 1 to 8 (modulo 16) is new; 0 is a duplicate; 9 to 15 is an old frame.
    """
    step = (counter - last) % COUNTER_MODULUS
    if step == 0:
        return Rejection.DUPLICATE
    return step - 1 if step <= COUNTER_STEP_MAX else Rejection.OLD


def contract_fingerprint(dbc_text: str) -> int:
    """CRC-32 of the contract: lines without trailing white space, joined by line feeds, none at the end."""
    return zlib.crc32("\n".join(line.rstrip() for line in dbc_text.splitlines()).encode("utf-8"))
