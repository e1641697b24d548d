"""Reads the log of a run's frames (`candump -L`, see docs/reference/run-folder.md) as columns, all lines at once.

The lines of a log have few layouts: widths of the time, channels, kinds of frame, payload lengths. The layout of a line
is read by a regular expression; all lines of its length that have the same layout are then read together, as a table of
characters. The next line that is left gives the next layout.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.edge.record.log_file import find_log, open_log
from hil.edge.record.record_errors import RunFolderError

BLOCK_BYTES = 1 << 19
"""So much of the file is read at once: some 12 000 lines, whose table stays in the processor's cache."""

MAX_DATA = 8
LONG_ID = 8
TOO_LONG = 255
"""Characters that no line of a log has: names of interfaces are short."""
MAX_CHANNELS = 255
ERROR_FLAG, ID_MASK = 0x20000000, 0x1FFFFFFF
MAX_SHOWN = 60
"""Characters of a damaged line that a message shows."""

LINE = re.compile(
    rb"\((?P<seconds>[0-9]+)\.(?P<fraction>[0-9]+)\) (?P<channel>\S+) (?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    rb"(?:[Rr](?P<remote>[0-8]?)|(?P<data>(?:[0-9A-Fa-f]{2}){0,8}))(?: [RT])?\r?"
)

Bytes = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]


class DamagedLogError(RunFolderError, ValueError):
    """A log with a line that is not a frame; the message names the file, the line's number and the line."""


@dataclass(frozen=True, eq=False)
class CanLog:
    """The frames of a log in their order, each column an (n,) array, read-only.

    time_s : since the epoch, float64, the one next to the number in the text. channel : index in `channels`, uint8.
    arbitration_id : uint32; of an error frame, its class bits. length : bytes of data, uint8; of a remote frame, those
    it asks for. data : (n, 8) uint8, zeros behind the frame's length. channels : names of the buses.
    """

    time_s: npt.NDArray[np.float64]
    channel: Bytes
    arbitration_id: npt.NDArray[np.uint32]
    length: Bytes
    data: Bytes
    is_extended: Flags
    is_remote: Flags
    is_error: Flags
    channels: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, rows: slice | npt.NDArray[Any]) -> CanLog:
        """The frames of these rows: a slice, an array of row numbers or of flags."""
        return _log({name: getattr(self, name)[rows] for name in COLUMNS}, self.channels)


COLUMNS = tuple(field.name for field in fields(CanLog) if field.name != "channels")


def read_can_log(path: Path) -> CanLog:
    """All frames of a log; `path` as for `can_log_blocks`, which see for what is raised."""
    return joined(can_log_blocks(path))


def can_log_blocks(path: Path, block_bytes: int = BLOCK_BYTES) -> Iterator[CanLog]:
    """The frames of a log block by block, for one that is larger than the memory.

    path : the log; where there is none, `path` with .zst or .gz added is read, decompressed. What follows the last line
    end is left out: a killed run may leave a half line there. Raises RunFolderError when there is no log or it can't be
    read, DamagedLogError for a line that is not a classic CAN frame.
    """
    found = find_log(path)
    channels: list[str] = []
    rest, first_line = b"", 1
    with open_log(found) as stream:
        while block := stream.read(block_bytes):
            text = rest + block
            whole = text.rfind(b"\n") + 1
            rest = text[whole:]
            if whole:
                table = _Block(np.frombuffer(text, np.uint8, whole), str(found), first_line, channels)
                yield table.read()
                first_line += table.lines


def joined(blocks: Iterable[CanLog]) -> CanLog:
    """Blocks of one log, one after the other; the memory of each column's parts is free before the next is joined."""
    parts: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in COLUMNS}
    channels: tuple[str, ...] = ()
    for block in blocks:
        channels = block.channels
        for name, column in parts.items():
            column.append(getattr(block, name))
    if not parts["time_s"]:
        return _Block(np.empty(0, np.uint8), "", 1, []).read()
    return _log({name: np.concatenate(parts.pop(name)) for name in COLUMNS}, channels)


def parse_can_log(text: bytes, where: str) -> CanLog:
    """The frames in the text of a log, whole lines only; raises DamagedLogError, `where` first."""
    whole = text[: text.rfind(b"\n") + 1]
    return _Block(np.frombuffer(whole, np.uint8), where, 1, []).read() if whole else joined([])


