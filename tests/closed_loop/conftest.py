"""Runs of a module, each made when a test first looks at it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import pytest

from tests.closed_loop.loop_experiment import Experiment, Run, simulate


class Planned:
    """A run that is made once, by the first test that asks for its result."""

    def __init__(self, scenario: str | Experiment, new_folder: Callable[[], Path], seed: int) -> None:
        self._text = scenario.toml() if isinstance(scenario, Experiment) else scenario
        self._new_folder, self._seed = new_folder, seed

    @cached_property
    def _run(self) -> Run:
        return simulate(self._text, self._new_folder() / "run", self._seed)

    def result(self) -> Run:
        """What the run left behind."""
        return self._run


Plan = Callable[..., Planned]


@pytest.fixture(scope="session")
def plan_run(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """plan_run(scenario, seed=1) gives a run to be made when it is needed."""

    def plan(scenario: str | Experiment, seed: int = 1) -> Planned:
        return Planned(scenario, lambda: tmp_path_factory.mktemp("closed_loop"), seed)

    return plan
