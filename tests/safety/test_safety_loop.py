"""The loop between a port and a recorder: whatever goes wrong, the same tick sends 0 V."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NoReturn

import pytest

from firmware_sim import frames as node
from hil.core import closed_loop
from hil.core.controller import Output
from hil.core.diagnosis.ideal import NoDetector
from hil.core.estimator import Estimate
from hil.core.live_request import LiveRequest
from hil.core.loop_state import LoopState
from hil.core.types import Diagnosis, Event, Inputs, Measurement, Mode, Pair, Timing, TripCause
from tests.narrowing import quad
from tests.safety.safety_bench import (
    CONTRACT,
    LIMITS,
    MS,
    PERIOD_NS,
    REST_V,
    START_NS,
    LoopBench,
    SentCommand,
    config,
    raw_command,
)


class Saboteur(NoDetector):
    """A detector that raises, or that reports an impossible effectiveness, once armed."""

    def __init__(self, damage: Callable[[Diagnosis], Diagnosis]) -> None:
        self.damage = damage
        self.armed = False

    def step(
        self, memory: object, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[None, Diagnosis]:
        kept, diagnosis = super().step(memory, t_s, measurement, estimate, applied_V)
        return kept, self.damage(diagnosis) if self.armed else diagnosis


def raises(error: Exception) -> Callable[[Diagnosis], Diagnosis]:
    def damage(_diagnosis: Diagnosis) -> NoReturn:
        raise error

    return damage


def saboteur_bench(damage: Callable[[Diagnosis], Diagnosis]) -> LoopBench:
    saboteur = Saboteur(damage)
    bench = LoopBench(config(detector=saboteur)).run()
    saboteur.armed = True
    return bench


def assert_off(command: SentCommand) -> None:
    assert command.voltage_V == (0.0, 0.0)
    assert not command.enable
    assert not command.clear


def test_the_pumps_are_enabled_only_after_two_healthy_steps() -> None:
    bench = LoopBench()
    bench.step()
    assert bench.is_in(Mode.READY)
    bench.step()
    assert bench.is_in(Mode.RUNNING)
    assert [c.enable for c in bench.port.sent] == [False, True]
    assert bench.port.sent[1].voltage_V == pytest.approx((2.0, 2.0), abs=1e-3)


def test_every_tick_sends_one_command_and_records_it() -> None:
    bench = LoopBench().run()
    assert [c.at_ns for c in bench.port.sent] == [START_NS + n * PERIOD_NS for n in range(8)]
    assert [c.counter for c in bench.port.sent] == list(range(8))
    sent = [f for f in bench.recorder.frames if not f[3]]
    received = [f for f in bench.recorder.frames if f[3]]
    assert len(sent) == 8
    assert len(received) == 8 * 5
    assert {f[1] for f in sent} == {CONTRACT.frames["PumpCommand"].frame_id}
    assert received[0][0] == pytest.approx(0.995)
    assert len(bench.recorder.ticks) == 7
    assert bench.codes() == ["mode", "mode"]


@pytest.mark.parametrize(
    "error", [RuntimeError("a bug"), ZeroDivisionError("division"), KeyError("x"), MemoryError(), RecursionError()]
)
def test_whatever_a_step_raises_the_same_tick_sends_0_volts(error: Exception) -> None:
    bench = saboteur_bench(raises(error))
    bench.step()
    assert bench.last.at_ns == bench.now_ns
    assert_off(bench.last)
    assert bench.mode is Mode.TRIPPED
    assert bench.cause is TripCause.CONTROLLER_FAILED
    t_s, event = bench.recorder.events[-1]
    assert event.code == "trip"
    assert type(error).__name__ in event.text
    assert t_s == pytest.approx(bench.recorder.ticks[-1].t_s)
    bench.step(5)
    for command in bench.port.sent[-5:]:
        assert_off(command)
    assert bench.codes().count("trip") == 1
    assert bench.cause is TripCause.CONTROLLER_FAILED


@pytest.mark.parametrize("nonsense", [math.nan, math.inf, -math.inf])
def test_a_law_that_asks_for_no_number_trips_in_the_same_tick(nonsense: float, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = LoopBench().run()
    original = closed_loop.step

    def broken(*arguments: Any) -> tuple[LoopState, tuple[Event, ...]]:
        loop, events = original(*arguments)
        return loop._replace(raw_V=(3.0, nonsense)), events

    monkeypatch.setattr(closed_loop, "step", broken)
    bench.step()
    assert bench.last.at_ns == bench.now_ns
    assert_off(bench.last)
    assert bench.cause is TripCause.CONTROLLER_FAILED
    assert "the control law asked for" in bench.recorder.events[-1][1].text


def test_an_impossible_diagnosis_trips() -> None:
    bench = saboteur_bench(lambda diagnosis: replace(diagnosis, effectiveness=(math.nan, 1.0)))
    bench.step()
    assert_off(bench.last)
    assert bench.mode is Mode.TRIPPED
    assert bench.cause is TripCause.CONTROLLER_FAILED


def test_a_command_that_can_not_be_encoded_trips() -> None:
    """Limits wider than the wire's range, say: the encoder is the last to refuse."""
    bench = LoopBench(replace(config(), limits=replace(LIMITS, range_V=(0.0, 12.0), rate_V_s=1e6)))
    bench.step(3)
    bench.levels_V = (1.0, 1.0, 0.1, 0.1)
    bench.step(2)
    assert_off(bench.last)
    assert bench.cause is TripCause.CONTROLLER_FAILED
    assert [c.counter for c in bench.port.sent] == list(range(len(bench.port.sent)))


