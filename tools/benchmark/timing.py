"""Alternatives run in turns, so that a busy machine slows all of them equally."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

TICK_US = 100_000.0


@dataclass(frozen=True)
class Effort:
    """Numbers of runs, rounds and steps."""

    runs: int = 7
    rounds: int = 41
    steps: int = 20_000


def yardstick_ms() -> float:
    """Time of an empty loop of a million turns, the best of five: the machine's speed at the moment."""
    best = float("inf")
    for _ in range(5):
        started = time.perf_counter()
        for _ in range(1_000_000):
            pass
        best = min(best, time.perf_counter() - started)
    return best * 1e3


def in_turns(calls: dict[str, tuple[Callable[[], Any], int]], rounds: int) -> dict[str, list[float]]:
    """Microseconds per call, one number a round. calls : name -> (call, how often in a round)."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # place_poles warns when its iterations did not converge
        for index in range(rounds + 1):  # the first round is for warm-up
            for name, (call, count) in calls.items():
                started = time.perf_counter()
                for _ in range(count):
                    call()
                took_us = (time.perf_counter() - started) / count * 1e6
                if index:
                    times[name].append(took_us)
    return times
