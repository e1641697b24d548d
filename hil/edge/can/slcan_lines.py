"""The lines of slcan, Lawicel's protocol for serial CAN adapters: bytes in, frames and counts out. No I/O.

An adapter sends, each line ended by CR, LF or CR LF (the protocol says CR; firmware differs):
    tiiildd..  Tiiiiiiiildd..    a data frame: identifier of 11 or 29 bits, length 0..8, two hex digits a byte
    riiil      Riiiiiiiil        a remote frame
    nothing, z, Z                the acknowledgement of a command
    V..  v..  N..  F..           the answer to a question
and BELL, which also ends a line, for a command that it refuses. Four more digits after a frame are its time stamp.

No input raises an error, and at most MAX_LINE_BYTES bytes are kept, whatever pieces the stream arrives in.
See docs/decisions/0012-slcan-of-our-own.md.
"""

from __future__ import annotations

import re
from binascii import unhexlify
from collections import Counter
from enum import StrEnum

import can

CR = b"\r"
LF = b"\n"
BELL = b"\a"
MAX_LINE_BYTES = 1024
BIT_RATES = {
    10_000: b"S0",
    20_000: b"S1",
    50_000: b"S2",
    100_000: b"S3",
    125_000: b"S4",
    250_000: b"S5",
    500_000: b"S6",
    800_000: b"S7",
    1_000_000: b"S8",
}
"""Bit rate in bit/s -> the command that sets it."""

_STAMP_DIGITS = 4
_HEX = rb"[0-9A-Fa-f]"
_STANDARD_ID = re.compile(rb"[tr][0-7]%b{2}" % _HEX)
_EXTENDED_ID = re.compile(rb"[TR][01]%b{7}" % _HEX)
_FRAME = re.compile(rb"(?:([tr])([0-7]%b{2})|([TR])([01]%b{7}))([0-8])((?:%b%b)*)" % ((_HEX,) * 4))
_PRINTABLE = re.compile(rb"[ -~]*")


class Reject(StrEnum):
    """Why a line was rejected."""

    GARBLED = "garbled"  # not printable, or interrupted by BELL
    ENDLESS = "endless"  # longer than MAX_LINE_BYTES
    UNKNOWN = "unknown"  # neither a frame nor an answer
    IDENTIFIER = "identifier"  # not a number, or more than 11 or 29 bits
    LENGTH = "length"  # not a number, or above 8
    PAYLOAD = "payload"  # shorter or longer than its length, or not hex digits
    FD = "fd"  # a CAN FD frame


class LineReader:
    """Reads the bytes that an adapter sends, in pieces of any size.

    done, refused : numbers of commands that it has acknowledged (CR) and refused (BELL). texts : number of other
    readable lines. rejected : numbers of rejected lines, by cause; readable ones also count as texts.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._is_endless = False
        self._ended_with_cr = False
        self.done = 0
        self.refused = 0
        self.texts = 0
        self.rejected: Counter[Reject] = Counter()

    def reset_counts(self) -> None:
        """Set all counts to zero."""
        self.done = self.refused = self.texts = 0
        self.rejected.clear()

    @property
    def kept(self) -> int:
        """Number of bytes kept of the line that has not ended yet."""
        return len(self._rest)

    def feed(self, data: bytes, timestamp_s: float = 0.0) -> list[can.Message]:
        """The frames whose lines end in `data`. Never raises."""
        frames: list[can.Message] = []
        *lines, rest = (self._rest + self._with_cr_ends(data)).split(CR)
        for line in lines:
            frame = self._end(self._after_refusals(line), timestamp_s)
            if frame is not None:
                frames.append(frame)
        rest = self._after_refusals(rest)
        if len(rest) > MAX_LINE_BYTES and not self._is_endless:
            self.rejected[Reject.ENDLESS] += 1
            self._is_endless = True
        self._rest = b"" if self._is_endless else rest
        return frames

    def _with_cr_ends(self, data: bytes) -> bytes:
        """Replace each LF and CR LF by one CR, also where a cut separates CR from LF: one line has one end."""
        if not data:
            return data
        is_rest_of_end = self._ended_with_cr and data[:1] == LF
        self._ended_with_cr = data[-1:] == CR
        if LF not in data:
            return data
        return data[1 if is_rest_of_end else 0 :].replace(CR + LF, CR).replace(LF, CR)

    def _after_refusals(self, line: bytes) -> bytes:
        """The part after the last BELL. Count each BELL as a refusal, and what it interrupts as rejected."""
        if BELL not in line:
            return line
        *cut_off, line = line.split(BELL)
        for piece in cut_off:
            self.refused += 1
            if piece and not self._is_endless:
                self.rejected[Reject.ENDLESS if len(piece) > MAX_LINE_BYTES else Reject.GARBLED] += 1
            self._is_endless = False
        return line

    def _end(self, line: bytes, timestamp_s: float) -> can.Message | None:
        """A complete line: its frame, or None; then the line is counted."""
        if self._is_endless:  # has been counted
            self._is_endless = False
            return None
        if line in (b"", b"z", b"Z"):
            self.done += 1
            return None
        frame = parse_frame(line, timestamp_s)
        if frame is None:
            self._count(line)
        return frame

    def _count(self, line: bytes) -> None:
        cause = _cause(line)
        if cause in (None, Reject.UNKNOWN):
            self.texts += 1
        if cause is not None:
            self.rejected[cause] += 1


def parse_frame(line: bytes, timestamp_s: float = 0.0) -> can.Message | None:
    """The frame of a line without its CR; None if any part of the line is wrong."""
    match = _FRAME.fullmatch(line)
    if match is None:
        return None
    standard, standard_id, extended, extended_id, length, digits = match.groups()
    dlc = int(length)
    is_remote = (standard or extended) in b"rR"
    wanted = 0 if is_remote else 2 * dlc
    if len(digits) not in (wanted, wanted + _STAMP_DIGITS):
        return None
    return can.Message(
        timestamp=timestamp_s,
        arbitration_id=int(standard_id or extended_id, 16),
        is_extended_id=extended is not None,
        is_remote_frame=is_remote,
        dlc=dlc,
        data=unhexlify(digits[:wanted]),
    )


def frame_line(frame: can.Message) -> bytes:
    """The command that sends a frame. Raises ValueError for kinds of frames that slcan does not have."""
    if frame.is_fd or frame.is_error_frame:
        raise ValueError("slcan has neither CAN FD nor error frames")
    kind, width = ("t", 3) if not frame.is_extended_id else ("T", 8)
    if frame.is_remote_frame:
        return f"{'r' if width == 3 else 'R'}{frame.arbitration_id:0{width}X}{frame.dlc}\r".encode()
    return f"{kind}{frame.arbitration_id:0{width}X}{frame.dlc}{frame.data.hex().upper()}\r".encode()


def _cause(line: bytes) -> Reject | None:
    """Why a line is not a frame; None for the answer to a question."""
    kind = line[:1]
    if len(line) > MAX_LINE_BYTES:
        return Reject.ENDLESS
    if _PRINTABLE.fullmatch(line) is None:
        return Reject.GARBLED
    if kind in b"VvNF":
        return None
    if kind in b"dDbB":
        return Reject.FD
    if kind not in b"tTrR":
        return Reject.UNKNOWN
    number = (_STANDARD_ID if kind in b"tr" else _EXTENDED_ID).match(line)
    if number is None:
        return Reject.IDENTIFIER
    return Reject.PAYLOAD if line[number.end() : number.end() + 1] in _LENGTHS else Reject.LENGTH


_LENGTHS = tuple(b"%d" % length for length in range(9))
