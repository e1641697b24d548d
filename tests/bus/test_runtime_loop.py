"""The real-time loop on a clock that is handed in: deadlines, skipped steps, and 0 V as the last word."""

from functools import partial
from pathlib import Path
from typing import Any

import pytest

from firmware_sim.frames import NodeState
from hil.core import controller
from tests.bus.runtime_bench import MS, PERIOD_NS, Bench, bench_in


@pytest.fixture
def bench(tmp_path: Path) -> partial[Bench]:
    return partial(bench_in, tmp_path)


def test_steps_lie_on_absolute_deadlines_and_the_run_completes(bench: partial[Bench]) -> None:
    run = bench()
    outcome = run.run()
    assert (outcome.status, outcome.reason, outcome.commands_lost) == ("complete", "duration over", 0)
    *regular, last = run.times_ms()
    assert regular == [100.0 * number for number in range(1, len(regular) + 1)]
    assert last == regular[-1]
    assert [record.skipped for record in run.ticks.records] == [0] * len(run.ticks.records)
    run.assert_ended_at_rest()


@pytest.mark.parametrize(("stall_ms", "skipped"), [(40, 0), (99, 0), (150, 0), (199, 0), (201, 1), (240, 1)])
def test_a_late_step_is_made_once_and_what_was_missed_is_skipped(
    bench: partial[Bench], stall_ms: int, skipped: int
) -> None:
    """The stall begins at 1000 ms, right after a step; the next deadlines are 1100 and 1200 ms, stall or not."""
    run = bench(stalls={1000 * MS: stall_ms * MS})
    outcome = run.run()
    assert outcome.status == "complete"
    times = run.times_ms()[:-1]
    assert run.ticks.records[-1].skipped == skipped
    assert [at for at in times if at % 100.0] == ([1000.0 + stall_ms] if stall_ms > 100 else [])
    assert len({at // 100.0 for at in times}) == len(times), "two steps within one period"
    late = max(record.lateness_s for record in run.ticks.records)
    assert late == pytest.approx(max(stall_ms - 100, 0) * 1e-3, abs=1e-6)


def test_after_a_long_stall_the_node_has_tripped_and_the_controller_trips_without_a_burst(
    bench: partial[Bench],
) -> None:
    """The test used to compare distances between commands that are never sent, and passed with any."""
    run = bench(stalls={1000 * MS: 1050 * MS})
    outcome = run.run()
    assert (outcome.status, outcome.reason) == ("tripped", "node_tripped")
    after = [(at, command) for at, command in zip(run.times_ms(), run.port.sent, strict=True) if at > 1000.0]
    assert all(not command.enable for _, (_, command) in after)
    assert [at for at, _ in after] == [2050.0, 2050.0], "the step that trips, and the end"
    assert run.port.rig.truth().pump_state is NodeState.TRIPPED
    run.assert_ended_at_rest()


@pytest.mark.parametrize("error", [OSError("disk"), ZeroDivisionError(), KeyboardInterrupt(), SystemExit(1)])
def test_whatever_leaves_the_loop_zero_volts_is_the_last_frame(bench: partial[Bench], error: BaseException) -> None:
    run = bench(error_at=8, error=error)
    with pytest.raises(type(error)):
        run.run()
    assert run.port.sent[-2][1].enable, "it was running"
    assert run.port.sent[-1][0] == run.port.sent[-2][0], "and 0 V came at once"
    run.assert_ended_at_rest()


def test_a_stop_ramps_down_and_ends_stopped(bench: partial[Bench]) -> None:
    run = bench()
    outcome = run.run(lambda: "SIGTERM" if len(run.ticks.records) >= 10 else "")
    assert (outcome.status, outcome.reason) == ("stopped", "SIGTERM")
    volts = [record.command_V[0] for record in run.ticks.records[10:]]
    assert volts == sorted(volts, reverse=True)
    assert 0.0 < volts[0] < 3.5
    assert volts[-1] == 0.0
    run.assert_ended_at_rest()
    assert run.port.rig.truth().pump_state is NodeState.READY


def test_a_stop_before_arming_moves_nothing(bench: partial[Bench]) -> None:
    run = bench()
    outcome = run.run(lambda: "SIGINT")
    assert (outcome.status, outcome.reason) == ("stopped", "SIGINT")
    assert not any(command.enable for _, command in run.port.sent)


def test_a_bus_that_goes_down_trips_in_the_next_step_and_the_loop_does_not_spin(bench: partial[Bench]) -> None:
    run = bench()

    def drop_the_bus() -> str:
        if len(run.ticks.records) == 10:
            run.port.is_up = False
        return ""

    outcome = run.run(drop_the_bus)
    assert outcome.status == "tripped"
    assert outcome.reason == (
        "bus_failed; the pump node has not confirmed 0 V: its last status is 1.2 s old; the last command was not echoed"
    )
    enabled = [number for number, (_, command) in enumerate(run.port.sent) if command.enable]
    assert len(run.port.sent) - 1 - enabled[-1] <= 13, "one second of tries, then the end"
    last = run.port.sent[-1][1]
    assert (last.enable, last.command_V) == (False, (0.0, 0.0))


def test_a_rig_that_never_gets_ready_ends_the_run_after_the_arm_timeout(
    bench: partial[Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = bench()

    def receive_nothing(timeout_s: float) -> None:
        run.clock.now += round(timeout_s * 1e9)

    monkeypatch.setattr(run.port, "receive", receive_nothing)
    outcome = run.run()
    assert outcome.status == "failed"
    assert outcome.reason.startswith("not ready within 1 s: ")
    assert 1.0 <= (run.clock.now - run.port.start_ns) * 1e-9 <= 1.3
    assert not any(command.enable for _, command in run.port.sent)


def test_a_step_that_raises_sends_zero_volts_in_the_same_step(
    bench: partial[Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = bench()
    step = controller.step

    def failing_at_the_eleventh(*arguments: Any) -> tuple[controller.ControllerState, controller.Output]:
        if len(run.ticks.records) == 10:
            raise ZeroDivisionError("a bug")
        return step(*arguments)

    monkeypatch.setattr(controller, "step", failing_at_the_eleventh)
    outcome = run.run()
    assert (outcome.status, outcome.reason) == ("tripped", "controller_failed")
    enabled = [at for at, command in run.port.sent if command.enable]
    off_again = [at for at, command in run.port.sent if at > enabled[-1]]
    assert off_again[0] - enabled[-1] == PERIOD_NS
    assert "ZeroDivisionError: a bug" in [event.text for _, event in run.ticks.events][-1]
    run.assert_ended_at_rest()
