"""What an operator asks for in the course of a run, through the whole control step and the loop."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from hil.core.controller import ControllerState
from hil.core.diagnosis.ideal import NoDetector
from hil.core.types import Action, Diagnosis, Event, Mode, Pair, Request, TickRecord, TripCause
from tests.safety.safety_bench import LIMITS, MS, PERIOD_NS, PERIOD_S, REST_V, VERDICTS, LoopBench, config, raw_command

MANUAL, AUTO, CLEAR, STOP = (Request(a) for a in (Action.MANUAL, Action.AUTO, Action.CLEAR, Action.STOP))


def bench(*schedule: tuple[float, Request], verdict: Diagnosis | None = None, **changes: Any) -> "ToldBench":
    """A loop whose operator asks (at_s, request), with a detector that may be told what to say."""
    detector = Told(verdict)
    limits = changes.pop("limits", LIMITS)
    duration_s = changes.pop("duration_s", math.inf)
    made = replace(config(detector=detector), requests=tuple(schedule), limits=limits, duration_s=duration_s)
    loop = ToldBench(made, **changes)
    loop.told = detector
    return loop


class Told(NoDetector):
    """Says what it is told."""

    def __init__(self, verdict: Diagnosis | None) -> None:
        self.verdict = verdict

    def step(self, memory: object, *_: object) -> tuple[None, Diagnosis]:  # noqa: ARG002 - the detectors' signature
        return None, self.verdict or Diagnosis()


class ToldBench(LoopBench):
    """Its detector says what it is told."""

    told: Told


def records(loop: LoopBench, mode: Mode | None = None) -> list[TickRecord]:
    return [r for r in loop.recorder.ticks if mode is None or r.mode is mode]


def events(loop: LoopBench, code: str) -> list[tuple[float, Event]]:
    return [(round(t_s, 6), event) for t_s, event in loop.recorder.events if event.code == code]


def test_a_request_is_allowed_in_the_first_step_at_or_after_its_time() -> None:
    loop = bench((1.0, MANUAL), (1.55, AUTO), (2.0, MANUAL), (2.0, STOP))
    loop.step(40)
    moves = [(t_s, event.text) for t_s, event in events(loop, "mode")][2:]
    assert moves == [(1.0, "RUNNING -> MANUAL"), (1.6, "MANUAL -> RUNNING"), (2.0, "RUNNING -> STOPPING")]


def test_manual_begins_with_the_voltages_in_force_and_moves_at_the_rate_limit() -> None:
    loop = bench((1.0, MANUAL), (2.0, Request(Action.MANUAL, voltage_V=(8.0, 0.5))))
    loop.step(31)
    before = next(r for r in records(loop) if round(r.t_s, 6) == 0.9)
    manual = records(loop, Mode.MANUAL)
    assert all(r.command_V == before.command_V for r in manual[:10])
    steps = [r.command_V for r in manual[9:]]
    for (a1, a2), (b1, b2) in pairwise(steps):
        assert abs(b1 - a1) <= LIMITS.rate_V_s * PERIOD_S + 1e-9
        assert abs(b2 - a2) <= LIMITS.rate_V_s * PERIOD_S + 1e-9
    assert steps[-1] == (8.0, 0.5)


@pytest.mark.parametrize("theta", [(1.0, 1.0), (0.5, 0.8)])
def test_manual_is_left_without_a_bump(theta: Pair) -> None:
    """The law, at work again, asks for what the operator had; pumps that lost gain included."""
    loop = bench((1.0, Request(Action.MANUAL, voltage_V=(5.0, 1.5))), (4.0, AUTO), verdict=Diagnosis(theta))
    loop.step(45)
    last_manual = records(loop, Mode.MANUAL)[-1]
    back = next(r for r in records(loop) if round(r.t_s, 6) == 4.0)
    assert back.mode is (Mode.RUNNING if theta == (1.0, 1.0) else Mode.DEGRADED)
    assert last_manual.command_V == (5.0, 1.5)
    assert back.raw_V == pytest.approx((5.0, 1.5), abs=1e-6)
    assert back.command_V == pytest.approx((5.0, 1.5), abs=1e-6)


@pytest.mark.parametrize(("name", "cause", "verdict"), VERDICTS, ids=[v[0] for v in VERDICTS])
def test_manual_keeps_every_interlock_of_the_diagnosis(name: str, cause: TripCause, verdict: Diagnosis) -> None:
    loop = bench((1.0, MANUAL))
    loop.step(15)
    assert loop.mode is Mode.MANUAL
    loop.told.verdict = verdict
    loop.step()
    assert (loop.mode, loop.cause) == (Mode.TRIPPED, cause), name
    assert not loop.last.enable
    assert loop.last.voltage_V == (0.0, 0.0)


def test_an_operators_stop_ramps_down_and_says_who_asked() -> None:
    loop = bench((1.0, STOP))
    while loop.loop.outcome is None:
        loop.step()
    assert (loop.loop.outcome.status, loop.loop.outcome.reason) == ("stopped", "operator")


def test_a_dead_pump_stops_the_run_if_so_configured() -> None:
    loop = bench(limits=replace(LIMITS, stops_on_dead_pump=True))
    loop.step(10)
    loop.told.verdict = Diagnosis((0.0, 1.0))
    while loop.loop.outcome is None:
        loop.step()
    assert (loop.loop.outcome.status, loop.loop.outcome.reason) == ("stopped", "pump_dead")


def trip_and_heal(loop: LoopBench, steps: int = 3) -> None:
    """Run for a second, flood a tank for some steps."""
    loop.step(12)
    healthy, loop.levels_V = loop.levels_V, (*REST_V[:3], 9.6)
    loop.step(steps)
    assert loop.cause is TripCause.HIGH_LEVEL
    loop.levels_V = healthy


def test_a_trip_ends_the_run_unless_it_is_to_be_cleared_later() -> None:
    plain = bench()
    trip_and_heal(plain)
    plain.step()
    assert plain.loop.outcome is not None
    assert plain.loop.outcome.status == "tripped"
    cleared = bench((3.0, CLEAR))
    trip_and_heal(cleared)
    cleared.step(30)
    assert cleared.loop.outcome is None
    assert cleared.mode is Mode.RUNNING
    modes = [event.text for _, event in events(cleared, "mode")]
    assert modes[2:] == ["TRIPPED -> DISARMED", "DISARMED -> READY", "READY -> RUNNING"]
    again = [r for r in records(cleared, Mode.RUNNING) if r.t_s > 3.0]
    assert again[0].integral_Vs == (0.0, 0.0)
    assert again[0].t_s == pytest.approx(3.2)
    assert max(again[0].command_V) <= LIMITS.rate_V_s * PERIOD_S + 1e-9


def test_a_clear_that_comes_while_the_cause_stands_is_refused_and_the_run_ends_if_it_was_the_last() -> None:
    loop = bench((1.6, CLEAR), (3.0, CLEAR))
    trip_and_heal(loop, steps=8)
    loop.step(2)
    assert loop.is_in(Mode.TRIPPED)
    (refused,) = events(loop, "refused")
    assert refused[1].data == {"action": "clear", "reason": "high_level"}
    loop.step(12)
    assert loop.is_in(Mode.RUNNING)
    loop.levels_V = (*REST_V[:3], 9.6)
    loop.step(3)
    assert loop.ended().status == "tripped"


@pytest.mark.parametrize("at_s", [0.5, 30.0])
def test_a_clear_in_the_past_or_after_the_end_keeps_no_run_waiting(at_s: float) -> None:
    loop = bench((at_s, CLEAR), duration_s=20.0)
    trip_and_heal(loop)
    loop.step(2)
    assert loop.loop.outcome is not None
    assert loop.ended().status == "tripped"


def test_a_stop_asked_for_while_tripped_ends_the_run() -> None:
    by_operator = bench((2.0, STOP), (9.0, CLEAR))
    trip_and_heal(by_operator)
    by_operator.step(5)
    assert by_operator.loop.outcome is None
    by_operator.step(5)
    outcome = by_operator.ended()
    assert (outcome.status, outcome.reason) == ("tripped", "high_level")
    by_signal = bench((9.0, CLEAR))
    trip_and_heal(by_signal)
    by_signal.step(2, stop_reason="SIGTERM")
    assert by_signal.loop.outcome is not None
    assert by_signal.loop.outcome.status == "tripped"


def disarmed_for_good(**changes: Any) -> LoopBench:
    """Tripped, cleared, and then a node that does not fit."""
    loop = bench((1.5, CLEAR), **changes)
    trip_and_heal(loop, steps=2)
    while loop.mode is not Mode.DISARMED:
        loop.step()
    loop.contract ^= 1
    return loop


def test_a_run_whose_trip_was_cleared_waits_for_the_rig_again_and_no_longer_than_allowed() -> None:
    loop = disarmed_for_good(arm_timeout_s=1.0)
    loop.step(10)
    assert (loop.mode, loop.loop.outcome) == (Mode.DISARMED, None)
    loop.step()
    assert loop.loop.outcome is not None
    assert loop.loop.outcome.status == "failed"
    assert loop.loop.outcome.reason == "not ready within 1 s: a node was built for another DBC"


def test_a_run_that_is_over_while_disarmed_is_complete() -> None:
    loop = disarmed_for_good(arm_timeout_s=9.0, duration_s=2.0)
    while loop.loop.outcome is None:
        loop.step()
    assert (loop.loop.outcome.status, loop.loop.outcome.reason) == ("complete", "duration over")
    assert loop.loop.outcome.t_s == pytest.approx(2.0)


def test_an_operators_stop_while_disarmed_ends_the_run() -> None:
    loop = bench((1.5, CLEAR), (1.6, STOP))
    trip_and_heal(loop, steps=2)
    while loop.loop.outcome is None:
        loop.step()
    assert (loop.loop.outcome.status, loop.loop.outcome.reason) == ("stopped", "operator")


def test_clearing_takes_the_nodes_trip_along() -> None:
    loop = bench((3.0, CLEAR))
    loop.step(12)
    loop.node_tripped = True
    loop.step(18)
    assert loop.cause is TripCause.NODE_TRIPPED
    assert not any(c.clear for c in loop.port.sent)
    loop.step(2)
    assert loop.is_in(Mode.DISARMED)
    assert loop.last.clear
    loop.node_tripped = False
    loop.step(3)
    assert loop.is_in(Mode.RUNNING)
    assert not loop.last.clear


def test_a_foreign_command_and_a_reboot_stand_for_the_rest_of_the_run() -> None:
    spoils: tuple[Callable[[LoopBench], object], ...] = (
        lambda b: b.loop.receive(raw_command(1.0, 1.0), b.now_ns + MS),
        lambda b: b.boots.update(levels=2),
    )
    for spoil in spoils:
        loop = bench((2.0, CLEAR), (9.0, CLEAR))
        loop.step(12)
        spoil(loop)
        loop.step(12)
        assert loop.mode is Mode.TRIPPED
        assert len(events(loop, "refused")) == 1


def test_a_failed_step_keeps_what_was_seen_of_the_outlets() -> None:
    loop = bench()
    loop.step(12)
    state = loop.loop._state
    assert isinstance(state, ControllerState)
    seen = state.monitors.outlets
    assert seen.level_cm is not None
    loop.told.verdict = Diagnosis((math.nan, 1.0))
    loop.step()
    assert loop.cause is TripCause.CONTROLLER_FAILED
    assert loop.now_ns - seen.watched_ns == PERIOD_NS


def test_the_bus_says_why_it_is_gone() -> None:
    loop = bench()
    loop.step(12)
    loop.port.is_up, loop.port.last_error = False, "No such device"
    loop.step()
    assert events(loop, "trip")[0][1].text == "tripped: the CAN bus is gone: No such device"
