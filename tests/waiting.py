"""Waiting in real time for what another thread or process does."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def wait_for(condition: Callable[[], T], timeout_s: float = 20.0, step_s: float = 0.005) -> T:
    """The first true value of `condition`. The timeout is for a busy machine: it only decides when the test fails."""
    end_s = time.monotonic() + timeout_s
    while not (result := condition()):
        assert time.monotonic() < end_s, "did not happen in time"
        time.sleep(step_s)
    return result


def fastest_s(call: Callable[[], object], tries: int = 5) -> float:
    """How long the quickest of some calls takes: a busy machine holds up some, code that blocks holds up all."""
    times_s = []
    for _ in range(tries):
        started_s = time.monotonic()
        call()
        times_s.append(time.monotonic() - started_s)
    return min(times_s)
