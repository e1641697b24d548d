"""What a test knows of a value and the type checker does not."""

from collections.abc import Iterable
from typing import TypeVar

T = TypeVar("T")


def not_none(value: T | None) -> T:
    assert value is not None
    return value


def pair(values: Iterable[T]) -> tuple[T, T]:
    first, second = values
    return first, second


def quad(values: Iterable[T]) -> tuple[T, T, T, T]:
    first, second, third, fourth = values
    return first, second, third, fourth
