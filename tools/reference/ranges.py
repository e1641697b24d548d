"""What a settings key accepts, in words, from the type and the checks of its field."""

from __future__ import annotations

import types
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo

MAX_LISTED = 8
"""More choices than this have a page of their own."""


def table_of(field: FieldInfo) -> tuple[type[BaseModel] | None, bool]:
    """Model of a field that is a table, or None; and whether it is a list of tables."""
    for part in _alternatives(field.annotation):
        if isinstance(part, type) and issubclass(part, BaseModel):
            return part, False
        if get_origin(part) is tuple:
            inner = _bare(get_args(part)[0])
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                return inner, True
    return None, False


def range_of(field: FieldInfo) -> str:
    """What the field accepts: "0 < value <= 10", `"stop"`, "2 numbers, each 0 <= value <= 10"."""
    return _words(field.annotation, field.metadata)


def _words(kind: Any, metadata: Iterable[Any]) -> str:
    own = list(metadata)
    while get_origin(kind) is Annotated:
        kind, *more = get_args(kind)
        for one in more:
            own += one.metadata if isinstance(one, FieldInfo) else [one]
    stated = [text for one in own if (text := getattr(one, "text", ""))]
    parts = _alternatives(kind)
    if len(parts) > 1 and not stated:
        return " or ".join(dict.fromkeys(_words(part, own) for part in parts))
    kind = parts[0]
    if get_origin(kind) is Annotated:
        return _words(kind, own)
    if get_origin(kind) is tuple:
        return _list_words(get_args(kind), own)
    return stated[0] if stated else _scalar_words(kind, own)


def _list_words(entries: tuple[Any, ...], metadata: list[Any]) -> str:
    least = next((one.min_length for one in metadata if isinstance(one, MinLen)), 0)
    each = _words(entries[0], ())
    if entries[-1] is Ellipsis:
        return f"list of {each}" + (f", at least {least}" if least else "")
    return f"{len(entries)} numbers, each {each}"


def _scalar_words(kind: Any, metadata: list[Any]) -> str:
    if get_origin(kind) is Literal:
        return _choices(get_args(kind))
    if isinstance(kind, type) and issubclass(kind, Enum):
        return _choices([choice.value for choice in kind])
    if kind is bool:
        return "`true`, `false`"
    if kind is str:
        return "text"
    if get_origin(kind) is dict:
        return "table"
    if kind not in (int, float):
        return "number or name"
    return _limits(metadata) or ("whole number" if kind is int else "number")


def _choices(names: Sequence[object]) -> str:
    return ", ".join(f'`"{name}"`' for name in names) if len(names) <= MAX_LISTED else f"one of {len(names)} names"


def _limits(metadata: list[Any]) -> str:
    low = high = ""
    for one in metadata:
        if isinstance(one, Gt):
            low = f"{one.gt:g} < "
        elif isinstance(one, Ge):
            low = f"{one.ge:g} ≤ "
        elif isinstance(one, Lt):
            high = f" < {one.lt:g}"
        elif isinstance(one, Le):
            high = f" ≤ {one.le:g}"
    return f"{low}value{high}" if low or high else ""


def _bare(kind: Any) -> Any:
    while get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    return kind


def _alternatives(kind: Any) -> list[Any]:
    """The types that a union is made of, None left out."""
    kind = _bare(kind)
    if get_origin(kind) in (Union, types.UnionType):
        return [part for part in get_args(kind) if part is not type(None)]
    return [kind]
