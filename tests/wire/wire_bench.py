"""Helpers of the wire's tests: the DBC by cantools, frames with counter and CRC that owe nothing to hil."""

import tomllib
from pathlib import Path
from typing import Any

import cantools
from can import Message
from cantools.database.can import Database
from crccheck.crc import Crc8Autosar

from hil.core.types import Command, Measurement, NodeHealth, Pair, PumpFeedback, Quad
from hil.wire.command_sender import CommandSender
from hil.wire.contract import Contract
from hil.wire.receiver import Receiver
from tests.narrowing import not_none

ROOT = Path(__file__).resolve().parents[2]
DBC = (ROOT / "config/bench.dbc").read_text()
GOLDEN = tomllib.loads((ROOT / "tests/golden/frames.toml").read_text())["frame"]
LOADED = cantools.database.load_string(DBC, database_format="dbc")
assert isinstance(LOADED, Database)
DATABASE: Database = LOADED
CONTRACT = Contract.from_dbc(DBC)
NAMES = tuple(CONTRACT.frames)
MS = 1_000_000
NODE_FRAMES = ("PumpStatus", "LowerLevels", "UpperLevels", "PumpHeartbeat", "LevelHeartbeat")

DEFAULTS: dict[str, dict[str, float]] = {
    "PumpCommand": {"Command1": 3.0, "Command2": 4.0, "Enable": 1, "ClearTrip": 0, "StartPhase": 0},
    "PumpStatus": {"Applied1": 3.0, "Applied2": 4.0, "State": 2, "TripCause": 0, "Echo": 0, "Accepted": 1},
    "LowerLevels": {"Level1": 6.0, "Level2": 6.4, "Status1": 0, "Status2": 0},
    "UpperLevels": {"Level3": 0.8, "Level4": 0.7, "Status3": 0, "Status4": 0},
    "PumpHeartbeat": {"State": 2, "BootCount": 1, "Contract": CONTRACT.fingerprint},
    "LevelHeartbeat": {"State": 2, "BootCount": 5, "Contract": CONTRACT.fingerprint},
}


def sealed(name: str, payload: bytes) -> bytes:
    """Payload (the CRC's byte left out) with its CRC, by the description in the DBC."""
    data_id = int(not_none(DATABASE.get_message_by_name(name).dbc).attributes["DataId"].value)
    return payload + bytes([Crc8Autosar.calc(data_id.to_bytes(2, "little") + payload)])


def payload_of(name: str, counter: int = 0, **values: float) -> bytes:
    data = DATABASE.encode_message(name, DEFAULTS[name] | {"Counter": counter, "Crc": 0} | values, strict=False)
    return sealed(name, data[:-1])


def message(can_id: int, data: bytes, **kind: Any) -> Message:
    return Message(arbitration_id=can_id, data=data, **({"is_extended_id": False} | kind))


def frame(name: str, counter: int = 0, **values: float) -> Message:
    return message(DATABASE.get_message_by_name(name).frame_id, payload_of(name, counter, **values))


def receiver(sensor_range_V: Pair = (0.0, 10.24)) -> tuple[Receiver, CommandSender]:
    sender = CommandSender(CONTRACT)
    return Receiver(CONTRACT, sender, sensor_range_V), sender


def seen(receiver_: Receiver, now_ns: int = 0) -> tuple[Measurement, PumpFeedback, NodeHealth, int, int, int]:
    """All that a control step would get to see; asking for it begins a new mean, so the receiver is done with."""
    return (
        receiver_.measurement(now_ns),
        receiver_.pumps(now_ns),
        receiver_.nodes(now_ns),
        receiver_.foreign_commands,
        receiver_.accepted,
        receiver_.lost,
    )


def go(v1: float = 3.0, v2: float = 4.0, *, enable: bool = True) -> Command:
    return Command((v1, v2), enable)


def feed_levels(
    receiver_: Receiver,
    counter: int,
    at_ns: int,
    levels: Quad | list[float] = (6.0, 6.4, 0.8, 0.7),
    statuses: list[int] | tuple[int, ...] = (0, 0, 0, 0),
) -> None:
    y1, y2, y3, y4 = levels
    s1, s2, s3, s4 = statuses
    lower = frame("LowerLevels", counter, Level1=y1, Level2=y2, Status1=s1, Status2=s2)
    upper = frame("UpperLevels", counter, Level3=y3, Level4=y4, Status3=s3, Status4=s4)
    assert receiver_.take(lower, at_ns) is None
    assert receiver_.take(upper, at_ns) is None
