"""A scenario and its verdicts, as the table, the JUnit file and the page show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from hil.review.acceptance import LimitVerdict


@dataclass(frozen=True)
class JudgedScenario:
    """A scenario of a test.

    duration_s : of the computation, or of the run in real time. error : why there are no verdicts though it was to
    run; "" if there are. not_run : why it was not run at all, as one without limits; "" if it was. folder : of the run;
    None if there is none. began : local time. about : seed, mode and the like, for the JUnit file.
    """

    name: str
    verdicts: tuple[LimitVerdict, ...] = ()
    duration_s: float = 0.0
    error: str = ""
    not_run: str = ""
    folder: Path | None = None
    began: datetime | None = None
    about: tuple[tuple[str, str], ...] = field(default=())

    @property
    def is_passed(self) -> bool:
        """Whether it ran, and kept every limit."""
        return not self.error and not self.not_run and all(verdict.is_passed for verdict in self.verdicts)

    @property
    def result(self) -> str:
        """In one word or two."""
        if self.error:
            return "ERROR"
        if self.not_run:
            return "not run"
        return "passed" if self.is_passed else "FAILED"


def summary(tested: Sequence[JudgedScenario]) -> str:
    """How many passed, in one line."""
    run = [one for one in tested if not one.not_run]
    left = len(tested) - len(run)
    passed = sum(one.is_passed for one in run)
    return f"{passed} of {len(run)} scenarios passed" + (f", {left} not run" if left else "")


def is_good(tested: Sequence[JudgedScenario]) -> bool:
    """Whether every scenario that ran passed."""
    return all(one.is_passed for one in tested if not one.not_run)


def failure_text(verdict: LimitVerdict) -> str:
    """Value, limit and time of a limit."""
    return f"{verdict.value}; limit: {verdict.limit}; when: {verdict.when}"
