"""Protocol Buffers as far as MCAP needs them: a message's description, and messages of numbers, all rows at once.

Encoding: https://protobuf.dev/programming-guides/encoding; descriptions: descriptor.proto of the same project.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Kind = Literal["double", "int32", "int64", "uint32", "bool", "string", "bytes", "message", "enum"]

TYPES: Mapping[Kind, int] = {
    "double": 1, "int64": 3, "int32": 5, "bool": 8, "string": 9, "message": 11, "bytes": 12, "uint32": 13, "enum": 14,
}  # fmt: skip
"""Numbers of FieldDescriptorProto.Type."""

VARINT, FIXED64, LENGTH = 0, 1, 2
NUMBERS = ("int32", "int64", "uint32", "bool", "enum")
"""Kinds that are varints; here never negative."""
OPTIONAL = 1


@dataclass(frozen=True, slots=True)
class MessageField:
    """A field; type_name : of a message or enumeration, with its package, such as ".google.protobuf.Timestamp"."""

    name: str
    kind: Kind
    type_name: str = ""


def varint(number: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def item(number: int, value: int | str | bytes) -> bytes:
    """A field with its tag: a number as a varint, text and bytes with their length."""
    if isinstance(value, int):
        return varint(number << 3 | VARINT) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | LENGTH) + varint(len(data)) + data


def message_type(name: str, fields: Iterable[MessageField], *nested: bytes) -> bytes:
    """A DescriptorProto; fields are numbered from 1. nested : its further items."""
    parts = [item(1, name)]
    for number, field in enumerate(fields, start=1):
        about = item(1, field.name) + item(3, number) + item(4, OPTIONAL) + item(5, TYPES[field.kind])
        parts.append(item(2, about + (item(6, field.type_name) if field.type_name else b"")))
    return b"".join((*parts, *nested))


def enum_type(name: str, values: Mapping[str, int]) -> bytes:
    """An EnumDescriptorProto."""
    return item(1, name) + b"".join(item(2, item(1, text) + item(2, number)) for text, number in values.items())


def file_descriptor(name: str, package: str, messages: Iterable[bytes], depends_on: Sequence[str] = ()) -> bytes:
    """A FileDescriptorProto in the syntax of proto3."""
    head = item(1, name) + item(2, package) + b"".join(item(3, other) for other in depends_on)
    return head + b"".join(item(4, message) for message in messages) + item(12, "proto3")


def descriptor_set(*files: bytes) -> bytes:
    """A FileDescriptorSet; files after those that they depend on."""
    return b"".join(item(1, file) for file in files)


def rows_of_doubles(columns: Sequence[npt.NDArray[Any]]) -> npt.NDArray[np.uint8]:
    """(n, size) a message for each row, whose fields are doubles: all have one size, so one table has them."""
    if not columns:
        return np.zeros((0, 0), np.uint8)
    tags = [varint(number << 3 | FIXED64) for number in range(1, len(columns) + 1)]
    layout = np.dtype([part for k, tag in enumerate(tags) for part in ((f"t{k}", f"S{len(tag)}"), (f"v{k}", "<f8"))])
    table = np.zeros(len(columns[0]), layout)
    for k, (tag, column) in enumerate(zip(tags, columns, strict=True)):
        table[f"t{k}"], table[f"v{k}"] = tag, column
    return table.view(np.uint8).reshape(len(table), layout.itemsize)


def row(kinds: Sequence[Kind], values: Sequence[Any]) -> bytes:
    """One message; whole numbers are not negative."""
    parts = []
    for number, (kind, value) in enumerate(zip(kinds, values, strict=True), start=1):
        if kind == "double":
            parts.append(varint(number << 3 | FIXED64) + np.float64(value).tobytes())
        else:
            parts.append(item(number, int(value) if kind in NUMBERS else value))
    return b"".join(parts)
