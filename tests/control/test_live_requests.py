"""Requests of an operator in the control step: what is taken, what is refused and why, and that nothing jumps."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import pytest

from hil.core import controller
from hil.core.alarm_list import AlarmList
from hil.core.controller import ControllerConfig, ControllerState, Output
from hil.core.live_request import Author, LiveAction, LiveRequest
from hil.core.live_view import view
from hil.core.types import Action, Event, Mode, NodeState, Pair, Request, Severity, TripCause
from hil.edge.control.control_channel import MAX_SENT
from tests.core.core_bench import PERIOD_S, SECOND, Plant, bench_loop, controller_config, inputs, volts
from tests.narrowing import not_none

AUTHOR = Author("ann", 4711, 1)


def request(action: LiveAction, number: int = 1, **keys: Any) -> LiveRequest:
    return LiveRequest(number, action, AUTHOR, {"do": action.value}, **keys)


class Run:
    """A run in process, step by step."""

    def __init__(self, config: ControllerConfig | None = None) -> None:
        self.config = config or controller_config(bench_loop())
        self.plant, self.state, self.number = Plant(), ControllerState(), 0
        self.applied: Pair = (0.0, 0.0)
        self.node = NodeState.READY
        self.output: Output = None  # type: ignore[assignment]
        self.step(5)

    def step(self, steps: int = 1, *asked: LiveRequest, shortfall_V: Pair = (0.0, 0.0)) -> Output:
        for index in range(steps):
            seen = inputs(volts(self.plant.level_cm), self.applied, self.node, shortfall_V)
            now_ns = round(self.number * PERIOD_S * SECOND)
            asked_now = asked if index == 0 else ()
            self.state, self.output = controller.step(self.config, self.state, seen, now_ns, asked_now)
            self.number += 1
            command = self.output.command
            self.applied = command.voltage_V if command.enable else (0.0, 0.0)
            self.node = NodeState.RUN if command.enable else NodeState.READY
            self.plant.advance(self.applied, PERIOD_S)
        return self.output

    def ask(self, action: LiveAction, **keys: Any) -> tuple[bool, str]:
        output = self.step(1, request(action, **keys))
        (answer,) = output.answers
        event = output.events[-1]
        assert event.code == ("refused" if answer.reason else "operator")
        assert (event.data["user"], event.data["pid"], event.data["client"]) == ("ann", 4711, 1)
        return not answer.reason, answer.reason or answer.text

    def reference(self) -> Pair:
        return not_none(self.output.record).reference_V

    @property
    def t_s(self) -> float:
        return not_none(self.state.loop).t_s


def test_a_reference_moves_the_water() -> None:
    run = Run()
    before = run.reference()
    is_taken, text = run.ask(LiveAction.REFERENCE, change_V=(0.2, None))
    assert is_taken, text
    assert run.reference() == pytest.approx((before[0] + 0.2, before[1]))
    run.step(1200)
    assert not_none(run.output.record).measured_V[0] == pytest.approx(before[0] + 0.2, abs=0.02)


def test_levels_in_cm_are_those_of_the_tanks() -> None:
    run = Run()
    assert run.ask(LiveAction.REFERENCE, levels_cm=(12.0, 13.0))[0]
    assert run.reference() == pytest.approx((6.0, 6.5))


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"levels_V": (9.6, None)}, "out_of_range"),
        ({"change_V": (-9.0, None)}, "out_of_range"),
        ({"levels_cm": (18.0, 2.0)}, "unreachable"),
    ],
)
def test_a_reference_that_can_not_be_held_is_refused(keys: dict[str, Any], reason: str) -> None:
    run = Run()
    before = run.reference()
    assert run.ask(LiveAction.REFERENCE, **keys) == (False, reason)
    run.step(3)
    assert run.reference() == before


def test_manual_and_back_is_without_a_jump() -> None:
    run = Run()
    run.step(100)
    before = run.output.command.voltage_V
    assert run.ask(LiveAction.MANUAL)[0]
    assert run.output.command.voltage_V == pytest.approx(before, abs=0.01)
    assert run.ask(LiveAction.MANUAL, voltage_V=(None, before[1] + 0.3))[0]
    run.step(20)
    assert run.output.command.voltage_V == pytest.approx((before[0], before[1] + 0.3), abs=0.02)
    last = run.output.command.voltage_V
    assert run.ask(LiveAction.AUTO)[0]
    assert run.output.command.voltage_V == pytest.approx(last, abs=0.05), "bumpless"
    assert run.state.supervision.mode is Mode.RUNNING


def test_what_the_mode_does_not_allow_is_refused_with_the_author() -> None:
    run = Run()
    assert run.ask(LiveAction.AUTO) == (False, "not while RUNNING")
    assert run.ask(LiveAction.CLEAR) == (False, "not while RUNNING")
    assert run.ask(LiveAction.MANUAL, voltage_V=(11.0, None))[0] is False
    assert run.ask(LiveAction.BYPASS, interlock=TripCause.HIGH_LEVEL, for_s=5.0)[0] is False
    assert run.state.supervision.mode is Mode.RUNNING


def test_a_request_that_a_stop_overrules_is_not_called_accepted() -> None:
    run = Run()
    run.step(1, request(LiveAction.STOP, 1), request(LiveAction.MANUAL, 2))
    answers = {answer.number: answer.reason for answer in run.output.answers}
    assert answers == {1: "", 2: "overruled"}
    assert run.state.supervision.mode is Mode.STOPPING


def test_a_stop_says_what_the_pumps_do() -> None:
    """A run that has tripped has nothing left to ramp down."""
    assert Run().ask(LiveAction.STOP) == (True, "stop: the pumps ramp down and the run ends")
    run = Run()
    run.plant.level_cm = (19.5, *run.plant.level_cm[1:])
    run.step(5)
    assert run.state.supervision.mode is Mode.TRIPPED
    assert run.ask(LiveAction.STOP) == (True, "stop: the pumps are off and the run ends")
    assert run.state.supervision.stopped_by


def test_a_held_clock_delays_requests_and_the_end_of_the_scenario() -> None:
    run = Run(replace(controller_config(bench_loop(), 4.0), requests=((3.0, Request(Action.MANUAL)),)))
    assert run.ask(LiveAction.HOLD)[0]
    assert run.ask(LiveAction.HOLD) == (False, "no_change")
    held_at_s = run.t_s
    run.step(100)
    assert run.state.supervision.mode is Mode.RUNNING, "control goes on"
    assert not controller.is_over(run.config, run.state)
    assert run.ask(LiveAction.RESUME)[0]
    later_s = run.t_s - held_at_s + PERIOD_S
    while run.state.supervision.mode is Mode.RUNNING:
        run.step()
    assert run.t_s == pytest.approx(3.0 + later_s, abs=0.15)
    while not controller.is_over(run.config, run.state):
        run.step()
    assert run.t_s == pytest.approx(4.0 + later_s, abs=0.15)


def test_notes_and_marks_are_events_and_change_nothing() -> None:
    run = Run()
    before = run.output.command
    assert run.ask(LiveAction.NOTE, text="valve 2 turned") == (True, "note: valve 2 turned")
    assert run.ask(LiveAction.MARK, text="a") == (True, "mark a")
    assert run.output.command.voltage_V == pytest.approx(before.voltage_V, abs=0.02)


def test_before_the_first_step_in_control_only_what_makes_sense_is_taken() -> None:
    config = controller_config(bench_loop())
    asked = tuple(
        request(action, number)
        for number, action in enumerate((LiveAction.REFERENCE, LiveAction.HOLD, LiveAction.NOTE, LiveAction.STOP), 1)
    )
    _, output = controller.step(config, ControllerState(), inputs((6.0, 6.0, 1.0, 1.0), state=NodeState.BOOT), 0, asked)
    reasons = {answer.number: answer.reason for answer in output.answers}
    assert reasons == {1: "not_while", 2: "not_while", 3: "", 4: ""}


def test_an_alarm_is_acknowledged_by_its_key() -> None:
    run = Run()
    assert run.ask(LiveAction.ACK, text="alarm:1") == (False, "unknown_alarm")
    assert run.ask(LiveAction.BYPASS, interlock=TripCause.DRY_RUN, for_s=100.0)[0]
    assert [row["key"] for row in run.state.alarms.rows(run.t_s)] == ["bypass:dry_run"]
    assert run.ask(LiveAction.ACK, text="bypass:dry_run")[0]
    assert run.ask(LiveAction.SHELVE, text="bypass:dry_run", for_s=10.0)[0]
    assert [row["state"] for row in run.state.alarms.rows(run.t_s)] == ["shelved"]


def test_a_bypass_is_answered_with_the_time_that_it_gets() -> None:
    """The answer named the time asked for, where safety.bypass_max_s allows less."""
    config = controller_config(bench_loop())
    run = Run(replace(config, limits=replace(config.limits, bypass_max_s=60.0)))
    assert run.ask(LiveAction.BYPASS, interlock=TripCause.DRY_RUN, for_s=600.0) == (True, "dry_run bypassed for 60 s")


@pytest.mark.parametrize("is_running", [True, False])
def test_what_fails_beside_the_control_loop_is_in_the_alarm_list(*, is_running: bool) -> None:
    """A full disk was in the record of the run and nowhere else: its operator heard of it when the run was over."""
    run, full = Run(), Event(Severity.ERROR, "recorder_failed", "ticks.csv is lost from here on")
    node = NodeState.READY if is_running else NodeState.BOOT
    state = run.state if is_running else ControllerState()
    seen = replace(inputs(volts(run.plant.level_cm), (0.0, 0.0), node), noted=(full,))
    for now_ns in (run.number * SECOND, (run.number + 1) * SECOND):
        state, output = controller.step(run.config, state, seen, now_ns)
        seen = replace(seen, noted=())
    (row,) = view(run.config, state, seen, output, run.number * SECOND)["alarms"]
    assert (row["key"], row["state"], row["title"]) == ("recorder_failed", "active", full.text)


def test_a_list_of_alarms_that_got_long_still_fits_into_a_state() -> None:
    """A state with some 500 alarms that nobody had acknowledged did not fit into a message: the channel was lost."""
    run, alarms = Run(), AlarmList()
    for number in range(1000):
        kind = "leak" if number == 3 else "sensor_noise"
        alarms = alarms.take("alarm", f"alarm {number}", {"number": number + 1, "kind": kind}, float(number))
    state = run.state._replace(alarms=alarms)
    shown = view(run.config, state, inputs(volts(run.plant.level_cm)), run.output, run.number * SECOND)
    assert (len(shown["alarms"]), shown["alarms_more"]) == (100, 900)
    assert shown["alarms"][0]["title"] == "alarm 3", "the most urgent one"
    assert len(pickle.dumps(shown)) < MAX_SENT


def test_a_law_whose_check_raises_does_not_trip_the_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Run()
    law = run.config.loop.law

    def broken(_: Pair) -> None:
        raise RuntimeError("no idea")

    monkeypatch.setattr(type(law), "check", lambda _self, reference_V: broken(reference_V))
    assert run.ask(LiveAction.REFERENCE, change_V=(0.1, 0.1)) == (False, "failed")
    assert run.state.supervision.mode is Mode.RUNNING
