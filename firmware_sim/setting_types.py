"""Validators for settings: each refuses a wrong type or a value out of range, and says the range.

They are used as ``Annotated[float, within(0.0, 10.0)]``. TOML knows lists only, so `listed` turns a list
into the tuple that a frozen record keeps.
"""

from pydantic import BaseModel, BeforeValidator, ConfigDict
from pydantic_core import PydanticCustomError


class Table(BaseModel):
    """A frozen TOML table without unknown keys or silent type conversions."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def within(low: float, high: float) -> BeforeValidator:
    """Accept a finite number in low .. high, both ends included (NaN lies in no range)."""
    allowed = {"low": f"{low:g}", "high": f"{high:g}"}

    def check(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise PydanticCustomError("number", "must be a number in {low} .. {high}", allowed)
        if not low <= value <= high:
            raise PydanticCustomError("range", "is outside {low} .. {high}", allowed)
        return float(value)

    return BeforeValidator(check)


def per_part(count: int, low: float, high: float) -> BeforeValidator:
    """Accept one number in low .. high, or a list of `count` of them, which becomes a tuple."""
    allowed = {"low": f"{low:g}", "high": f"{high:g}", "count": count}

    def is_number(value: object) -> bool:
        return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high

    def check(value: object) -> float | tuple[float, ...]:
        if isinstance(value, list | tuple):
            if len(value) == count and all(is_number(part) for part in value):
                return tuple(float(part) for part in value)
        elif is_number(value):
            return float(value)  # type: ignore[arg-type]
        elif isinstance(value, int | float) and not isinstance(value, bool):
            raise PydanticCustomError("range", "is outside {low} .. {high}", allowed)
        raise PydanticCustomError("parts", "must be a number in {low} .. {high}, or a list of {count} of them", allowed)

    return BeforeValidator(check)


def one_of(*choices: int) -> BeforeValidator:
    """Accept one of a few whole numbers."""
    allowed = {"choices": ", ".join(str(choice) for choice in choices)}

    def check(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value not in choices:
            raise PydanticCustomError("choice", "must be one of {choices}", allowed)
        return value

    return BeforeValidator(check)


def whole(low: int, high: int) -> BeforeValidator:
    """Accept a whole number in low .. high, which may be written as 3.0."""
    allowed = {"low": low, "high": high}

    def check(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value // 1:
            raise PydanticCustomError("whole", "must be a whole number in {low} .. {high}", allowed)
        if not low <= value <= high:
            raise PydanticCustomError("range", "is outside {low} .. {high}", allowed)
        return int(value)

    return BeforeValidator(check)


def named(*names: str) -> BeforeValidator:
    """Accept one of a few names."""

    def check(value: object) -> str:
        if not isinstance(value, str) or value not in names:
            raise PydanticCustomError("name", "must be one of {names}", {"names": ", ".join(names)})
        return value

    return BeforeValidator(check)


def listed(length: int) -> BeforeValidator:
    """Accept a list of exactly `length` entries."""

    def check(value: object) -> tuple[object, ...]:
        if not isinstance(value, list | tuple) or len(value) != length:
            raise PydanticCustomError("list", "must be a list of {length} numbers", {"length": length})
        return tuple(value)

    return BeforeValidator(check)