def test_the_first_cause_stays_when_more_goes_wrong() -> None:
    bench = LoopBench().run()
    bench.loop.receive(raw_command(9.0, 9.0), bench.now_ns + MS)
    bench.step()
    assert_off(bench.last)
    assert bench.cause is TripCause.FOREIGN_COMMAND
    bench.levels_V = (9.9,) * 4
    bench.boots["pumps"] = 2
    bench.step(3)
    assert bench.cause is TripCause.FOREIGN_COMMAND
    assert bench.codes().count("trip") == 1


def trip_causes() -> list[tuple[Callable[[LoopBench], None], TripCause]]:
    def reboot(bench: LoopBench) -> None:
        bench.boots["levels"] += 1

    def wrong_contract(bench: LoopBench) -> None:
        bench.contract ^= 1

    def node_tripped(bench: LoopBench) -> None:
        bench.node_tripped = True

    def high(bench: LoopBench) -> None:
        bench.levels_V = (*REST_V[:3], 9.6)

    def bus(bench: LoopBench) -> None:
        bench.port.is_up = False

    return [
        (reboot, TripCause.NODE_REBOOTED),
        (wrong_contract, TripCause.WRONG_CONTRACT),
        (node_tripped, TripCause.NODE_TRIPPED),
        (high, TripCause.HIGH_LEVEL),
        (bus, TripCause.BUS_FAILED),
    ]


@pytest.mark.parametrize(("damage", "cause"), trip_causes(), ids=lambda value: getattr(value, "__name__", str(value)))
def test_what_a_frame_says_trips_in_the_tick_that_reads_it(
    damage: Callable[[LoopBench], None], cause: TripCause
) -> None:
    bench = LoopBench().run()
    damage(bench)
    bench.step()
    assert_off(bench.last)
    assert bench.mode is Mode.TRIPPED
    assert bench.cause is cause


@pytest.mark.parametrize("status", [1, 2, 3])
@pytest.mark.parametrize("channel", range(4))
def test_the_third_invalid_reading_in_a_row_trips(channel: int, status: int) -> None:
    bench = LoopBench().run()
    bad = quad(node.ChannelStatus(status if i == channel else 0) for i in range(4))
    for _ in range(3):  # one or two are ridden out
        bench.statuses = bad
        bench.step(2)
        assert bench.mode is Mode.RUNNING
        bench.statuses = (node.ChannelStatus.OK,) * 4
        bench.step()
    bench.statuses = bad
    bench.step(3)
    assert_off(bench.last)
    assert bench.cause is TripCause.INVALID_LEVELS


@pytest.mark.parametrize(
    ("silent", "cause", "limit_s"),
    [
        ("LowerLevels", TripCause.STALE_LEVELS, 0.3),
        ("UpperLevels", TripCause.STALE_LEVELS, 0.3),
        ("PumpStatus", TripCause.STALE_STATUS, 0.3),
        ("PumpHeartbeat", TripCause.NODE_LOST, 0.25),
        ("LevelHeartbeat", TripCause.NODE_LOST, 0.25),
    ],
)
def test_silence_trips_within_its_age_and_a_period(silent: str, cause: TripCause, limit_s: float) -> None:
    bench = LoopBench().run()
    heard_ns = bench.now_ns - 5 * MS
    bench.silent = {silent}
    while bench.mode is Mode.RUNNING:
        bench.step()
    assert bench.cause is cause
    assert_off(bench.last)
    silence_s = (bench.now_ns - heard_ns) * 1e-9
    assert limit_s < silence_s <= limit_s + PERIOD_NS * 1e-9


