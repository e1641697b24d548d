"""An MCAP file (version 0, https://mcap.dev/spec) whose messages are laid out by numpy, many at a time.

A day has 24 million messages. One after the other they would take a quarter of an hour and several gigabytes; here the
messages of one size are rows of a table, and a chunk of the file is put together from such tables.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

CHUNK_BYTES = 1 << 20
"""Of messages, before compression: what a viewer reads at once."""

MAGIC = b"\x89MCAP0\r\n"
COMPRESSION = "zstd"
MESSAGE, MESSAGE_INDEX = 0x05, 0x07
"""Codes of records."""
HEAD = np.dtype(
    [("code", "u1"), ("length", "<u8"), ("channel", "<u2"), ("number", "<u4"), ("log", "<u8"), ("sent", "<u8")]
)
OUTSIDE_LENGTH = 9
"""Bytes of a record that its length does not count."""
ENTRY = np.dtype([("time_ns", "<u8"), ("offset", "<u8")])


@dataclass(frozen=True, eq=False)
class MessageRows:
    """Messages of one channel that have one size.

    time_ns, number : (n,) when, and which in its channel. records : (n, size) each a whole record of the file.
    """

    channel: int
    time_ns: npt.NDArray[np.int64]
    number: npt.NDArray[np.int64]
    records: npt.NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        channel: int,
        time_ns: npt.NDArray[np.int64],
        number: npt.NDArray[np.int64],
        content: npt.NDArray[np.uint8],
    ) -> MessageRows:
        """Put the heads of records before messages. content : (n, size)."""
        count, size = content.shape
        head = np.zeros(count, HEAD)
        head["code"], head["length"], head["channel"] = MESSAGE, HEAD.itemsize - OUTSIDE_LENGTH + size, channel
        head["number"], head["log"], head["sent"] = number, time_ns, time_ns
        records = np.empty((count, HEAD.itemsize + size), np.uint8)
        records[:, : HEAD.itemsize] = head.view(np.uint8).reshape(count, HEAD.itemsize)
        records[:, HEAD.itemsize :] = content
        return cls(channel, time_ns, number, records)

    def __len__(self) -> int:
        return len(self.time_ns)

    def taken(self, rows: npt.NDArray[Any]) -> MessageRows:
        """These rows: numbers or flags."""
        return MessageRows(self.channel, self.time_ns[rows], self.number[rows], self.records[rows])


@dataclass
class ChunkedMcap:
    """Writes records to a stream that can tell where it is. Channels are numbered from 1, each with its own schema."""

    stream: BinaryIO
    _schemas: list[Any] = field(default_factory=list)
    _channels: list[Any] = field(default_factory=list)
    _chunks: list[Any] = field(default_factory=list)
    _attachments: list[Any] = field(default_factory=list)
    _metadata: list[Any] = field(default_factory=list)
    _counts: dict[int, int] = field(default_factory=dict)
    _span_ns: tuple[int, int] | None = None

    def start(self, library: str) -> None:
        """The beginning of the file."""
        from mcap.records import Header

        self.stream.write(MAGIC)
        self.stream.write(_bytes(Header("", library)))

    def add_channel(self, topic: str, schema: str, description: bytes, metadata: dict[str, str]) -> int:
        """A channel of messages in Protocol Buffers. schema : name; description : its FileDescriptorSet."""
        from mcap.records import Channel, Schema

        number = len(self._channels) + 1
        self._schemas.append(Schema(id=number, data=description, encoding="protobuf", name=schema))
        self._channels.append(
            Channel(id=number, topic=topic, message_encoding="protobuf", metadata=metadata, schema_id=number)
        )
        self.stream.write(_bytes(self._schemas[-1]) + _bytes(self._channels[-1]))
        return number

    def add_metadata(self, name: str, content: dict[str, str]) -> None:
        """A record of texts by name."""
        from mcap.records import Metadata, MetadataIndex

        record = _bytes(Metadata(name=name, metadata=content))
        self._metadata.append(MetadataIndex(offset=self.stream.tell(), length=len(record), name=name))
        self.stream.write(record)

    def add_attachment(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """A file within the file."""
        from mcap.records import Attachment, AttachmentIndex

        record = _bytes(Attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data))
        place, size = self.stream.tell(), len(data)
        self._attachments.append(
            AttachmentIndex(
                offset=place,
                length=len(record),
                log_time=time_ns,
                create_time=time_ns,
                data_size=size,
                name=name,
                media_type=media_type,
            )
        )
        self.stream.write(record)

    def add_messages(self, tables: Sequence[MessageRows]) -> None:
        """Messages in the order of their time, in chunks; of equal times, in the order of the tables."""
        if not any(len(table) for table in tables):
            return
        times_ns = np.concatenate([table.time_ns for table in tables])
        channels = np.concatenate([np.full(len(table), table.channel, np.uint16) for table in tables])
        sizes = np.concatenate([np.full(len(table), table.records.shape[1]) for table in tables])
        numbers = np.concatenate([table.number for table in tables])
        order = np.lexsort((numbers, channels, times_ns))
        ends = np.cumsum(sizes[order])
        place = np.empty(len(order), np.int64)
        place[order] = ends - sizes[order]
        content = _laid_out(tables, place, int(ends[-1]))
        times_ns, channels, begins = times_ns[order], channels[order], ends - sizes[order]
        first = 0
        while first < len(order):
            behind = max(int(np.searchsorted(ends, begins[first] + CHUNK_BYTES, side="right")), first + 1)
            rows = slice(first, behind)
            data = content[int(begins[first]) : int(ends[behind - 1])]
            self._add_chunk(data, times_ns[rows], channels[rows], begins[rows] - begins[first])
            first = behind

    def _add_chunk(
        self,
        data: npt.NDArray[np.uint8],
        times_ns: npt.NDArray[np.int64],
        channels: npt.NDArray[np.uint16],
        offsets: npt.NDArray[np.int64],
    ) -> None:
        import pyarrow as pa
        from mcap.records import Chunk, ChunkIndex

        plain = data.tobytes()
        packed = pa.compress(plain, codec=COMPRESSION, asbytes=True)
        begin_ns, end_ns, start = int(times_ns.min()), int(times_ns.max()), self.stream.tell()
        record = _bytes(
            Chunk(
                compression=COMPRESSION,
                data=packed,
                message_end_time=end_ns,
                message_start_time=begin_ns,
                uncompressed_crc=zlib.crc32(plain),
                uncompressed_size=len(plain),
            )
        )
        self.stream.write(record)
        index_start, places = self.stream.tell(), {}
        for channel in np.flatnonzero(np.bincount(channels)).tolist():
            rows = channels == channel
            entries = np.empty(int(rows.sum()), ENTRY)
            entries["time_ns"], entries["offset"] = times_ns[rows], offsets[rows]
            places[channel] = self.stream.tell()
            listed = entries.tobytes()
            self.stream.write(struct.pack("<BQHI", MESSAGE_INDEX, 6 + len(listed), channel, len(listed)) + listed)
            self._counts[channel] = self._counts.get(channel, 0) + len(entries)
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=start,
                compression=COMPRESSION,
                compressed_size=len(packed),
                message_end_time=end_ns,
                message_index_length=self.stream.tell() - index_start,
                message_index_offsets=places,
                message_start_time=begin_ns,
                uncompressed_size=len(plain),
            )
        )
        before = self._span_ns or (begin_ns, end_ns)
        self._span_ns = min(before[0], begin_ns), max(before[1], end_ns)

    def finish(self) -> None:
        """The end of the file: what is in it, and where."""
        from mcap.opcode import Opcode
        from mcap.records import DataEnd, Footer, SummaryOffset

        self.stream.write(_bytes(DataEnd(0)))
        start, summary, offsets = self.stream.tell(), b"", b""
        groups = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        for code, records in groups:
            group = b"".join(map(_bytes, records))
            if group:
                where = SummaryOffset(group_opcode=code, group_start=start + len(summary), group_length=len(group))
                offsets += _bytes(where)
            summary += group
        offsets_start = start + len(summary)
        whole = summary + offsets
        footer = _bytes(Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=0))
        crc = zlib.crc32(footer[:-4], zlib.crc32(whole))
        self.stream.write(whole + footer[:-4] + struct.pack("<I", crc) + MAGIC)

    def _statistics(self) -> Any:
        from mcap.records import Statistics

        begin_ns, end_ns = self._span_ns or (0, 0)
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=end_ns,
            message_start_time=begin_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _laid_out(tables: Sequence[MessageRows], place: npt.NDArray[np.int64], size: int) -> npt.NDArray[np.uint8]:
    """(size,) all records. place : where each begins, those of the tables one after the other."""
    content = np.empty(size, np.uint8)
    done = 0
    for table in tables:
        if not len(table):
            continue
        width = table.records.shape[1]
        whole = np.ndarray(size - width + 1, f"V{width}", content, strides=(1,))
        rows = np.ascontiguousarray(table.records).view(f"V{width}")[:, 0]
        whole[place[done : done + len(table)]] = rows
        done += len(table)
    return content


def _bytes(record: Any) -> bytes:
    from mcap.data_stream import RecordBuilder

    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
