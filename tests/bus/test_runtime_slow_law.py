"""A control law that takes longer than a control period: periods are skipped, or the watchdog stops the pumps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from firmware_sim.frames import NodeState
from hil.core.control_law import ControlLaw, LawInputs, LawRequest
from tests.bus.runtime_bench import MS, Bench, ManualClock, bench_in

SLOW_FROM_S = 0.55


@dataclass(frozen=True)
class Slow:
    """A law's answers, late: from SLOW_FROM_S on, at `steps` steps, each takes took_ms."""

    inner: ControlLaw
    clock: ManualClock
    took_ms: int
    steps: int

    def start(self, inputs: LawInputs) -> tuple[Any, int]:
        return self.inner.start(inputs), 0

    def step(self, memory: tuple[Any, int], inputs: LawInputs) -> tuple[tuple[Any, int], LawRequest]:
        inner, done = memory
        inner, request = self.inner.step(inner, inputs)
        if inputs.t_s > SLOW_FROM_S and done < self.steps:
            self.clock.now += self.took_ms * MS
            done += 1
        return (inner, done), request


def slow(took_ms: int, steps: int) -> Callable[[ControlLaw, ManualClock], ControlLaw]:
    return lambda inner, clock: Slow(inner, clock, took_ms, steps)


def run_with(folder: Path, took_ms: int, steps: int) -> tuple[Bench, str, str]:
    run = bench_in(folder, law=slow(took_ms, steps))
    run.port.slowest_s = 1e-3 * took_ms
    outcome = run.run()
    return run, outcome.status, outcome.reason


@pytest.mark.parametrize("took_ms", [101, 105, 130, 145])
def test_periods_that_a_slow_law_misses_are_skipped_and_recorded(tmp_path: Path, took_ms: int) -> None:
    """Every step takes longer than the period of 100 ms, and the node hears of the controller soon enough.

    Steps of 101 to 109 ms used to trip with `node_lost`: frames were received neither before a step nor after a stall.
    """
    run, status, reason = run_with(tmp_path, took_ms, 1000)
    assert status == "complete"
    assert reason.startswith("duration over")
    records = run.ticks.records
    assert records[-1].skipped > 0 or took_ms < 110
    times = [record.t_s for record in records if record.t_s > SLOW_FROM_S + 0.1]
    assert all(later - now >= 1e-3 * took_ms - 1e-6 for now, later in pairwise(times))
    assert not run.port.trips_ms
    run.assert_ended_at_rest()


def test_a_law_that_is_slow_once_costs_no_more_than_its_periods(tmp_path: Path) -> None:
    run, status, _ = run_with(tmp_path, 140, 1)
    assert status == "complete"
    assert run.ticks.records[-1].skipped == 0, "the next step begins 40 ms late, in its own period"
    assert max(record.lateness_s for record in run.ticks.records) == pytest.approx(0.04, abs=2e-3)


@pytest.mark.parametrize("took_ms", [260, 400, 5000])
def test_a_law_that_takes_longer_than_the_watchdog_ends_at_0_volts(tmp_path: Path, took_ms: int) -> None:
    """The pump node goes to 0 V 250 ms after the last command, and what the law then says is not obeyed."""
    run, status, reason = run_with(tmp_path, took_ms, 1)
    assert status == "tripped"
    assert reason.startswith("node_tripped")
    sent = [at for at, (_, command) in zip(run.times_ms(), run.port.sent, strict=True) if command.enable]
    (tripped_ms,) = run.port.trips_ms
    before = [at for at in sent if at < tripped_ms]
    assert tripped_ms - before[-1] == pytest.approx(250.0, abs=11.0)
    assert run.port.rig.truth().pump_state is NodeState.TRIPPED
    run.assert_ended_at_rest()
