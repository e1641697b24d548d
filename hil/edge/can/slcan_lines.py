"""The lines of slcan, Lawicel's protocol of serial CAN adapters: bytes in, frames and counted refusals out. No I/O.

An adapter sends, each line ended by CR, LF or CR LF (the protocol says CR; firmware differs):
    tiiildd..  Tiiiiiiiildd..    a data frame: identifier of 11 or 29 bits, length 0..8, two hex digits a byte
    riiil      Riiiiiiiil        a remote frame
    nothing, z, Z                done: the answer to a command
    V..  v..  N..  F..           what it was asked for
and BELL, which also ends a line, for a command that it refuses. Four more digits behind a frame are its time stamp.

Nothing that comes in raises, and at most LONGEST_LINE bytes are kept, however the stream is cut.
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
LONGEST_LINE = 1024
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
"""bit/s -> the command that sets it."""

_STAMP_DIGITS = 4
_HEX = rb"[0-9A-Fa-f]"
_STANDARD_ID = re.compile(rb"[tr][0-7]%b{2}" % _HEX)
_EXTENDED_ID = re.compile(rb"[TR][01]%b{7}" % _HEX)
_FRAME = re.compile(rb"(?:([tr])([0-7]%b{2})|([TR])([01]%b{7}))([0-8])((?:%b%b)*)" % ((_HEX,) * 4))
_PRINTABLE = re.compile(rb"[ -~]*")


class Reject(StrEnum):
    """Why a line was dropped."""

    GARBLED = "garbled"  # bytes that no line has, or a line cut off by BELL
    ENDLESS = "endless"  # longer than LONGEST_LINE
    UNKNOWN = "unknown"  # neither a frame nor an answer
    IDENTIFIER = "identifier"  # no number, or beyond 11 or 29 bits
    LENGTH = "length"  # no number, or beyond 8
    PAYLOAD = "payload"  # shorter or longer than its length, or no hex digits
    FD = "fd"  # a CAN FD frame


class LineReader:
    """Takes what an adapter says, cut anywhere.

    done, refused : how many commands it has acknowledged (CR) and refused (BELL) so far. texts : other lines that
    can be read. rejected : dropped lines, by cause; those that can be read are texts as well.
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
        """Bytes of the line that has not ended yet."""
        return len(self._rest)

    def feed(self, data: bytes, timestamp_s: float = 0.0) -> list[can.Message]:
        """The frames that `data` completes. Never raises."""
        frames: list[can.Message] = []
        *lines, rest = (self._rest + self._with_cr_ends(data)).split(CR)
        for line in lines:
            frame = self._end(self._after_refusals(line), timestamp_s)
            if frame is not None:
                frames.append(frame)
        rest = self._after_refusals(rest)
        if len(rest) > LONGEST_LINE and not self._is_endless:
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
        """What comes after the last BELL; anything between two of them is no line of its own."""
        if BELL not in line:
            return line
        *cut_off, line = line.split(BELL)
        for piece in cut_off:
            self.refused += 1
            if piece and not self._is_endless:
                self.rejected[Reject.ENDLESS if len(piece) > LONGEST_LINE else Reject.GARBLED] += 1
            self._is_endless = False
        return line

    def _end(self, line: bytes, timestamp_s: float) -> can.Message | None:
        """A line that CR has ended: the frame, or None with the line counted as what it was."""
        if self._is_endless:  # counted when it became so
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
    """A frame's line without its CR; None if anything about it is wrong."""
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
    """The command that sends a frame. Raises ValueError for what the protocol has no words for."""
    if frame.is_fd or frame.is_error_frame:
        raise ValueError("slcan has neither CAN FD nor error frames")
    kind, width = ("t", 3) if not frame.is_extended_id else ("T", 8)
    if frame.is_remote_frame:
        return f"{'r' if width == 3 else 'R'}{frame.arbitration_id:0{width}X}{frame.dlc}\r".encode()
    return f"{kind}{frame.arbitration_id:0{width}X}{frame.dlc}{frame.data.hex().upper()}\r".encode()


def _cause(line: bytes) -> Reject | None:
    """Why a line is no frame; None for what the adapter was asked for."""
    kind = line[:1]
    if len(line) > LONGEST_LINE:
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
