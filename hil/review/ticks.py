"""Reads `ticks.csv` and `events.jsonl`. If the run was killed, the last line may be incomplete; it is left out."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.core.types import Severity
from hil.edge.record.json_text import read_json
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder

Floats = npt.NDArray[np.float64]

TIME = "t_s"
SEVERITIES = tuple(severity.value for severity in Severity)
LARGE_BYTES = 1 << 24
"""A larger table, of about an hour at 10 Hz, is read in pieces by Arrow, whose import would cost a short run more."""

PIECE_BYTES, BLOCK_BYTES = 1 << 23, 1 << 20
"""Of a table so much is read at once, and handed to Arrow's threads in blocks."""


class MissingColumnError(RunFolderError, KeyError):
    """A table of control steps lacks a column that every record has."""

    __str__ = Exception.__str__


@dataclass(frozen=True, eq=False)
class Ticks:
    """The tick table as columns; each an (n,) array, read-only.

    A run records only the columns that it can have, and older records lack newer ones: `get` gives NaN for those. Empty
    cells, which records of format 1 have, are NaN.
    """

    columns: Mapping[str, Floats]

    def __len__(self) -> int:
        return len(self.columns["t_s"])

    def __getitem__(self, column: str) -> Floats:
        """A column, (n,). Raises MissingColumnError."""
        try:
            return self.columns[column]
        except KeyError:
            raise MissingColumnError(f"the table of control steps, ticks.csv, has no column {column}") from None

    def get(self, column: str) -> Floats:
        """A column, (n,); all NaN where the record does not have it."""
        return self.columns.get(column, np.full(len(self), np.nan))

    def stack(self, *columns: str) -> Floats:
        """Several columns side by side, (n, len(columns))."""
        return np.column_stack([self[column] for column in columns])

    @cached_property
    def has_truth(self) -> bool:
        """Whether the true levels are known at every step."""
        levels_cm = [self.get(f"true_h{tank}_cm") for tank in (1, 2, 3, 4)]
        return len(self) > 0 and bool(np.isfinite(levels_cm).all())


@dataclass(frozen=True, slots=True)
class LoggedEvent:
    """One line of `events.jsonl`."""

    t_s: float
    severity: str
    code: str
    text: str
    data: Mapping[str, Any]


def read_ticks(path: Path, columns: Collection[str] | None = None) -> Ticks:
    """Read a tick table; raises RunFolderError when it is missing or is not one.

    columns : the only ones that are kept, with t_s, where the record has them; None: all. A large table is read in
    pieces, so that the memory is that of the columns kept.
    """
    try:
        if path.stat().st_size > LARGE_BYTES:
            return _read_in_pieces(path, columns)
        raw = path.read_bytes()
    except OSError as error:
        raise RunFolderError(f"cannot read {path}: {error.strerror}") from error
    whole = raw[: raw.rfind(b"\n") + 1]  # what follows the last line end was cut off by a kill
    ticks = parse_ticks(_text(whole, path), str(path))
    if columns is None:
        return ticks
    return Ticks({name: values for name, values in ticks.columns.items() if name in {TIME, *columns}})


def tick_pieces(path: Path, columns: Collection[str] | None = None) -> Iterator[Ticks]:
    """The same rows as `read_ticks` gives, a stretch of them at a time, so that a long table needs little memory."""
    try:
        is_large = path.stat().st_size > LARGE_BYTES
        if is_large:
            for piece, _ in _pieces(path, columns):
                yield Ticks(piece)
    except OSError as error:
        raise RunFolderError(f"cannot read {path}: {error.strerror}") from error
    if not is_large:
        yield read_ticks(path, columns)


def _read_in_pieces(path: Path, columns: Collection[str] | None) -> Ticks:
    """The same as `parse_ticks` of all of the file. Raises OSError, RunFolderError."""
    pieces = _pieces(path, columns)
    table = _Growing(list(next(pieces)[0]))
    for piece, pieces_left in pieces:
        table.add(piece, pieces_left)
    return table.ticks()


def _pieces(path: Path, columns: Collection[str] | None) -> Iterator[tuple[dict[str, Floats], float]]:
    """Columns of a stretch of rows, and about how many such pieces follow; at first, columns without a row.

    Raises OSError, RunFolderError.
    """
    with path.open("rb") as file:
        header = file.readline()
        names = _names(_text(header, path).rstrip("\n"), str(path))
        kept = [name for name in names if columns is None or name in {TIME, *columns}]
        buffer, begin, size = bytearray(PIECE_BYTES), len(header), path.stat().st_size
        yield {name: np.empty(0) for name in kept}, 0.0
        while count := file.readinto(buffer):
            whole = buffer.rfind(b"\n", 0, count) + 1
            if whole == 0:
                if count == len(buffer):
                    raise RunFolderError(f"{path} is damaged: a line has more than {PIECE_BYTES} bytes")
                break  # what follows the last line end was cut off by a kill
            piece = _parse_piece(memoryview(buffer)[:whole], names, kept, path)
            begin += whole
            yield piece, (size - begin) / whole
            file.seek(begin)


