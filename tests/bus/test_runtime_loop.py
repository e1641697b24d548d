"""The real-time loop on a clock that is handed in: deadlines, skipped steps, and 0 V as the last word."""

import dataclasses
import tomllib
from itertools import pairwise

import pytest
from can import Message

from firmware_sim.rig import Rig as Emulator
from firmware_sim.settings import EmulatorSettings
from firmware_sim.wire import NodeState, parse_command
from hil import runtime
from hil.cli import build
from hil.core import controller
from hil.edge.settings import default_config_dir
from hil.loop import ControlLoop

MS = 1_000_000
PERIOD_NS = 100 * MS
SCENARIO = '[scenario]\nname = "short"\nduration_s = 3.0\n[rig]\nsafety.arm_timeout_s = 1.0\n'


class ManualClock:
    """Time that passes only when somebody waits, or when the script says that a call has stalled."""

    def __init__(self):
        self.now = 5_000 * MS

    def now_ns(self):
        return self.now

    def sleep_until(self, deadline_ns):
        self.now = max(self.now, deadline_ns)


class RigPort:
    """The emulated rig as a port on the manual clock; notes every command with its time. `stalls` : time -> length."""

    def __init__(self, clock, fingerprint, stalls=None):
        settings = tomllib.loads((default_config_dir() / "emulator.toml").read_text())
        self.rig = Emulator(EmulatorSettings.model_validate(settings), (), 1, fingerprint)
        self.clock = clock
        self.stalls = dict(stalls or {})
        self.sent = []
        self.inbox = []
        self.send_failures = 0
        self.is_up = True
        self.last_error = ""
        self.start_ns = clock.now

    def _rig_ns(self):
        return self.clock.now - self.start_ns

    def receive(self, timeout_s):
        for at_ns in [at for at in self.stalls if at <= self._rig_ns()]:
            self.clock.now += self.stalls.pop(at_ns)
        due_ns = self.start_ns + self.rig.next_event_ns
        if not self.inbox and due_ns <= self.clock.now + round(timeout_s * 1e9):
            self.clock.now = max(self.clock.now, due_ns)
            self.inbox += self.rig.advance(self._rig_ns())
        elif not self.inbox:
            self.clock.now += round(timeout_s * 1e9)
        return self.inbox.pop(0) if self.inbox else None

    def waiting(self):
        self.inbox += self.rig.advance(self._rig_ns())
        frames, self.inbox = self.inbox, []
        return frames

    def send(self, frame_id, data, timestamp_s):
        message = Message(timestamp_s, frame_id, is_extended_id=False, data=data)
        self.sent.append((self.clock.now, parse_command(message)))
        if self.is_up:
            self.rig.receive(message, self._rig_ns())
        return self.is_up


class Ticks:
    """A recorder that keeps the steps, and may raise at one of them."""

    def __init__(self, error_at=None, error=None):
        self.records, self.events = [], []
        self.error_at, self.error = error_at, error

    def tick(self, record, true_level_cm=None):  # noqa: ARG002 - the recorder's signature
        self.records.append(record)
        if len(self.records) == self.error_at:
            raise self.error

    def frame(self, *_):
        pass

    def event(self, t_s, event):
        self.events.append((t_s, event))


@dataclasses.dataclass
class Bench:
    clock: ManualClock
    port: RigPort
    ticks: Ticks
    loop: ControlLoop

    def run(self, stop_reason=lambda: ""):
        return runtime.run(self.loop, self.port, self.clock, 0.1, stop_reason)

    def times_ms(self):
        return [(at - self.port.start_ns) / MS for at, _ in self.port.sent]

    def assert_ended_at_rest(self):
        _, last = self.port.sent[-1]
        assert (last.enable, last.command_V) == (False, (0.0, 0.0))
        assert self.port.rig.truth().applied_V == (0.0, 0.0)


@pytest.fixture
def bench(tmp_path):
    def make(stalls=None, **recorder):
        scenario = tmp_path / "short.toml"
        scenario.write_text(SCENARIO)
        loaded = build.load(scenario)
        clock, ticks = ManualClock(), Ticks(**recorder)
        port = RigPort(clock, loaded.contract.fingerprint, stalls)
        config = build.controller_config(loaded)
        loop = ControlLoop(config, loaded.contract, loaded.rig.sensors.range_V, port, ticks, arm_timeout_s=1.0)
        return Bench(clock, port, ticks, loop)

    return make


def test_steps_lie_on_absolute_deadlines_and_the_run_completes(bench):
    run = bench()
    outcome = run.run()
    assert (outcome.status, outcome.reason, outcome.commands_lost) == ("complete", "duration over", 0)
    *regular, last = run.times_ms()
    assert regular == [100.0 * number for number in range(1, len(regular) + 1)]
    assert last == regular[-1]
    assert [record.skipped for record in run.ticks.records] == [0] * len(run.ticks.records)
    run.assert_ended_at_rest()


