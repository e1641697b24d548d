"""Properties that must hold for any bytes, one target for each reader; a target raises AssertionError otherwise."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import can

from firmware_sim.slcan_port import LINE_MAX, SlcanPort
from hil.core.types import Command
from hil.edge.can.slcan_lines import BELL, CR, LF, MAX_LINE_BYTES, LineReader, Reject, frame_line, parse_frame
from hil.edge.config.settings_file import default_config_dir
from hil.wire.command_sender import CommandSender
from hil.wire.contract import Contract, crc8
from hil.wire.frame_check import Rejection
from hil.wire.receiver import Receiver

SENSOR_RANGE_V = (0.0, 10.24)
MS = 1_000_000
ROUNDING_V = 1e-9


def check(holds: bool, what: str) -> None:
    """Raise AssertionError unless the property holds; also under -O."""
    if not holds:
        raise AssertionError(what)


def slcan(data: bytes) -> None:
    """A stream from an adapter, after a byte that says how to split it: split or whole, the result is the same.

    Never more than 1 kB is kept; every line is counted once; every accepted frame is one that could be sent, and
    comes back as it was.
    """
    size, stream = (data[0] or 256, data[1:]) if data else (1, b"")
    whole, cut = LineReader(), LineReader()
    frames = whole.feed(stream)
    pieces: list[can.Message] = []
    for start in range(0, len(stream), size):
        pieces += cut.feed(stream[start : start + size])
        check(cut.kept <= MAX_LINE_BYTES, "too much is kept")
    check([_content(frame) for frame in frames] == [_content(frame) for frame in pieces], "a cut changes frames")
    check(_counts(whole) == _counts(cut), "a cut changes counts")
    check(whole.refused == stream.count(BELL), "refusals miscounted")
    ended = _lines_ended(stream)
    texts = whole.texts - whole.rejected[Reject.UNKNOWN]  # those are rejected, too
    counted = len(frames) + whole.done + texts + whole.rejected.total()
    check(ended in (None, counted), "a line is not counted once")
    for frame in frames:
        line = frame_line(frame)
        again = parse_frame(line[:-1])
        check(
            again is not None and _content(again) == _content(frame) and line.endswith(CR), f"{line!r} is not what came"
        )
        check(frame.arbitration_id <= (0x1FFFFFFF if frame.is_extended_id else 0x7FF), "identifier")
        check(frame.dlc <= 8 and len(frame.data) == (0 if frame.is_remote_frame else frame.dlc), "length")


def adapter(data: bytes) -> None:
    """The emulator's adapter: one answer to every CR, a bounded buffer, valid frames."""
    size, stream = (data[0] or 256, data[1:]) if data else (1, b"")
    port = SlcanPort()
    for start in range(0, len(stream), size):
        piece = stream[start : start + size]
        reply, frames = port.feed(piece)
        check(reply.count(CR) + reply.count(BELL) == piece.count(CR), "an answer too many or too few")
        check(len(port._line) <= LINE_MAX, "too much is kept")
        for frame in frames:
            check(frame.dlc <= 8 and (frame.is_remote_frame or len(frame.data) == frame.dlc), "length")
            check(port.channel.value == "closed" or bool(port.frame_line(frame)), "no line for its own frame")