class _Block:
    """Whole lines of a log. channels : names found so far in the file; new ones are added."""

    def __init__(self, text: Bytes, where: str, first_line: int, channels: list[str]) -> None:
        self._text, self._where, self._first_line, self._channels = text, where, first_line, channels
        ends = np.flatnonzero(text == ord("\n"))
        self._starts = np.concatenate([[0], ends[:-1] + 1])[: len(ends)]
        self._widths = np.minimum(ends - self._starts, TOO_LONG).astype(np.uint8)
        self.lines = len(ends)

    def read(self) -> CanLog:
        columns = _columns(self.lines)
        damaged: list[int] = []
        for width in np.flatnonzero(np.bincount(self._widths)):
            rows = np.flatnonzero(self._widths == width)
            if width == TOO_LONG:
                damaged.append(int(rows[0]))
            if width in (0, TOO_LONG):
                continue
            whole_lines = np.ndarray(self._text.size - int(width) + 1, f"V{width}", self._text, strides=(1,))
            table = np.ascontiguousarray(whole_lines[self._starts[rows]].view(np.uint8).reshape(-1, int(width)).T)
            while len(rows):
                match = LINE.fullmatch(table[:, 0].tobytes())
                if match is None:
                    damaged.append(int(rows[0]))
                    break
                fits = self._read_layout(match, table, rows, columns)
                if fits.all():
                    break
                rows, table = rows[~fits], table[:, ~fits]
        if damaged:
            raise self._error(min(damaged))
        if not self._widths.all():  # empty lines
            columns = {name: column[self._widths > 0] for name, column in columns.items()}
        columns["data"] = columns["data"].view(np.uint8).reshape(-1, MAX_DATA)
        return _log(columns, tuple(self._channels))

    def _read_layout(
        self, match: re.Match[bytes], table: Bytes, rows: npt.NDArray[np.intp], columns: dict[str, Any]
    ) -> Flags:
        """Read the lines that have the layout of the first; returns which of the table's lines these are.

        table : (width, n), characters of lines of one width. rows : (n,), where they go in the columns.
        """
        spans = {name: slice(*match.span(name)) for name in ("seconds", "fraction", "id", "data") if match[name]}
        fits = _fitting(table, spans)
        if not fits.all():
            rows, table = rows[fits], table[:, fits]
        seconds, fraction = (_number(table[spans[name]] - np.uint8(ord("0")), 10) for name in ("seconds", "fraction"))
        scale = 10.0 ** len(match["fraction"])
        columns["time_s"][rows] = (seconds * scale + fraction) / scale
        columns["channel"][rows] = self._channel(match["channel"].decode("ascii", "replace"))
        identifier = _number(_nibbles(table[spans["id"]]), 16).astype(np.uint32)
        columns["arbitration_id"][rows] = identifier & ID_MASK
        if len(match["id"]) == LONG_ID:
            columns["is_error"][rows] = is_error = (identifier & ERROR_FLAG) != 0
            columns["is_extended"][rows] = ~is_error
        if match["remote"] is not None:
            columns["is_remote"][rows] = True
            columns["length"][rows] = int(match["remote"] or 0)
        if match["data"]:
            nibbles = _nibbles(table[spans["data"]])
            data = np.zeros((len(rows), MAX_DATA), np.uint8)
            data.T[: len(nibbles) // 2] = nibbles[::2] << 4 | nibbles[1::2]
            columns["data"][rows] = data.view(np.uint64)[:, 0]
            columns["length"][rows] = len(nibbles) // 2
        return fits

    def _channel(self, name: str) -> int:
        if name not in self._channels:
            self._channels.append(name)
            if len(self._channels) > MAX_CHANNELS:
                raise DamagedLogError(f"{self._where} has more than {MAX_CHANNELS} channels: {name} is one more")
        return self._channels.index(name)

    def _error(self, row: int) -> DamagedLogError:
        """For a line that is not a frame."""
        line = self._text[self._starts[row] :][: MAX_SHOWN + 1].tobytes().partition(b"\n")[0]
        shown = line[:MAX_SHOWN].decode("ascii", "backslashreplace") + ("..." if len(line) > MAX_SHOWN else "")
        kind = "a CAN FD frame, only classic CAN is read" if b"##" in line else "not a frame as candump -L writes it"
        return DamagedLogError(f"{self._where}, line {self._first_line + row} is {kind}: {shown}")


def _columns(rows: int) -> dict[str, npt.NDArray[Any]]:
    """Columns of so many rows, in the order of CanLog's fields; those of data as one number each, of eight bytes."""
    kinds = (np.float64, np.uint8, np.uint32, np.uint8, np.uint64, np.bool_, np.bool_, np.bool_)
    return {name: np.zeros(rows, kind) for name, kind in zip(COLUMNS, kinds, strict=True)}


def _fitting(table: Bytes, spans: dict[str, slice]) -> Flags:
    """(n,) which lines have the first one's characters outside the spans, and digits of the right kind in them.

    All lines at once are looked at first: it takes a tenth of the time, and nearly always all of them fit.
    """
    edges = [0, *(edge for span in spans.values() for edge in (span.start, span.stop)), len(table)]
    checks = [table[a:b] == table[a:b, :1] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    for name, span in spans.items():
        checks.append(_are_digits(table[span], is_decimal=name in ("seconds", "fraction")))
    fits = np.ones(table.shape[1], np.bool_)
    for check in checks:
        if not check.all():
            fits &= check.all(axis=0)
    return fits


def _are_digits(text: Bytes, *, is_decimal: bool) -> Flags:
    is_digit: Flags = text - np.uint8(ord("0")) <= 9
    return is_digit if is_decimal else is_digit | ((text | np.uint8(0x20)) - np.uint8(ord("a")) <= 5)


def _nibbles(text: Bytes) -> Bytes:
    """Values of hexadecimal digits: the low four bits, and 9 more for a letter."""
    return (text & np.uint8(15)) + (text >> np.uint8(6)) * np.uint8(9)


def _number(digits: Bytes, base: int) -> npt.NDArray[np.float64]:
    """(n,) the numbers that columns of digits, (width, n), stand for: exact below 2^53."""
    places = np.power(float(base), np.arange(len(digits) - 1, -1, -1, dtype=np.float64))
    number: npt.NDArray[np.float64] = places @ digits.astype(np.float64)
    return number


def _log(columns: dict[str, Any], channels: tuple[str, ...]) -> CanLog:
    for column in columns.values():
        column.setflags(write=False)
    return CanLog(**columns, channels=channels)
