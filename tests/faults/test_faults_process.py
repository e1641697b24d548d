"""Cases 46 to 54: clocks, stalls, signals, exceptions, disks and viewers of the host.

Cases 48 (SIGSTOP), 49, 50, 52 and 54 are in tests/live, in real time; 53 is in tests/review.
"""

import time
from pathlib import Path
from typing import Any

import pytest

from firmware_sim.frames import NodeState
from hil.core import estimator
from hil.core.diagnosis.detector import FaultDetector
from hil.core.types import Diagnosis, Mode
from tests.bus.runtime_bench import MS, bench_in
from tests.faults.faults_bench import (
    OFF,
    T_S,
    TIME_TOLERANCE_S,
    W_S,
    Run,
    assert_no_trip,
    fault,
    plain,
    play,
    scenario_data,
)

AT_S = 5.0
HOUR_S = 3600.0


@pytest.mark.parametrize("jump_s", [HOUR_S, -HOUR_S])
def test_case_46_wall_clock_jumps(monkeypatch: pytest.MonkeyPatch, jump_s: float) -> None:
    """The host's wall clock and both nodes' jump an hour: not one tick is any different."""
    expected = plain().ticks
    real = time.time
    started = real()
    monkeypatch.setattr(time, "time", lambda: real() + (jump_s if real() - started > 0.02 else 0.0))
    monkeypatch.setattr(time, "time_ns", lambda: int(time.time() * 1e9))
    run = play(scenario_data(fault("clock_jump", AT_S, "pump", jump_s), fault("clock_jump", AT_S, "level", jump_s)))
    assert_no_trip(run)
    assert run.ticks == expected


@pytest.mark.parametrize("stall_ms", [100, 1000, 10_000])
def test_case_47_controller_stalls(tmp_path: Path, stall_ms: int) -> None:
    """0.1 s goes unnoticed; 1 s and 10 s: node safe within W, controller trips; what was missed is never made up."""
    run = bench_in(tmp_path, stalls={1000 * MS: stall_ms * MS})
    outcome = run.run()
    times = run.times_ms()[:-1]
    assert len({at // 100.0 for at in times}) == len(times), "two commands within one period: a burst"
    if stall_ms == 100:
        assert outcome.status == "complete"
        return
    assert (outcome.status, outcome.reason) == ("tripped", "node_tripped")
    before_ms = max(at for at in times if at <= 1000.0)
    assert run.port.trips_ms[0] - before_ms <= 1000 * W_S
    assert all(not command.enable for at, command in run.port.sent if at * 1e-6 > 1100.0 + run.port.start_ns / MS)
    assert run.port.rig.truth().pump_state is NodeState.TRIPPED
    run.assert_ended_at_rest()


class Raising:
    """The scenario's own detector, that raises from a time on."""

    def __init__(self, detector: FaultDetector, error: Exception) -> None:
        self._detector, self._error = detector, error

    def start(self) -> Any:
        return self._detector.start()

    def step(self, memory: Any, t_s: float, *arguments: Any) -> tuple[Any, Diagnosis]:
        if t_s >= AT_S - TIME_TOLERANCE_S:
            raise self._error
        return self._detector.step(memory, t_s, *arguments)


def assert_failed_in_the_same_tick(run: Run) -> None:
    assert run.cause == "controller_failed"
    assert len(run.trips) == 1, "the first cause stays"
    off_s = [t_s - run.start_s for t_s, data in run.keeper.sent if not data[4] & 1 and t_s > run.start_s + 1.0]
    assert off_s[0] == pytest.approx(AT_S, abs=TIME_TOLERANCE_S), "0 V in the very tick that raised"
    assert run.node_off_s(AT_S) == pytest.approx(AT_S, abs=TIME_TOLERANCE_S)


@pytest.mark.parametrize("error", [ZeroDivisionError("x"), FloatingPointError(), MemoryError(), KeyError("y")])
def test_case_51_detector_raises(error: Exception) -> None:
    """Whatever the diagnosis raises: 0 V in the same tick; what goes wrong afterwards does not change the cause."""
    run = play(scenario_data(fault("heartbeat_stop", AT_S, "level")), detector=lambda own: Raising(own, error))
    assert_failed_in_the_same_tick(run)


def test_case_51_estimator_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    """So with the level filter."""
    steps, real = [], estimator.step

    def failing(*arguments: Any) -> estimator.Estimate:
        steps.append(1)
        if len(steps) == round(AT_S / T_S):
            raise ValueError("singular")
        return real(*arguments)

    monkeypatch.setattr(estimator, "step", failing)
    assert_failed_in_the_same_tick(play(scenario_data()))


def test_case_48_busy_thread(tmp_path: Path) -> None:
    """A step that is not done in time is a stall, whatever keeps it busy: 0.4 s are enough for the watchdog."""
    run = bench_in(tmp_path, stalls={at * MS: 400 * MS for at in (1000, 1500, 2000)})
    outcome = run.run()
    assert (outcome.status, outcome.reason) == ("tripped", "node_tripped")
    assert [r.mode for r in run.ticks.records][-1] is Mode.TRIPPED
    assert run.ticks.records[-1].command_V == OFF
    run.assert_ended_at_rest()