def wire(data: bytes) -> None:
    """Frames from a bus, ten bytes and a payload each: never an exception, each counted once, levels in range.

    A frame that was taken has the right kind, length and CRC; what a step then sees is finite or said to be invalid.
    """
    specs = list(contract().frames.values())
    receiver = Receiver(contract(), CommandSender(contract()), SENSOR_RANGE_V)
    receiver._sender.encode(Command((1.0, 1.0), enable=True), 0)
    now_ns = taken = at = 0
    while at + 4 <= len(data):
        which, how, wait, length = data[at : at + 4]
        payload = data[at + 4 : at + 4 + length % 9]
        at += 4 + length % 9
        spec = specs[which % len(specs)]
        if how & 1 and payload:  # with a right CRC, so that it passes that check
            payload = (payload + bytes(8))[: spec.length - 1]
            payload += bytes((crc8(payload, spec.crc_start),))
        now_ns += wait * MS
        frame = can.Message(
            arbitration_id=spec.frame_id if how & 2 else which << 3 | how >> 5,
            is_extended_id=how & 12 == 4,
            is_remote_frame=how & 12 == 8,
            is_error_frame=how & 12 == 12,
            data=b"" if how & 12 == 8 else payload,
            dlc=len(payload),
        )
        rejection = receiver.take(frame, now_ns)
        taken += 1
        if rejection is None:
            _assert_ours(frame, how)
        else:
            check(rejection in Rejection, "no cause")
        if how & 16:
            _assert_sane(receiver, now_ns)
    check(receiver.accepted + receiver.rejections.total() == taken, "a frame is not counted once")
    _assert_sane(receiver, now_ns)


def _assert_ours(frame: can.Message, how: int) -> None:
    spec = next(spec for spec in contract().frames.values() if spec.frame_id == frame.arbitration_id)
    check(not how & 12, "no plain frame, and taken")
    check(len(frame.data) == spec.length, "length")
    check(crc8(frame.data[:-1], spec.crc_start) == frame.data[-1], "CRC")


def _assert_sane(receiver: Receiver, now_ns: int) -> None:
    measurement = receiver.measurement(now_ns)
    low, high = SENSOR_RANGE_V
    for volts, is_valid in zip(measurement.level_V, measurement.valid, strict=True):
        check(not is_valid or low - ROUNDING_V <= volts <= high + ROUNDING_V, f"a valid level of {volts} V")
    pumps = receiver.pumps(now_ns)
    check(pumps.unechoed_s >= 0.0 and pumps.age_s >= 0.0, "negative age")
    check(receiver.nodes(now_ns).age_s >= 0.0, "negative age")
    check(receiver.bus(now_ns, 0, True).rejected >= 0, "negative count")
    check(receiver.lost >= 0, "negative count")


@cache
def contract() -> Contract:
    """The bench's."""
    return Contract.from_dbc((default_config_dir() / "bench.dbc").read_text(encoding="utf-8"))


def _content(frame: can.Message) -> tuple[object, ...]:
    return frame.arbitration_id, frame.is_extended_id, frame.is_remote_frame, frame.dlc, bytes(frame.data)


def _lines_ended(stream: bytes) -> int | None:
    """How many lines a stream ends; None where refusals or endless lines cut other lines off."""
    *lines, rest = stream.replace(CR + LF, CR).replace(LF, CR).split(CR)
    is_simple = BELL not in stream and all(len(line) <= MAX_LINE_BYTES for line in (*lines, rest))
    return len(lines) if is_simple else None


def _counts(reader: LineReader) -> tuple[object, ...]:
    return reader.done, reader.refused, reader.texts, dict(reader.rejected), reader.kept


TARGETS: dict[str, Callable[[bytes], None]] = {"slcan": slcan, "wire": wire, "adapter": adapter}
SEEDS: dict[str, tuple[bytes, ...]] = {
    "slcan": (
        b"\x05t18271122334455667788\rT1FFFFFFF2ABCD\rz\r\at1820\r",
        b"\x40r1824\rR000001238\rt18211112345\rV1013\rN1234\rF00\rd18281\r",
        b"\x01tFFF0\rt189\rt1828\r\xff\r\r\r" + b"A" * 1100 + b"\rt1811AA\r",
    ),
    "adapter": (
        b"\x05\r\r\rC\rV\rS6\rO\rt2016983A204E1106\rT000002010\rr2018\rC\r",
        b"\x20Z1\rL\rt2010\rF\rN\r" + b"x" * 1100 + b"\rC\r",
    ),
    "wire": tuple(
        bytes((number, 0b10011, 20, 8)) + bytes(range(8)) + bytes((number, 0b11, 20, 8)) + bytes(range(1, 9))
        for number in range(6)
    ),
}
