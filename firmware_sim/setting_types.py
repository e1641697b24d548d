"""Checks for settings: each refuses a wrong type or a value out of range, with a message that gives the range.

They are used as ``Annotated[float, within(0.0, 10.0)]``. TOML has only lists, so `listed` turns a list
into the tuple that a frozen record keeps. Each says in words what it accepts; `allowed` reads that from a field.
"""

from dataclasses import dataclass
from typing import get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError


class Table(BaseModel):
    """A frozen TOML table without unknown keys or silent type conversions."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


@dataclass(frozen=True)
class Accepts(BeforeValidator):
    """A check that says what it accepts. numbers : the limits of a numeric setting, None for a choice."""

    text: str = ""
    numbers: tuple[float, float] | None = None
    choices: tuple[int | str, ...] = ()


def accepts(field: FieldInfo) -> Accepts:
    """The check of a field. Raises LookupError for a field that has none."""
    metadata = [*field.metadata, *(one for part in get_args(field.annotation) for one in get_args(part)[1:])]
    for one in metadata:
        if isinstance(one, Accepts):
            return one
    raise LookupError(f"{field.annotation} has no check of its own")


def allowed(field: FieldInfo) -> str:
    """What a field accepts, as text: "0 .. 10", or "1, 2"."""
    return accepts(field).text


def within(low: float, high: float) -> BeforeValidator:
    """Accept a finite number in low .. high, both ends included (NaN lies in no range)."""
    parts = {"low": f"{low:g}", "high": f"{high:g}"}

    def check(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise PydanticCustomError("number", "must be a number in {low} .. {high}", parts)
        if not low <= value <= high:
            raise PydanticCustomError("range", "is outside {low} .. {high}", parts)
        return float(value)

    return Accepts(check, text=f"{low:g} .. {high:g}", numbers=(low, high))


def per_part(count: int, low: float, high: float, *, is_signed: bool = False) -> BeforeValidator:
    """Accept one number in low .. high, or a list of `count` of them, which becomes a tuple.

    is_signed : the numbers may be negative, and low .. high is the range of their magnitude.
    """
    text = f"±({low:g} .. {high:g})" if is_signed else f"{low:g} .. {high:g}"
    words = {"range": text, "count": count}

    def is_number(value: object) -> bool:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        return low <= (abs(value) if is_signed else value) <= high

    def check(value: object) -> float | tuple[float, ...]:
        if isinstance(value, list | tuple):
            if len(value) == count and all(is_number(part) for part in value):
                return tuple(float(part) for part in value)
        elif is_number(value):
            return float(value)  # type: ignore[arg-type]
        elif isinstance(value, int | float) and not isinstance(value, bool):
            raise PydanticCustomError("range", "is outside {range}", words)
        raise PydanticCustomError("parts", "must be a number in {range}, or a list of {count} of them", words)

    return Accepts(check, text=f"{text}; one number or {count}", numbers=(low, high))


def parts(value: float | tuple[float, ...], count: int) -> tuple[float, ...]:
    """One value for each of `count` parts, where a setting may be one number for all."""
    return value if isinstance(value, tuple) else (value,) * count


def one_of(*choices: int) -> BeforeValidator:
    """Accept one of a few whole numbers."""
    parts = {"choices": ", ".join(str(choice) for choice in choices)}

    def check(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value not in choices:
            raise PydanticCustomError("choice", "must be one of {choices}", parts)
        return value

    return Accepts(check, text=parts["choices"], choices=choices)


def whole(low: int, high: int) -> BeforeValidator:
    """Accept a whole number in low .. high, which may be written as 3.0."""
    parts = {"low": low, "high": high}

    def check(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value // 1:
            raise PydanticCustomError("whole", "must be a whole number in {low} .. {high}", parts)
        if not low <= value <= high:
            raise PydanticCustomError("range", "is outside {low} .. {high}", parts)
        return int(value)

    return Accepts(check, text=f"{low} .. {high}", numbers=(low, high))


def named(*names: str) -> BeforeValidator:
    """Accept one of a few names."""

    def check(value: object) -> str:
        if not isinstance(value, str) or value not in names:
            raise PydanticCustomError("name", "must be one of {names}", {"names": ", ".join(names)})
        return value

    return Accepts(check, text=", ".join(f'"{name}"' for name in names), choices=names)


def listed(length: int) -> BeforeValidator:
    """Accept a list of exactly `length` entries."""

    def check(value: object) -> tuple[object, ...]:
        if not isinstance(value, list | tuple) or len(value) != length:
            raise PydanticCustomError("list", "must be a list of {length} numbers", {"length": length})
        return tuple(value)

    return Accepts(check, text=f"a list of {length}")
