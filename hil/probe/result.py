"""What a check says."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How a check went; a check that could not be made is neither good nor bad."""

    PASS = "pass"  # noqa: S105 - not a password
    WARN = "warn"
    FAIL = "fail"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Result:
    """One row of the table. found : what was seen, with its numbers. advice : what to do about it; "" when nothing."""

    check: str
    verdict: Verdict
    found: str
    advice: str = ""


def passed(check: str, found: str) -> Result:
    """Nothing to do."""
    return Result(check, Verdict.PASS, found)


def warned(check: str, found: str, advice: str) -> Result:
    """The bench can be run, but somebody should look at this."""
    return Result(check, Verdict.WARN, found, advice)


def failed(check: str, found: str, advice: str) -> Result:
    """Don't run it."""
    return Result(check, Verdict.FAIL, found, advice)


def not_checked(check: str, why: str, advice: str = "") -> Result:
    """Nothing can be said."""
    return Result(check, Verdict.NOT_CHECKED, why, advice)


def has_failed(results: Iterable[Result]) -> bool:
    """Whether any check failed; warnings don't count."""
    return any(result.verdict is Verdict.FAIL for result in results)