def test_commands_that_are_not_echoed_trip_within_half_a_second() -> None:
    bench = LoopBench().run()
    bench.confirms = False
    settled_ns = bench.now_ns
    while bench.mode is Mode.RUNNING:
        bench.step()
    assert bench.cause is TripCause.ECHO_MISSING
    assert 0.5 < (bench.now_ns - settled_ns) * 1e-9 <= 0.7
    assert_off(bench.last)


def test_unknown_levels_never_start_the_pumps() -> None:
    bench = LoopBench()
    bench.silent = {"UpperLevels"}
    bench.step(8)
    assert bench.mode is Mode.DISARMED
    assert not any(c.enable for c in bench.port.sent)
    assert all(c.voltage_V == (0.0, 0.0) for c in bench.port.sent)


@pytest.mark.parametrize("channel", range(4))
def test_invalid_levels_never_start_the_pumps(channel: int) -> None:
    bench = LoopBench()
    bench.statuses = quad(node.ChannelStatus(1 if i == channel else 0) for i in range(4))
    bench.step(8)
    assert bench.mode is Mode.DISARMED
    assert not any(c.enable for c in bench.port.sent)


def test_a_rig_that_never_becomes_ready_ends_the_run_with_the_reason() -> None:
    bench = LoopBench(arm_timeout_s=0.5)
    bench.node_tripped = True
    bench.step(6)
    assert bench.loop.outcome is None
    bench.step()
    outcome = bench.ended()
    assert outcome.status == "failed"
    assert outcome.reason == "not ready within 0.5 s: the pump node has tripped"
    assert bench.recorder.events[-1][1].code == "not_ready"
    assert not any(c.enable or c.clear for c in bench.port.sent)


def test_a_latched_node_is_cleared_only_on_request_and_only_while_disarmed() -> None:
    bench = LoopBench(clear_trip=True)
    bench.node_tripped = True
    bench.step(3)
    assert [c.clear for c in bench.port.sent] == [True] * 3
    assert all(not c.enable and c.voltage_V == (0.0, 0.0) for c in bench.port.sent)
    bench.node_tripped = False
    bench.step(8)
    assert bench.is_in(Mode.RUNNING)
    bench.node_tripped = True
    bench.step(3)
    assert bench.is_in(Mode.TRIPPED)
    assert not any(c.clear for c in bench.port.sent[-3:])


def test_a_trip_ends_the_run_once_the_node_confirms_0_volts() -> None:
    bench = LoopBench().run()
    bench.levels_V = (*REST_V[:3], 9.6)
    bench.step()
    assert bench.loop.outcome is None
    while bench.loop.outcome is None:
        bench.step()
    outcome = bench.loop.outcome
    assert (outcome.status, outcome.reason) == ("tripped", "high_level")
    assert outcome.t_s == pytest.approx(bench.recorder.ticks[-1].t_s)
    assert outcome.commands_sent == len(bench.port.sent)
    assert outcome.commands_lost == 0
    assert outcome.frames_lost == 0


def test_a_node_that_never_confirms_is_named_in_the_outcome() -> None:
    bench = LoopBench().run()
    bench.silent = {"PumpStatus"}
    first = len(bench.port.sent)
    while bench.loop.outcome is None:
        bench.step()
    assert bench.loop.outcome.reason.startswith(
        "stale_status; the pump node has not confirmed 0 V: its last status is 1."
    )
    assert bench.loop.outcome.reason.endswith(" s old; the last command was not echoed")
    assert len(bench.port.sent) - first < 20


def test_a_stop_ramps_down_and_waits_for_0_volts() -> None:
    bench = LoopBench().run()
    running_V = bench.last.voltage_V
    while bench.loop.outcome is None:
        bench.step(stop_reason="SIGTERM")
    assert (bench.loop.outcome.status, bench.loop.outcome.reason) == ("stopped", "SIGTERM")
    ramp = [c for c in bench.port.sent if c.at_ns > START_NS + 7 * PERIOD_NS and c.enable]
    assert [c.voltage_V[0] for c in ramp] == pytest.approx([running_V[0] - 1.0, running_V[0] - 2.0], abs=1e-3)
    assert_off(bench.last)


def test_a_stop_before_the_start_ends_at_once() -> None:
    bench = LoopBench()
    bench.silent = {"LowerLevels"}
    bench.step(2)
    bench.step(stop_reason="Ctrl-C")
    assert bench.loop.outcome is not None
    assert (bench.loop.outcome.status, bench.loop.outcome.reason) == ("stopped", "Ctrl-C")
    assert not any(c.enable for c in bench.port.sent)


