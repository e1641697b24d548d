"""Runs in worker processes, each made once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from tests.closed_loop.loop_experiment import Experiment, Run, simulate

Start = Callable[..., "Future[Run]"]


@pytest.fixture(scope="session")
def start_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Start]:
    """start_run(scenario, seed=1) gives the future of a run; two go on at a time."""
    base = tmp_path_factory.mktemp("closed_loop")
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        count = 0

        def start(scenario: str | Experiment, seed: int = 1) -> Future[Run]:
            nonlocal count
            count += 1
            text = scenario.toml() if isinstance(scenario, Experiment) else scenario
            return pool.submit(simulate, text, base / f"{count:03}", seed)

        yield start
        pool.shutdown(cancel_futures=True)
