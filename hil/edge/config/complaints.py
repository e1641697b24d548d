"""What is wrong with settings, in the words of the file: key, value, and what is allowed there.

The library that checks them (pydantic) has wordings of its own, for programmers. Here each of its errors is said by
what the field accepts, which is read from the field itself, so that a new field needs no text.
"""

from __future__ import annotations

import types
from collections.abc import Iterable, Iterator, Sequence
from enum import Enum
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from hil.core.counted import counted

MAX_NAMED = 6
MAX_SHOWN = 80
NAME_WORDS = "must be a name of letters, digits, '_', '-' and '.', at most 64, a letter or digit first"

Location = tuple[int | str, ...]


def complaint(model: type[BaseModel], error: ValidationError) -> str:
    """The first thing at fault as one line: "key = value: what is allowed", or "missing: " with all missing keys.

    Unknown keys, which may be meant for missing ones, are named with these. Further keys at fault are counted.
    """
    details = error.errors(include_url=False)
    missing = [_key(detail["loc"]) for detail in details if _is_missing(detail)]
    if _is_missing(details[0]):
        rest = f" and {len(missing) - MAX_NAMED} more" if missing[MAX_NAMED:] else ""
        named = ", ".join(missing[:MAX_NAMED]) + rest
        unknown = [_key(detail["loc"]) for detail in details if detail["type"] == "extra_forbidden"]
        others = len({_place(model, detail)[0] for detail in details if not _is_missing(detail)}) - len(unknown)
        misspelt = f"; unknown key: {', '.join(unknown[:MAX_NAMED])}" if unknown else ""
        return f"missing: {named}{misspelt}" + (f" (and {others} more to correct)" if others > 0 else "")
    place, kind = _place(model, details[0])
    value, said = _value(details[0]), _words(details[0], kind)
    subject = f"{_key(place)}{value}: " if place else ""
    places = {_place(model, detail)[0] for detail in details}
    more = sum(other != place[: len(other)] and place != other[: len(place)] for other in places)
    return f"{subject}{said}" + (f" (and {more} more to correct)" if more else "")


def _is_missing(detail: ErrorDetails) -> bool:
    """A key that is not there; an entry that a list lacks is another thing: the list is too short."""
    return detail["type"] == "missing" and isinstance(detail["loc"][-1], str)


def _value(detail: ErrorDetails) -> str:
    if isinstance(detail["input"], dict) or detail["input"] is None:  # a file has no None: the key is not there
        return ""
    shown = repr(_as_list(detail["input"]))
    return f" = {shown if len(shown) <= MAX_SHOWN else shown[:MAX_SHOWN] + ' ...'}"


def _as_list(value: Any) -> Any:
    """As the file has it: a list, not a tuple."""
    return [_as_list(one) for one in value] if isinstance(value, (list, tuple)) else value


def _words(detail: ErrorDetails, kind: Any) -> str:
    match detail["type"]:
        case "value_error":
            return str(detail["ctx"]["error"])
        case "extra_forbidden":
            return "unknown key"
        case "string_pattern_mismatch":
            return NAME_WORDS
        case "finite_number":
            return f"must be finite: {accepted(kind)}"
    return f"must be {accepted(kind)}"


def accepted(kind: Any) -> str:
    """What a field of this annotation accepts: "a number above 0", "a list of 2, each a number from 0 to 10"."""
    kind, metadata = _bare(kind)
    options = [option for option in _options(kind) if option is not type(None)]
    if len(options) > 1:
        return " or ".join(dict.fromkeys(accepted(option) for option in options))
    if options[0] is not kind:
        return accepted(Annotated[options[0], *metadata] if metadata else options[0])
    if get_origin(kind) is Literal:
        choices = ", ".join(repr(choice) for choice in get_args(kind))
        return f"one of {choices}" if len(get_args(kind)) > 1 else choices
    if get_origin(kind) is tuple:
        return _accepted_list(get_args(kind), metadata)
    if kind in (int, float):
        return ("a whole number" if kind is int else "a number") + _limits(metadata)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return "one of " + ", ".join(repr(choice.value) for choice in kind)
    if kind is str:
        return "a text" + _length(metadata)
    return "true or false" if kind is bool else "a table"


def _length(metadata: Iterable[Any]) -> str:
    """Of a text."""
    least = next((one.min_length for one in metadata if isinstance(one, MinLen)), 0)
    most = next((one.max_length for one in metadata if isinstance(one, MaxLen)), None)
    if most is None:
        return f" of at least {counted(least, 'character')}" if least else ""
    return f" of {least} to {most} characters" if least else f" of at most {counted(most, 'character')}"


def _accepted_list(entries: Sequence[Any], metadata: Iterable[Any]) -> str:
    each = accepted(entries[0])
    if entries[-1] is not Ellipsis:
        return f"a list of {len(entries)}, each {each}"
    least = next((one.min_length for one in metadata if isinstance(one, MinLen)), 0)
    return f"a list, each entry {each}" + (f", with at least {least}" if least else "")


def _limits(metadata: Iterable[Any]) -> str:
    found = list(metadata)
    low = next((f"above {one.gt:.10g}" for one in found if isinstance(one, Gt)), "") or next(
        (f"at least {one.ge:.10g}" for one in found if isinstance(one, Ge)), ""
    )
    high = next((f"below {one.lt:.10g}" for one in found if isinstance(one, Lt)), "") or next(
        (f"at most {one.le:.10g}" for one in found if isinstance(one, Le)), ""
    )
    return "".join(f"{' ' if index == 0 else ' and '}{part}" for index, part in enumerate(filter(None, (low, high))))


def _place(model: type[BaseModel], detail: ErrorDetails) -> tuple[Location, Any]:
    """Where the error is, as the file has it, and the annotation of that place.

    The library's own location also names the alternatives of a union, and entries that a list lacks.
    """
    place: list[int | str] = []
    kind: Any = model
    location = detail["loc"]
    if detail["type"] == "missing":
        location = location[:-1]  # of a list; missing keys are listed elsewhere
    for part in location:
        below = next(_below(kind, part), None)
        if below is None:
            if detail["type"] == "extra_forbidden":
                place.append(part)
            continue
        place.append(part)
        kind = below
    return tuple(place), kind


def _below(kind: Any, part: int | str) -> Iterator[Any]:
    """The annotation of a key or an entry; nothing for the name of an alternative."""
    for option in _options(_bare(kind)[0]):
        bare, _ = _bare(option)
        if isinstance(part, str) and isinstance(bare, type) and issubclass(bare, BaseModel):
            field = bare.model_fields.get(part)
            if field is not None:
                yield Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
        elif isinstance(part, int) and get_origin(bare) is tuple:
            entries = get_args(bare)
            yield entries[0] if entries[-1] is Ellipsis else entries[min(part, len(entries) - 1)]


def _options(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)


def _bare(kind: Any) -> tuple[Any, list[Any]]:
    """The annotation without its checks, and these."""
    metadata: list[Any] = []
    while get_origin(kind) is Annotated:
        kind, *more = get_args(kind)
        for one in more:
            metadata += one.metadata if isinstance(one, FieldInfo) else [one]
    return kind, metadata


def _key(location: Location) -> str:
    key = ""
    for part in location:
        key += f"[{part}]" if isinstance(part, int) else f".{part}" if key else part
    return key
