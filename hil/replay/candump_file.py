"""Reads the log of a run folder, or any that `candump -L` writes, plain or compressed, in the order of its lines."""

from __future__ import annotations

import gzip
import re
import zlib
from pathlib import Path

from hil.replay.frame_log import ERROR, EXTENDED, REMOTE, Entry, FrameLog, ReplayError, frame_log

LINE = re.compile(rb"\((\d+)\.(\d{6})\) \S+ ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(R?)([0-9A-Fa-f]*)(?: [RT])?$")
ERROR_FLAG = 0x20000000


def read_candump(path: Path) -> FrameLog:
    """Raises ReplayError that names the first line that is no frame. A half line at the end is left out, and said."""
    text = _content(path)
    whole, _, rest = text.rpartition(b"\n")
    doubts = (f"{path.name} ends in the middle of a line, which is left out",) if rest else ()
    lines = whole.split(b"\n") if whole else []
    return frame_log((_entry(path, number, line) for number, line in enumerate(lines, 1)), doubts)


def _content(path: Path) -> bytes:
    try:
        raw = path.read_bytes()
        return gzip.decompress(raw) if path.suffix == ".gz" else raw
    except (OSError, EOFError, zlib.error) as error:
        raise ReplayError(f"{path} can't be read: {getattr(error, 'strerror', None) or error}") from None


def _entry(path: Path, number: int, line: bytes) -> Entry:
    match = LINE.match(line)
    if match is None or (not match[4] and len(match[5]) % 2):
        shown = line[:60].decode("ascii", "replace")
        raise ReplayError(f"{path}, line {number} is no frame as candump -L writes it: {shown!r}")
    seconds, micros, identifier, remote, data = match.groups()
    time_ns = int(seconds) * 1_000_000_000 + int(micros) * 1000
    frame_id = int(identifier, 16)
    if len(identifier) == 8 and frame_id & ERROR_FLAG:
        return time_ns, frame_id & ~ERROR_FLAG, ERROR, bytes.fromhex(data.decode())
    kind = (EXTENDED if len(identifier) == 8 else 0) | (REMOTE if remote else 0)
    return time_ns, frame_id, kind, b"" if remote else bytes.fromhex(data.decode())
