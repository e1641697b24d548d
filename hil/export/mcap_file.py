"""One MCAP file: a topic for each table, messages in Protocol Buffers with their schema, in the order of their time.

Foxglove, PlotJuggler and Rerun plot the fields. Protocol Buffers rather than JSON: Rerun reads no JSON messages, NaN is
a number there, and a row of numbers is written without a look at each.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hil.core.types import Severity
from hil.edge.record.run_folder import RunFolderError
from hil.export import protobuf
from hil.export.export_tables import DBC, ExportColumn, ExportTable, RunTables, identifier
from hil.export.frame_data import data_lengths
from hil.export.protobuf import Kind, MessageField

if TYPE_CHECKING:
    from mcap.writer import Writer

EXTRA = "mcap"
PACKAGE = "fourtank"
KINDS: dict[str, Kind] = {"O": "string", "b": "bool"}
"""Kind of a numpy type -> kind of a field; all other columns are doubles."""

COUNTED = ("arbitration_id", "length")
"""Columns of frames that are whole numbers."""

LOG_LEVELS = {"UNKNOWN": 0, "DEBUG": 1, "INFO": 2, "WARNING": 3, "ERROR": 4, "FATAL": 5}
"""Of `foxglove.Log`, whose messages viewers show as lines of a log."""
SEVERITIES = {Severity.INFO: "INFO", Severity.WARNING: "WARNING", Severity.ERROR: "ERROR"}
TIMESTAMP = "google/protobuf/timestamp.proto"


@dataclass(frozen=True, eq=False)
class Topic:
    """Messages of one kind. time_ns : (n,) since the epoch. schema : name, and a FileDescriptorSet."""

    name: str
    schema: str
    description: bytes
    time_ns: npt.NDArray[np.int64]
    messages: list[bytes]
    metadata: dict[str, str]


def write_mcap(run: RunTables, out: Path) -> None:
    """Topics /ticks, /events, /frames, /signals/MESSAGE, and /log with the events as lines of a log.

    The metadata of a topic has the unit of each field. `run` is a metadata record with what was run; run.json and the
    DBC are attached.
    """
    from mcap.writer import CompressionType, Writer

    topics = [_of_numbers(run.control_steps(), "/ticks"), _of_rows(run.events(), "/events"), _log(run), _frames(run)]
    topics += [_of_numbers(table, f"/signals/{table.name}") for table in run.messages()]
    with out.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(library=run.description["program"])
        writer.add_metadata("run", run.description)
        start_ns = min((int(topic.time_ns.min()) for topic in topics if len(topic.time_ns)), default=0)
        attached = {"run.json": ("application/json", run.folder.manifest_path.read_bytes())}
        if run.dbc:
            attached[DBC] = ("text/plain", run.dbc.encode())
        for name, (media_type, data) in attached.items():
            writer.add_attachment(start_ns, start_ns, name, media_type, data)
        _write(writer, topics)
        writer.finish()  # type: ignore[no-untyped-call]  # it has no types


def _write(writer: Writer, topics: list[Topic]) -> None:
    """All messages by their time; those of one time in the order of the topics."""
    channels = []
    for topic in topics:
        schema = writer.register_schema(topic.schema, "protobuf", topic.description)
        channels.append(writer.register_channel(topic.name, "protobuf", schema, topic.metadata))
    sizes = [len(topic.messages) for topic in topics]
    which = np.repeat(np.arange(len(topics)), sizes)
    index = np.concatenate([np.arange(size) for size in sizes])
    time_ns = np.concatenate([topic.time_ns for topic in topics])
    order = np.argsort(time_ns, kind="stable")
    for at_ns, topic, place in zip(time_ns[order].tolist(), which[order].tolist(), index[order].tolist(), strict=True):
        writer.add_message(channels[topic], at_ns, topics[topic].messages[place], at_ns, place)


def _of_numbers(table: ExportTable, name: str) -> Topic:
    """A table with numbers only."""
    fields = [MessageField(identifier(column.name), "double") for column in table.columns]
    rows = protobuf.rows_of_doubles([column.values for column in table.columns])
    return _topic(table, name, fields, rows)


def _of_rows(table: ExportTable, name: str) -> Topic:
    """A table with text in it."""
    kinds = [_kind(column) for column in table.columns]
    fields = [MessageField(identifier(column.name), kind) for column, kind in zip(table.columns, kinds, strict=True)]
    values = zip(*(column.values for column in table.columns), strict=True)
    return _topic(table, name, fields, [protobuf.row(kinds, row) for row in values])


def _frames(run: RunTables) -> Topic:
    table = run.frame_columns()
    data = [row[:size].tobytes() for row, size in zip(run.frames.data, data_lengths(run.frames), strict=True)]
    kinds = [*(_kind(column) for column in table.columns), "bytes"]
    names = [*(column.name for column in table.columns), "data"]
    fields = [MessageField(name, kind) for name, kind in zip(names, kinds, strict=True)]
    values = zip(*(column.values.tolist() for column in table.columns), data, strict=True)
    return _topic(table, "/frames", fields, [protobuf.row(kinds, row) for row in values])


def _kind(column: ExportColumn) -> Kind:
    if column.name in COUNTED:
        return "uint32"
    return KINDS.get(column.values.dtype.kind, "double")


def _topic(table: ExportTable, name: str, fields: list[MessageField], messages: list[bytes]) -> Topic:
    schema = table.name[:1].upper() + table.name[1:]
    file = protobuf.file_descriptor(f"{table.name}.proto", PACKAGE, [protobuf.message_type(schema, fields)])
    metadata = {f"unit.{identifier(column.name)}": column.unit for column in table.columns if column.unit}
    for column in table.columns:
        if column.choices:
            names = ", ".join(f"{number}: {text}" for number, text in sorted(column.choices.items()))
            metadata[f"choices.{identifier(column.name)}"] = names
    return Topic(
        name, f"{PACKAGE}.{schema}", protobuf.descriptor_set(file), _nanoseconds(table.time_s), messages, metadata
    )


def _log(run: RunTables) -> Topic:
    """Events as `foxglove.Log`."""
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
    time_ns = _nanoseconds(run.events().time_s)
    messages = []
    for at_ns, event in zip(time_ns.tolist(), run.logged, strict=True):
        stamp = protobuf.row(("int64", "int32"), divmod(at_ns, 10**9))
        level = LOG_LEVELS[SEVERITIES.get(Severity(event.severity), "UNKNOWN")]
        messages.append(protobuf.row(("message", "enum", "string", "string"), (stamp, level, event.text, event.code)))
    return Topic("/log", "foxglove.Log", files, time_ns, messages, {})


def _nanoseconds(time_s: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Whole microseconds, which the record has; MCAP knows no time before the epoch."""
    return np.maximum(np.round(time_s * 1e6).astype(np.int64), 0) * 1000


def require() -> None:
    """Raise RunFolderError if mcap is not there."""
    from importlib.util import find_spec

    if find_spec("mcap") is None:
        raise RunFolderError(f"--to mcap needs mcap, which is not installed: pip install 'fourtank-hil[{EXTRA}]'")
