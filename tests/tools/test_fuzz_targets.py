"""The properties of `tools.fuzz` hold for its seeds, and each reader that breaks one of them is found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import can
import pytest

from firmware_sim.slcan_port import SlcanPort
from hil.edge.can import slcan_lines
from hil.edge.can.slcan_lines import LineReader
from hil.wire.receiver import Receiver
from tools.fuzz import targets

Patch = Callable[[pytest.MonkeyPatch], None]
FRAME = b"t18281122334455667788\r"


def forgets_cuts(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(LineReader, "_with_cr_ends", lambda _, data: data.replace(b"\r\n", b"\r").replace(b"\n", b"\r"))


def forgets_the_rest(patch: pytest.MonkeyPatch) -> None:
    real = LineReader.feed

    def feed(reader: LineReader, data: bytes, timestamp_s: float = 0.0) -> list[can.Message]:
        frames = real(reader, data, timestamp_s)
        reader._rest = b""
        return frames

    patch.setattr(LineReader, "feed", feed)


def keeps_everything(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(slcan_lines, "MAX_LINE_BYTES", 1 << 20)


def counts_no_text(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(LineReader, "_count", lambda *_: None)


def counts_no_refusal(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(LineReader, "_after_refusals", lambda _, line: line.rpartition(b"\a")[2])


def swaps_bytes(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(slcan_lines, "unhexlify", lambda digits: bytes.fromhex(digits.decode())[::-1])


def takes_every_frame(patch: pytest.MonkeyPatch) -> None:
    def take(receiver: Receiver, *_: Any) -> None:
        receiver.accepted += 1

    patch.setattr(Receiver, "take", take)


def loses_a_frame(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Receiver, "take", lambda *_: None)


def answers_twice(patch: pytest.MonkeyPatch) -> None:
    real = SlcanPort.feed

    def feed(port: SlcanPort, data: bytes) -> tuple[bytes, list[can.Message]]:
        reply, frames = real(port, data)
        return reply + reply, frames

    patch.setattr(SlcanPort, "feed", feed)


BROKEN: list[tuple[str, bytes, Patch, str]] = [
    ("slcan", b"\x01z\r\nz\r\n", forgets_cuts, "a cut changes counts"),
    ("slcan", b"\x01" + FRAME, forgets_the_rest, "a cut changes frames"),
    ("slcan", b"\x10" + bytes(2000), keeps_everything, "too much is kept"),
    ("slcan", b"\x10V1013\r", counts_no_text, "a line is not counted once"),
    ("slcan", b"\x10\a\r", counts_no_refusal, "refusals miscounted"),
    ("slcan", b"\x40" + FRAME, swaps_bytes, "is not what came"),
    ("wire", bytes((0, 2, 0, 8)) + bytes(8), takes_every_frame, "^length$"),
    ("wire", bytes((0, 3, 0, 8)) + bytes(8), loses_a_frame, "a frame is not counted once"),
    ("adapter", b"\x10V\r", answers_twice, "an answer too many"),
]


@pytest.mark.parametrize("name", targets.TARGETS)
def test_the_properties_hold_for_the_seeds(name: str) -> None:
    for seed in targets.SEEDS[name]:
        targets.TARGETS[name](seed)


@pytest.mark.parametrize(("name", "data", "broken", "found"), BROKEN, ids=[row[2].__name__ for row in BROKEN])
def test_a_broken_reader_is_found(
    name: str, data: bytes, broken: Patch, found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tests with random streams assert nothing themselves: they rely on these properties."""
    targets.TARGETS[name](data)
    broken(monkeypatch)
    with pytest.raises(AssertionError, match=found):
        targets.TARGETS[name](data)
