"""The result of a check."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """The verdict of a check; NOT_CHECKED is neither good nor bad."""

    PASS = "pass"  # noqa: S105 - not a password
    WARN = "warn"
    FAIL = "fail"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Result:
    """One row of the table. found : what was observed, with numbers. advice : what to do; "" for nothing."""

    check: str
    verdict: Verdict
    found: str
    advice: str = ""


def passed(check: str, found: str) -> Result:
    """A result without anything to do."""
    return Result(check, Verdict.PASS, found)


def warned(check: str, found: str, advice: str) -> Result:
    """A result that allows a run, but should be looked at."""
    return Result(check, Verdict.WARN, found, advice)


def failed(check: str, found: str, advice: str) -> Result:
    """A result that forbids a run."""
    return Result(check, Verdict.FAIL, found, advice)


def not_checked(check: str, why: str, advice: str = "") -> Result:
    """A check that could not be made."""
    return Result(check, Verdict.NOT_CHECKED, why, advice)


def has_failed(results: Iterable[Result]) -> bool:
    """Whether any check failed; warnings do not count."""
    return any(result.verdict is Verdict.FAIL for result in results)
