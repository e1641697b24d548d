"""A number of things as words: "1 alarm", "2 alarms"."""

from __future__ import annotations


def counted(number: int, noun: str, plural: str = "", form: str = "d") -> str:
    """The number with the noun in singular or plural.

    plural : where it is not the noun with an s. form : of the number, as in a format string.
    """
    return f"{number:{form}} {noun if number == 1 else plural or noun + 's'}"
