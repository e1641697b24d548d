"""What was rejected is said: how many frames or lines, of which identifier, why, and who may have sent them."""

from typing import Any

import pytest
from can import Message

from hil.wire.frame_check import Rejection
from hil.wire.rejections import MAX_KEYS, RejectedFrames, lines_rejected, other_sender
from tests.wire.wire_bench import CONTRACT, DATABASE, frame, message, receiver

HEARTBEAT_ID = 0x701


def summary_of(*frames: Message) -> str:
    taken, _ = receiver()
    for number, one in enumerate(frames):
        taken.take(one, number * 1_000_000)
    return taken.bus(0, 0, is_up=True).rejection_summary


def broken(name: str) -> Message:
    """A frame with a wrong CRC."""
    one = frame(name)
    one.data[-1] ^= 0xFF
    return one


def test_frames_that_are_accepted_need_no_word() -> None:
    assert summary_of(frame("PumpStatus"), frame("LowerLevels")) == ""


def test_each_identifier_is_named_with_its_causes_the_most_frequent_first() -> None:
    frames = [broken("PumpStatus")] * 3 + [broken("LowerLevels")] * 12 + [frame("LowerLevels")] * 3
    assert summary_of(*frames) == "frames of 0x182 rejected: 12 crc, 2 duplicate; frames of 0x181 rejected: 3 crc"


@pytest.mark.parametrize(
    ("kind", "cause"),
    [({"is_extended_id": True}, "kind"), ({"is_remote_frame": True, "dlc": 8, "data": b""}, "kind")],
)
def test_frames_of_another_kind_are_named(kind: dict[str, Any], cause: str) -> None:
    arguments: dict[str, Any] = {"can_id": 0x181, "data": bytes(8)} | kind
    one = message(**arguments)
    assert summary_of(one) == f"frames of 0x181 rejected: 1 {cause}"


def test_a_foreign_heartbeat_names_identifier_cause_and_what_to_do() -> None:
    """It used to be counted as refused, with the advice to look at cable and termination."""
    text = summary_of(*[message(HEARTBEAT_ID, b"\x05")] * 1234)
    assert text == (
        "frames of 0x701 rejected: 1,234 length (1 byte instead of 8, like a CANopen heartbeat); another node on the "
        "bus uses the identifier 0x701: give it another CANopen node id than 1, or take it off this bus"
    )


@pytest.mark.parametrize("name", [message.name for message in DATABASE.messages])
@pytest.mark.parametrize("length", [0, 1, 2, 8])
def test_any_other_length_names_another_node_or_dbc_and_never_the_cable(name: str, length: int) -> None:
    spec = CONTRACT.frames[name]
    if length == spec.length:
        return
    text = summary_of(message(spec.frame_id, bytes(length)))
    assert text.startswith(f"frames of {spec.frame_id:#05x} rejected: 1 length ({length} byte")
    assert f"another node on the bus uses the identifier {spec.frame_id:#05x}" in text
    assert ("CANopen" in text) == (length == 1 and spec.frame_id in (0x701, 0x702))


def test_an_identifier_outside_the_heartbeats_of_canopen_is_not_called_one() -> None:
    assert "CANopen" in other_sender(0x77F, {1: 1})
    for frame_id in (0x700, 0x780, 0x181):
        assert "CANopen" not in other_sender(frame_id, {1: 1})


def test_identifiers_that_are_none_of_ours_and_error_frames_are_named_too() -> None:
    frames = [message(0x333, b"\x01")] * 2 + [message(0, b"", is_error_frame=True)] * 1000
    assert summary_of(*frames) == "frames of 0x333 rejected: 2 unknown id; 1,000 error frames"


def test_a_node_that_sends_every_identifier_fills_no_memory() -> None:
    counts = RejectedFrames(CONTRACT)
    for can_id in range(0x800):
        counts.add(message(can_id, b""), Rejection.UNKNOWN_ID)
    assert len(counts._counts) == MAX_KEYS + 1
    assert counts.summary().endswith(f"; {0x800 - MAX_KEYS:,} frames of other identifiers")


def test_the_text_is_built_only_when_something_has_changed() -> None:
    counts = RejectedFrames(CONTRACT)
    counts.add(message(HEARTBEAT_ID, b"\x05"), Rejection.LENGTH)
    first = counts.summary()
    assert counts.summary() is first
    counts.add(message(HEARTBEAT_ID, b"\x05"), Rejection.LENGTH)
    assert counts.summary() != first


@pytest.mark.parametrize(
    ("counts", "text"),
    [
        ({}, ""),
        ({"refused": 0, "dropped": 0}, ""),
        ({"refused": 0, "dropped": 0, "rejected_payload": 1668}, "1,668 lines rejected: 1,668 payload"),
        (
            {"refused": 7, "dropped": 2, "rejected_garbled": 1, "rejected_length": 1000},
            "1,001 lines rejected: 1,000 length, 1 garbled; 7 commands refused by the adapter; "
            "2 commands not sent: the line was full or the adapter no longer answered",
        ),
    ],
)
def test_lines_are_named_by_their_cause(counts: dict[str, int], text: str) -> None:
    assert lines_rejected(counts) == text


def test_lines_come_before_frames() -> None:
    taken, _ = receiver()
    taken.take(broken("PumpStatus"), 0)
    text = taken.bus(0, 0, is_up=True, lines_rejected="2 lines rejected: 2 payload").rejection_summary
    assert text == "2 lines rejected: 2 payload; frames of 0x181 rejected: 1 crc"
    clean, _ = receiver()
    assert clean.bus(0, 0, is_up=True, lines_rejected="2 lines").rejection_summary == "2 lines"