class _Growing:
    """Columns that get longer, each in one array from the first piece on, so that no piece is kept beside it."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = names
        self._columns = {name: np.empty(0) for name in names}
        self._rows = 0

    def add(self, piece: Mapping[str, Floats], pieces_left: float) -> None:
        """Append a piece. pieces_left : about how many of its size follow."""
        count = len(piece[TIME])
        end = self._rows + count
        for name, values in piece.items():
            if len(self._columns[name]) < end:
                longer = np.empty(end + int(1.05 * count * pieces_left))  # what is not written takes no memory
                longer[: self._rows] = self._columns[name][: self._rows]
                self._columns[name] = longer
            self._columns[name][self._rows : end] = values
        self._rows = end

    def ticks(self) -> Ticks:
        """What was added, read-only."""
        found = {name: values[: self._rows] for name, values in self._columns.items()}
        for values in found.values():
            values.setflags(write=False)
        return Ticks(found)


def _parse_piece(lines: memoryview, names: Sequence[str], kept: Sequence[str], path: Path) -> dict[str, Floats]:
    """Whole lines as columns, by Arrow's reader: it gives the same numbers as numpy's in a quarter of the time."""
    import pyarrow as pa
    from pyarrow import csv

    try:
        table = csv.read_csv(
            pa.BufferReader(lines),
            read_options=csv.ReadOptions(column_names=list(names), block_size=BLOCK_BYTES),
            convert_options=csv.ConvertOptions(
                include_columns=list(kept),
                column_types=dict.fromkeys(kept, pa.float64()),
                null_values=[""],
            ),
        )
    except pa.ArrowInvalid as error:
        raise RunFolderError(f"{path} is damaged: {error}") from error
    return {name: np.concatenate([_floats(chunk) for chunk in table[name].chunks]) for name in kept}


def _floats(chunk: Any) -> Floats:
    """An Arrow array of float64 as one of numpy, null as NaN. Arrow's own way, `to_numpy`, would import pandas."""
    known = chunk.fill_null(np.nan) if chunk.null_count else chunk
    return np.frombuffer(known.buffers()[1], dtype=np.float64, count=len(known), offset=8 * known.offset)


def parse_ticks(text: str, where: str) -> Ticks:
    """The text of a tick table, whole lines only; raises RunFolderError, `where` first, when it is not one."""
    header, _, body = text.partition("\n")
    names = _names(header, where)
    try:
        values = _numbers(body) if body else np.empty((0, len(names)))
    except ValueError as error:
        raise RunFolderError(f"{where} is damaged: {error}") from error
    if values.shape[1] != len(names):
        raise RunFolderError(f"{where} is damaged: {len(names)} columns named, {values.shape[1]} there")
    values.setflags(write=False)
    return Ticks(dict(zip(names, values.T, strict=True)))


def _text(raw: bytes, path: Path) -> str:
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise RunFolderError(f"{path} is damaged: byte {error.start} is no text ({error.reason})") from error


def _names(header: str, where: str) -> list[str]:
    names = header.split(",")
    if not header:
        raise RunFolderError(f"{where} is empty: no control step was recorded")
    if TIME not in names:
        raise RunFolderError(f"{where} is not a tick table: it has no column {TIME}")
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise RunFolderError(f"{where} is damaged: it has the column {repeated!r} twice")
    return names


def _numbers(body: str) -> Floats:
    """The lines as an (n, m) array. Empty cells are filled first: numpy's fast reader accepts none."""
    filled = body.replace(",,", ",nan,").replace(",,", ",nan,").replace(",\n", ",nan\n")
    return np.loadtxt(io.StringIO(filled), delimiter=",", ndmin=2)


def read_events(path: Path) -> tuple[LoggedEvent, ...]:
    """Read the events; a missing file has none, raises RunFolderError for a line that is not an event."""
    if not path.is_file():
        return ()
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise RunFolderError(f"cannot read {path}: {error.strerror}") from error
    return parse_events(text, str(path))


def parse_events(text: str, where: str) -> tuple[LoggedEvent, ...]:
    """The lines of an event log, a half one at the end left out; raises RunFolderError, `where` first."""
    events: list[LoggedEvent] = []
    for number, line in enumerate(text.split("\n")[:-1], start=1):
        try:
            event = LoggedEvent(**read_json(line))
        except (ValueError, TypeError, RecursionError) as error:
            raise RunFolderError(f"{where}, line {number} is not an event: {error}") from error
        wrong = _wrong_field(event)
        if wrong:
            raise RunFolderError(f"{where}, line {number} is not an event: {wrong}")
        events.append(event)
    return tuple(events)


def _wrong_field(event: LoggedEvent) -> str:
    """What is wrong with the types of an event's fields; "" for nothing."""
    texts = {"severity": event.severity, "code": event.code, "text": event.text}
    for name, value in texts.items():
        if not isinstance(value, str):
            return f"{name} = {value!r} is no text"
    if event.severity not in SEVERITIES:
        return f"severity = {event.severity!r} must be one of {', '.join(SEVERITIES)}"
    if isinstance(event.t_s, bool) or not isinstance(event.t_s, int | float):
        return f"t_s = {event.t_s!r} is no number"
    return "" if isinstance(event.data, dict) else f"data = {event.data!r} is no object"


def read(folder: RunFolder, columns: Collection[str] | None = None) -> tuple[Ticks, tuple[LoggedEvent, ...]]:
    """A run's ticks and events. columns : of the ticks; None: all."""
    return read_ticks(folder.ticks_path, columns), read_events(folder.events_path)
