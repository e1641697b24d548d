"""One MCAP file: a topic for each table, messages in Protocol Buffers with their schema, in the order of their time.

Foxglove, PlotJuggler and Rerun plot the fields. Protocol Buffers rather than JSON: Rerun reads no JSON messages, NaN is
a number there, and a row of numbers is written without a look at each.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from hil.core.types import Severity
from hil.edge.record.record_errors import RunFolderError
from hil.export import protobuf
from hil.export.export_tables import DBC, ExportColumn, ExportTable, FramePiece, RunTables, identifier
from hil.export.frame_data import data_lengths
from hil.export.in_order import InOrder, Tables
from hil.export.mcap_chunks import ChunkedMcap, MessageRows
from hil.export.protobuf import Kind, MessageField

EXTRA = "mcap"
PACKAGE = "fourtank"
KINDS: dict[str, Kind] = {"O": "string", "b": "bool"}
"""Kind of a numpy type -> kind of a field; all other columns are doubles."""

COUNTED = ("arbitration_id", "length")
"""Columns of frames that are whole numbers."""

TIMES, DOUBLE = 2, 8
"""A frame's first columns are its times; bytes of a number."""

LOG_LEVELS = {"UNKNOWN": 0, "DEBUG": 1, "INFO": 2, "WARNING": 3, "ERROR": 4, "FATAL": 5}
"""Of `foxglove.Log`, whose messages viewers show as lines of a log."""
SEVERITIES = {Severity.INFO: "INFO", Severity.WARNING: "WARNING", Severity.ERROR: "ERROR"}
TIMESTAMP = "google/protobuf/timestamp.proto"