@pytest.mark.parametrize(("stall_ms", "skipped"), [(40, 0), (99, 0), (150, 0), (199, 0), (201, 1), (240, 1)])
def test_a_late_step_is_made_once_and_what_was_missed_is_skipped(bench, stall_ms, skipped):
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


def test_after_a_long_stall_the_node_has_tripped_and_the_controller_trips_without_a_burst(bench):
    run = bench(stalls={1000 * MS: 1050 * MS})
    outcome = run.run()
    assert (outcome.status, outcome.reason) == ("tripped", "node_tripped")
    after = [(at, command) for at, command in zip(run.times_ms(), run.port.sent, strict=True) if at > 1000.0]
    assert all(not command.enable for _, (_, command) in after)
    times = [at for at, _ in after]
    assert times[0] == 2050.0
    assert all(b - a >= 50.0 for a, b in pairwise(times[:-1]))
    assert len(times) <= 5
    assert run.port.rig.truth().pump_state is NodeState.TRIPPED
    run.assert_ended_at_rest()


@pytest.mark.parametrize("error", [OSError("disk"), ZeroDivisionError(), KeyboardInterrupt(), SystemExit(1)])
def test_whatever_leaves_the_loop_zero_volts_is_the_last_frame(bench, error):
    run = bench(error_at=8, error=error)
    with pytest.raises(type(error)):
        run.run()
    assert run.port.sent[-2][1].enable, "it was running"
    assert run.port.sent[-1][0] == run.port.sent[-2][0], "and 0 V came at once"
    run.assert_ended_at_rest()


def test_a_stop_ramps_down_and_ends_stopped(bench):
    run = bench()
    outcome = run.run(lambda: "SIGTERM" if len(run.ticks.records) >= 10 else "")
    assert (outcome.status, outcome.reason) == ("stopped", "SIGTERM")
    volts = [record.command_V[0] for record in run.ticks.records[10:]]
    assert volts == sorted(volts, reverse=True)
    assert 0.0 < volts[0] < 3.5
    assert volts[-1] == 0.0
    run.assert_ended_at_rest()
    assert run.port.rig.truth().pump_state is NodeState.READY


def test_a_stop_before_arming_moves_nothing(bench):
    run = bench()
    outcome = run.run(lambda: "SIGINT")
    assert (outcome.status, outcome.reason) == ("stopped", "SIGINT")
    assert not any(command.enable for _, command in run.port.sent)


def test_a_bus_that_goes_down_trips_in_the_next_step_and_the_loop_does_not_spin(bench):
    run = bench()

    def drop_the_bus():
        if len(run.ticks.records) == 10:
            run.port.is_up = False
        return ""

    outcome = run.run(drop_the_bus)
    assert outcome.status == "tripped"
    assert outcome.reason == "bus_failed; the pump node has not confirmed 0 V"
    enabled = [number for number, (_, command) in enumerate(run.port.sent) if command.enable]
    assert len(run.port.sent) - 1 - enabled[-1] <= 13, "one second of tries, then the end"
    last = run.port.sent[-1][1]
    assert (last.enable, last.command_V) == (False, (0.0, 0.0))


def test_a_rig_that_never_gets_ready_ends_the_run_after_the_arm_timeout(bench):
    run = bench()
    run.port.receive = lambda timeout_s: setattr(run.clock, "now", run.clock.now + round(timeout_s * 1e9))
    outcome = run.run()
    assert outcome.status == "failed"
    assert outcome.reason.startswith("not ready within 1 s: ")
    assert 1.0 <= (run.clock.now - run.port.start_ns) * 1e-9 <= 1.3
    assert not any(command.enable for _, command in run.port.sent)


def test_a_step_that_raises_sends_zero_volts_in_the_same_step(bench, monkeypatch):
    run = bench()
    step = controller.step

    def failing_at_the_eleventh(config, state, inputs, now_ns):
        if len(run.ticks.records) == 10:
            raise ZeroDivisionError("a bug")
        return step(config, state, inputs, now_ns)

    monkeypatch.setattr(controller, "step", failing_at_the_eleventh)
    outcome = run.run()
    assert (outcome.status, outcome.reason) == ("tripped", "controller_failed")
    enabled = [at for at, command in run.port.sent if command.enable]
    off_again = [at for at, command in run.port.sent if at > enabled[-1]]
    assert off_again[0] - enabled[-1] == PERIOD_NS
    assert "ZeroDivisionError: a bug" in [event.text for _, event in run.ticks.events][-1]
    run.assert_ended_at_rest()
