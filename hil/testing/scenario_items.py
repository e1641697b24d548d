"""A scenario's file as tests: one for each limit. The scenario runs once, in lockstep, for all of them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import pytest

from hil.bench.acceptance_run import AcceptanceRun, is_end_judged, judge_in_lockstep, judge_in_memory
from hil.bench.assembly import Bench
from hil.bench.run_options import check_length
from hil.bench.user_errors import USER_ERRORS
from hil.review.acceptance import LimitVerdict
from hil.review.judged_scenario import JudgedScenario, failure_text

RUN = "runs to its end"


class LimitNotKeptError(AssertionError):
    """A limit that a run has not kept; the message says value, limit and time."""


class ScenarioFile(pytest.File):
    """The file. With pytest-xdist its tests go to one process: `--dist loadgroup` or `loadfile`."""

    def collect(self) -> Iterator[pytest.Item]:
        """A test for each limit, and one for the end of the run unless a limit is about that."""
        try:
            accepts = self.bench.scenario.accept
        except USER_ERRORS as error:
            raise self.CollectError(str(error)) from None
        if not is_end_judged(accepts):
            yield ScenarioItem.from_parent(self, name=RUN, limit=None)
        for accept in accepts:
            yield ScenarioItem.from_parent(self, name=accept.name, limit=accept.name)

    @cached_property
    def asked(self) -> AcceptanceRun:
        """What is run."""
        return AcceptanceRun(
            self.path, self.path, rig=self.config.getoption("--hil-rig"), seed=self.config.getoption("--hil-seed")
        )

    @cached_property
    def bench(self) -> Bench:
        """Scenario and rig. Raises SettingsError."""
        bench = self.asked.load()
        check_length(bench, None)
        return bench

    @cached_property
    def judged(self) -> JudgedScenario:
        """The run with its verdicts; made by the first test that asks. Into a folder with `--hil-out`."""
        out = self.config.getoption("--hil-out")
        if out is None:
            return judge_in_memory(self.asked, self.bench)
        name = self.bench.scenario.scenario.name
        return judge_in_lockstep(replace(self.asked, out=Path(out) / name, report=True), self.bench)


class ScenarioItem(pytest.Item):
    """One limit of a scenario. limit : its name; None for the test that the run goes to its end."""

    def __init__(self, *, limit: str | None, **others: Any) -> None:
        super().__init__(**others)
        self.limit = limit
        self.add_marker(pytest.mark.xdist_group(str(self.path)))

    @property
    def file(self) -> ScenarioFile:
        """The file that it is from."""
        return cast(ScenarioFile, self.parent)

    def runtest(self) -> None:
        """Raise LimitNotKeptError."""
        judged = self.file.judged
        if self.limit is None:
            if judged.error:
                raise LimitNotKeptError(judged.error)
            return
        verdict = next((one for one in judged.verdicts if one.name == self.limit), None)
        if verdict is None:  # the run has no record to judge
            raise LimitNotKeptError(judged.error)
        self._report(verdict)
        if not verdict.is_passed:
            raise LimitNotKeptError(failure_text(verdict))

    def _report(self, verdict: LimitVerdict) -> None:
        """Value and limit go into the JUnit file of pytest."""
        self.user_properties += [("value", verdict.value), ("limit", verdict.limit), ("when", verdict.when)]

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """One line for a limit that is not kept, and for settings that can't be used."""
        if isinstance(excinfo.value, (LimitNotKeptError, *USER_ERRORS)):
            return f"{self.name}: {excinfo.value}"
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[os.PathLike[str], int | None, str]:
        """Where it is from."""
        return self.path, None, f"{self.file.bench.scenario.scenario.name}: {self.name}"