class McapTopic:
    """One topic; its channel is made when the first messages are there, and they are numbered from 0."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._channel = self._count = 0

    def rows(
        self, file: ChunkedMcap, about: Description, time_ns: TimesNs, content: list[Content]
    ) -> list[MessageRows]:
        """Messages as records of the file. content : row numbers, and the messages of each size that occurs."""
        if not self._channel and len(time_ns):
            self._channel = file.add_channel(self._name, *about)
        first, self._count = self._count, self._count + len(time_ns)
        return [MessageRows.of(self._channel, time_ns[rows], first + rows, messages) for rows, messages in content]


Description = tuple[str, bytes, dict[str, str]]
"""Of a channel: name of the schema, its FileDescriptorSet, metadata."""
TimesNs = npt.NDArray[np.int64]
Content = tuple[npt.NDArray[np.int64], npt.NDArray[np.uint8]]
"""Numbers of rows, and their messages, (n, size)."""


def write_mcap(run: RunTables, out: Path) -> None:
    """Topics /ticks, /events, /frames, /signals/MESSAGE, and /log with the events as lines of a log.

    The metadata of a topic has the unit of each field. `run` is a metadata record with what was run; run.json and the
    DBC are attached.
    """
    with out.open("wb") as stream:
        file = ChunkedMcap(stream)
        file.start(run.description["program"])
        file.add_metadata("run", run.description)
        start_ns = int(_nanoseconds(np.nan_to_num(np.array([run.zero_s])))[0])
        attached = {"run.json": ("application/json", run.folder.manifest_path.read_bytes())}
        if run.dbc:
            attached[DBC] = ("text/plain", run.dbc.encode())
        for name, (media_type, data) in attached.items():
            file.add_attachment(start_ns, name, media_type, data)
        in_order = InOrder([_steps(run, file), iter([_events(run, file)]), _frames(run, file)])
        for tables in in_order:
            file.add_messages(tables)
        file.finish()


def _steps(run: RunTables, file: ChunkedMcap) -> Tables:
    topic = McapTopic("/ticks")
    for table in run.step_pieces():
        yield _of_numbers(table, topic, file)


def _of_numbers(table: ExportTable, topic: McapTopic, file: ChunkedMcap) -> list[MessageRows]:
    """A table with numbers only."""
    fields = [MessageField(identifier(column.name), "double") for column in table.columns]
    rows = protobuf.rows_of_doubles([column.values for column in table.columns])
    about = _described(table, fields)
    return topic.rows(file, about, _nanoseconds(table.time_s), [(np.arange(len(table)), rows)])


def _events(run: RunTables, file: ChunkedMcap) -> list[MessageRows]:
    """Both topics of events."""
    table = run.events()
    kinds = [_kind(column) for column in table.columns]
    fields = [MessageField(identifier(column.name), kind) for column, kind in zip(table.columns, kinds, strict=True)]
    values = zip(*(column.values for column in table.columns), strict=True)
    messages = [protobuf.row(kinds, row) for row in values]
    time_ns = _nanoseconds(table.time_s)
    rows = McapTopic("/events").rows(file, _described(table, fields), time_ns, _by_size(messages))
    return rows + McapTopic("/log").rows(file, _log_described(), time_ns, _by_size(_log_lines(run, time_ns)))


def _by_size(messages: list[bytes]) -> list[Content]:
    sizes = np.array([len(message) for message in messages], dtype=np.int64)
    content = []
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        joined = np.frombuffer(b"".join(messages[row] for row in rows.tolist()), np.uint8)
        content.append((rows, joined.reshape(len(rows), size)))
    return content


def _frames(run: RunTables, file: ChunkedMcap) -> Tables:
    """Frames, and the signals in them."""
    topic, of_message = McapTopic("/frames"), dict[str, McapTopic]()
    for piece in run.frame_pieces():
        table = run.frame_columns(piece)
        kinds = [*(_kind(column) for column in table.columns), "bytes"]
        names = [*(column.name for column in table.columns), "data"]
        about = _described(table, [MessageField(*both) for both in zip(names, kinds, strict=True)])
        tables = topic.rows(file, about, _nanoseconds(table.time_s), _frame_messages(piece, table, kinds))
        for signals in run.messages(piece.log):
            one = of_message.setdefault(signals.name, McapTopic(f"/signals/{signals.name}"))
            tables += _of_numbers(signals, one, file)
        yield tables


def _frame_messages(piece: FramePiece, table: ExportTable, kinds: list[Kind]) -> list[Content]:
    """Frames that differ in their times and data alone have one layout: the first is written, the others are copies.

    The two times are the first fields of a message, the data is the last.
    """
    log, lengths = piece.log, data_lengths(piece.log)
    if not len(log):
        return []
    key = log.arbitration_id.astype(np.uint64)
    flags = (log.is_extended, log.is_remote, log.is_error, piece.is_sent)
    for value, bits in (*((flag, 1) for flag in flags), (log.length, 8), (log.channel, 8)):
        key = key << np.uint64(bits) | value.astype(np.uint64)
    _, first, kind_of, counts = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    rows_of = np.split(np.argsort(kind_of, kind="stable"), np.cumsum(counts)[:-1])
    content = []
    for at, rows in zip(first.tolist(), rows_of, strict=True):
        size = int(lengths[at])
        values = [column.values[at].item() if column.values.dtype.kind != "O" else column.values[at]
                  for column in table.columns]  # fmt: skip
        message = protobuf.row(kinds, [*values, log.data[at, :size].tobytes()])
        messages = np.tile(np.frombuffer(message, np.uint8), (len(rows), 1))
        for place, column in enumerate(table.columns[:TIMES]):
            begin = place * (DOUBLE + 1) + 1
            messages[:, begin : begin + DOUBLE] = column.values[rows].astype("<f8").view(np.uint8).reshape(-1, DOUBLE)
        if size:
            messages[:, -size:] = log.data[rows, :size]
        content.append((rows, messages))
    return content


def _kind(column: ExportColumn) -> Kind:
    if column.name in COUNTED:
        return "uint32"
    return KINDS.get(column.values.dtype.kind, "double")


def _described(table: ExportTable, fields: list[MessageField]) -> Description:
    schema = table.name[:1].upper() + table.name[1:]
    file = protobuf.file_descriptor(f"{table.name}.proto", PACKAGE, [protobuf.message_type(schema, fields)])
    metadata = {f"unit.{identifier(column.name)}": column.unit for column in table.columns if column.unit}
    for column in table.columns:
        if column.choices:
            names = ", ".join(f"{number}: {text}" for number, text in sorted(column.choices.items()))
            metadata[f"choices.{identifier(column.name)}"] = names
    return f"{PACKAGE}.{schema}", protobuf.descriptor_set(file), metadata


def _log_described() -> Description:
    """Of `foxglove.Log`."""
    fields = [
        MessageField("timestamp", "message", ".google.protobuf.Timestamp"),
        MessageField("level", "enum", ".foxglove.Log.Level"),
        MessageField("message", "string"),
        MessageField("name", "string"),
    ]
    moment = protobuf.message_type("Timestamp", [MessageField("seconds", "int64"), MessageField("nanos", "int32")])
    log = protobuf.message_type("Log", fields, protobuf.item(4, protobuf.enum_type("Level", LOG_LEVELS)))
    files = protobuf.descriptor_set(
        protobuf.file_descriptor(TIMESTAMP, "google.protobuf", [moment]),
        protobuf.file_descriptor("foxglove/Log.proto", "foxglove", [log], [TIMESTAMP]),
    )
    return "foxglove.Log", files, {}


def _log_lines(run: RunTables, time_ns: TimesNs) -> list[bytes]:
    """Events as messages of `foxglove.Log`."""
    messages = []
    for at_ns, event in zip(time_ns.tolist(), run.logged, strict=True):
        stamp = protobuf.row(("int64", "int32"), divmod(at_ns, 10**9))
        level = LOG_LEVELS[SEVERITIES.get(Severity(event.severity), "UNKNOWN")]
        messages.append(protobuf.row(("message", "enum", "string", "string"), (stamp, level, event.text, event.code)))
    return messages


def _nanoseconds(time_s: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Whole microseconds, which the record has; MCAP knows no time before the epoch."""
    return np.maximum(np.round(time_s * 1e6).astype(np.int64), 0) * 1000


def require() -> None:
    """Raise RunFolderError if mcap is not there."""
    from importlib.util import find_spec

    if find_spec("mcap") is None:
        raise RunFolderError(f"--to mcap needs mcap, which is not installed: pip install 'fourtank-hil[{EXTRA}]'")
