"""A serial CAN adapter's line protocol (Lawicel, "slcan") as a pure state machine: bytes in, bytes and frames out.

Rules
- A line ends with CR. The answer is CR for done, BELL for refused; an empty line is answered with CR.
- closed         S0 .. S8 and sXXYY set a bit rate, Z0 / Z1 switches time stamps; O opens, L opens listen-only.
- open           t, T, r, R put a frame on the bus, answered with z (11-bit) or Z (29-bit) and CR; F reads flags;
                 C closes. Frames of the bus go to the host.
- listen-only    as open, but t, T, r, R are refused.
- V and N are answered in every state. Every other line, and every line in the wrong state, is refused.
- A line may have 1024 bytes; a longer one is discarded up to its CR and refused.
"""

from enum import Enum

from can import Message

CR = b"\r"
BELL = b"\a"
LINE_MAX = 1024
VERSION = b"V1013\r"
SERIAL_NUMBER = b"NFT01\r"
FLAGS = b"F00\r"
STAMP_WRAP_MS = 60_000

_HEX = frozenset(b"0123456789ABCDEFabcdef")
_ID_MAX = {3: 0x7FF, 8: 0x1FFFFFFF}


class Channel(Enum):
    """State of the adapter's CAN channel."""

    CLOSED = "closed"
    OPEN = "open"
    LISTEN = "listen"


class SlcanPort:
    """One slcan adapter."""

    def __init__(self) -> None:
        self.channel = Channel.CLOSED
        self._stamps = False
        self._line = bytearray()
        self._is_too_long = False

    def feed(self, data: bytes) -> tuple[bytes, list[Message]]:
        """Take bytes from the host, split anywhere; return the answer and the frames for the bus. Never raises."""
        reply = bytearray()
        frames: list[Message] = []
        *complete, rest = data.split(CR)
        for piece in complete:
            self._collect(piece)
            reply += self._finish_line(frames)
        self._collect(rest)
        return bytes(reply), frames

    def frame_line(self, frame: Message) -> bytes:
        """Return the line for the host of a frame on the bus; empty while the channel is closed."""
        if self.channel is Channel.CLOSED or frame.is_error_frame or frame.is_fd:
            return b""
        if frame.is_extended_id:
            head = f"{'R' if frame.is_remote_frame else 'T'}{frame.arbitration_id:08X}{frame.dlc}"
        else:
            head = f"{'r' if frame.is_remote_frame else 't'}{frame.arbitration_id:03X}{frame.dlc}"
        stamp = f"{int(frame.timestamp * 1000) % STAMP_WRAP_MS:04X}" if self._stamps else ""
        return f"{head}{frame.data.hex().upper()}{stamp}\r".encode("ascii")

    def _collect(self, piece: bytes) -> None:
        if len(self._line) + len(piece) > LINE_MAX:
            self._is_too_long = True
        if self._is_too_long:
            self._line.clear()
        else:
            self._line += piece

    def _finish_line(self, frames: list[Message]) -> bytes:
        line, is_too_long = bytes(self._line), self._is_too_long
        self._line.clear()
        self._is_too_long = False
        if is_too_long or not line.isascii():
            return BELL
        if not line:
            return CR
        if line[:1] in b"tTrR":
            return self._transmit(line, frames)
        return self._control(line)

    def _transmit(self, line: bytes, frames: list[Message]) -> bytes:
        frame = parse_frame(line)
        if frame is None or self.channel is not Channel.OPEN:
            return BELL
        frames.append(frame)
        return b"Z\r" if frame.is_extended_id else b"z\r"

    def _control(self, line: bytes) -> bytes:
        if line == b"V":
            return VERSION
        if line == b"N":
            return SERIAL_NUMBER
        if self.channel is Channel.CLOSED:
            return self._control_closed(line)
        if line == b"F":
            return FLAGS
        if line == b"C":
            self.channel = Channel.CLOSED
            return CR
        return BELL

    def _control_closed(self, line: bytes) -> bytes:
        is_bit_rate = len(line) == 2 and line[:1] == b"S" and line[1:] in b"012345678"
        is_timing = len(line) == 5 and line[:1] == b"s" and _HEX.issuperset(line[1:])
        if is_bit_rate or is_timing:
            return CR
        if line in (b"Z0", b"Z1"):
            self._stamps = line == b"Z1"
            return CR
        if line in (b"O", b"L"):
            self.channel = Channel.OPEN if line == b"O" else Channel.LISTEN
            return CR
        return BELL


def parse_frame(line: bytes) -> Message | None:
    """Read a t, T, r or R line without its CR; None if it is not a valid frame."""
    kind, digits = line[:1], line[1:]
    is_extended, is_remote = kind in b"TR", kind in b"rR"
    id_digits = 8 if is_extended else 3
    if len(digits) <= id_digits or not _HEX.issuperset(digits):
        return None
    can_id, dlc = int(digits[:id_digits], 16), int(digits[id_digits : id_digits + 1], 16)
    payload = digits[id_digits + 1 :]
    if can_id > _ID_MAX[id_digits] or dlc > 8 or len(payload) != (0 if is_remote else 2 * dlc):
        return None
    return Message(
        arbitration_id=can_id,
        is_extended_id=is_extended,
        is_remote_frame=is_remote,
        dlc=dlc,
        data=bytes.fromhex(payload.decode("ascii")),
    )