def test_a_run_that_is_over_is_complete() -> None:
    bench = LoopBench(replace(config(), duration_s=0.5))
    while bench.loop.outcome is None:
        bench.step()
    assert (bench.loop.outcome.status, bench.loop.outcome.reason) == ("complete", "duration over")
    assert_off(bench.last)


def test_make_safe_sends_0_volts_whatever_happened_before() -> None:
    bench = LoopBench().run()
    bench.loop.make_safe(bench.now_ns + MS)
    assert_off(bench.last)
    assert bench.last.at_ns == bench.now_ns + MS
    early = LoopBench()
    early.loop.make_safe(0)
    assert_off(early.last)


def test_frames_that_did_not_go_out_are_not_recorded() -> None:
    bench = LoopBench()
    bench.port.is_up = False
    bench.step(3)
    assert not [f for f in bench.recorder.frames if not f[3]]
    assert len(bench.port.sent) == 3
    assert bench.mode is Mode.DISARMED


def test_watcher_and_true_levels_see_every_step() -> None:
    watched = []
    bench = LoopBench(
        true_level_cm=lambda: (1.0, 2.0, 3.0, 4.0), on_tick=lambda inputs, _output, mode: watched.append((inputs, mode))
    ).run()
    bench.step(timing=Timing(0.004, 2))
    assert [mode for _, mode in watched] == [Mode.READY] + [Mode.RUNNING] * 8
    assert watched[-1][0].timing == Timing(0.004, 2)
    assert bench.recorder.true_levels == [(1.0, 2.0, 3.0, 4.0)] * 8


def test_a_watcher_that_fails_is_no_longer_called_and_the_run_goes_on() -> None:
    calls = []

    def watcher(*_: object) -> None:
        calls.append(1)
        raise RuntimeError("no screen")

    bench = LoopBench(on_tick=watcher).run()
    assert len(calls) == 1
    assert bench.codes().count("watcher_failed") == 1
    assert all(c.enable for c in bench.port.sent[-5:])


@pytest.mark.parametrize("kind", ["is_extended_id", "is_error_frame", "is_remote_frame", "is_fd"])
def test_a_frame_that_is_not_plain_is_kept_as_it_came_and_changes_nothing(kind: str) -> None:
    bench = LoopBench().run()
    odd = raw_command(9.0, 9.0)
    setattr(odd, kind, True)
    before = len(bench.recorder.frames)
    bench.loop.receive(odd, bench.now_ns + MS)
    ((at_s, kept),) = bench.recorder.messages
    assert at_s == pytest.approx((bench.now_ns + MS) * 1e-9)
    assert kept == odd
    assert len(bench.recorder.frames) == before
    bench.step()
    assert bench.mode is Mode.RUNNING


class Operators:
    """A control channel over which nobody asks for anything, and which can be lost."""

    def __init__(self) -> None:
        self.is_open = True

    def requests(self) -> tuple[LiveRequest, ...]:
        return ()

    def show(self, inputs: Inputs, output: Output, state: object, now_ns: int) -> tuple[Event, ...]:
        del inputs, output, state, now_ns
        return ()


def tripped_by_hand_ended(operators: Operators) -> LoopBench:
    """A run that ends by hand only, after a trip; the rig is well again."""
    open_ended = replace(config(), duration_s=math.inf, waits_for_clearing=True)
    bench = LoopBench(open_ended, operator=operators).run()
    bench.levels_V = (*REST_V[:3], 9.6)
    for _ in range(5):
        if not bench.is_in(Mode.TRIPPED):
            bench.step()
    assert bench.cause is TripCause.HIGH_LEVEL
    bench.levels_V = REST_V
    return bench


def test_a_tripped_run_waits_at_0_volts_for_an_operator_as_long_as_one_can_be_heard() -> None:
    """When its channel was lost it waited for ever for a clear that could not come."""
    operators = Operators()
    bench = tripped_by_hand_ended(operators)
    bench.step(100)
    assert bench.loop.outcome is None
    assert_off(bench.last)
    operators.is_open = False
    bench.step()
    assert (bench.ended().status, bench.ended().reason) == ("tripped", "high_level")
    assert_off(bench.last)


def test_a_run_without_a_channel_ends_with_its_trip() -> None:
    operators = Operators()
    operators.is_open = False
    bench = tripped_by_hand_ended(operators)
    bench.step(5)
    assert (bench.ended().status, bench.ended().reason) == ("tripped", "high_level")
    assert_off(bench.last)
