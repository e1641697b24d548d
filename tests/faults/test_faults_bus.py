"""Cases 12 to 14, 16, 20 to 28: unknown senders, disturbances, adapters that fail, links that go."""

import errno
import time

import can
import pytest

from firmware_sim import frames as node
from hil.edge.can.slcan_lines import MAX_LINE_BYTES
from hil.wire.command_sender import CommandSender
from hil.wire.receiver import Receiver
from tests.bus.bus_bench import RawAdapter, closing, line, next_frame
from tests.faults.faults_bench import (
    OFF,
    RX_S,
    T_S,
    TIME_TOLERANCE_S,
    W_S,
    assert_no_trip,
    assert_safe,
    assert_tripped,
    contract,
    fault,
    play,
    scenario_data,
)
from tests.narrowing import not_none

AT_S = 5.0
GOOD = b"\x11\x22\x33\x44\x55\x66\x77"
SEALED = node.pack_levels(node.LOWER_LEVELS_ID, (6.2, 6.4), (node.ChannelStatus.OK,) * 2, 3)


def test_case_12_babbling_node_of_a_foreign_id() -> None:
    """3000 frames/s that are none of ours: kept out, and the ages of what is ours stay below a period."""
    run = play(scenario_data(fault("babble", AT_S, "foreign", 3000.0), duration_s=8.0))
    assert_no_trip(run)
    for tick in run.from_s(AT_S):
        assert max(tick.levels_age_s, tick.status_age_s) <= T_S + TIME_TOLERANCE_S
    assert run.outcome.frames_lost == 0


def test_case_13_babbling_node_of_top_priority() -> None:
    """Nothing else gets through: the node is safe within W, the controller trips on age within max(Rx, W)."""
    run = play(scenario_data(fault("babble", AT_S, "top", 4000.0)))
    assert_tripped(run, AT_S, max(RX_S, W_S), "stale_levels", "stale_status", "node_lost")
    assert_safe(run, AT_S)


@pytest.mark.parametrize("volts", [0.0, 3.0, 10.0])
def test_case_14_foreign_command(volts: float) -> None:
    """Somebody else commands the pumps: latched in the step that sees the first frame; 0 V once, then silence."""
    run = play(scenario_data(fault("foreign_command", AT_S, None, volts, until_s=AT_S + 0.35)), is_alone=False)
    assert run.cause == "foreign_command"
    assert AT_S <= run.trip_s <= AT_S + T_S
    after = [data for t_s, data in run.keeper.sent if t_s > run.start_s + run.trip_s - TIME_TOLERANCE_S]
    assert len(after) == 1, "the trip's 0 V, and nothing more"
    assert run.at(run.trip_s).command_V == OFF
    assert run.emulator.pump.applied_V == OFF, "with nobody left to command it the node has come to rest"


@pytest.mark.parametrize("garbage", [b"t18271122\r", b"t1827112233\r", b"t18\r", b"t1828\r"])
def test_case_16_slcan_payload_shorter_than_its_length(garbage: bytes) -> None:
    """A line that says more bytes than it has: dropped, nothing raises, the next frame is received."""
    with closing(RawAdapter()) as adapter:
        receiver = Receiver(contract(), CommandSender(contract()), (0.0, 10.24))
        adapter.say(garbage + line(data=SEALED))
        end_s = time.monotonic() + 2.0
        while receiver.accepted == 0 and time.monotonic() < end_s:
            message = adapter.port.receive(0.02)
            if message is not None:
                receiver.take(message, time.monotonic_ns())
        assert adapter.port.is_up
        assert receiver.accepted == 1
        assert not receiver.rejections
        assert sum(adapter.port.line_counts.values()) == 1, "counted once"


@pytest.mark.parametrize(("rate_per_s", "trips"), [(5.0, False), (15.0, False), (25.0, True), (200.0, True)])
def test_case_20_error_frames(rate_per_s: float, trips: bool) -> None:
    """A few are counted, a storm of 20 within a second trips within that second."""
    run = play(scenario_data(fault("error_frames", AT_S, None, rate_per_s)))
    if trips:
        assert_tripped(run, AT_S, 1.0, "error_storm")
        return
    assert_no_trip(run)
    assert run.ticks[-1].rejected == pytest.approx((run.ticks[-1].t_s - AT_S) * rate_per_s, abs=2)


def test_case_21_bus_off() -> None:
    """Nothing goes out or comes in: the node is safe within W, and never armed again by itself when the bus is back."""
    run = play(scenario_data(fault("bus_off", AT_S, None, until_s=AT_S + 0.7)))
    assert_tripped(run, AT_S, RX_S + T_S)
    assert_safe(run, AT_S)
    again = play(scenario_data(duration_s=5.0, rig={"safety": {"arm_timeout_s": 2.0}}), emulator=run.emulator)
    assert again.outcome.status == "failed"
    assert "tripped" in again.outcome.reason
    assert again.emulator.pump.applied_V == OFF
    cleared = play(scenario_data(duration_s=5.0), emulator=again.emulator, clear_trip=True, checks=False)
    assert cleared.outcome.status == "complete", "on purpose it is"


class WithForeignHeartbeats(can.BusABC):
    """Our end of the bus, on which somebody sends heartbeats of one byte: so many before each step's frames."""

    def __init__(self, bus: can.BusABC, count: int, can_id: int) -> None:
        super().__init__(channel="foreign")
        self._inner, self.count, self._id, self._left = bus, count, can_id, count

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._inner.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self._left:
            self._left -= 1
            return can.Message(arbitration_id=self._id, is_extended_id=False, data=b"\x05")
        message = self._inner.recv(timeout)
        if message is None:
            self._left = self.count
        return message

    def shutdown(self) -> None:
        super().shutdown()


FOREIGN_HEARTBEAT = (
    "another node on the bus uses the identifier {0:#05x}: give it another CANopen node id than {1}, or take it off "
    "this bus"
)


@pytest.mark.parametrize("can_id", [0x701, 0x702])
def test_foreign_heartbeats_at_10_hz_change_nothing(can_id: int) -> None:
    run = play(scenario_data(), wrap=lambda bus: WithForeignHeartbeats(bus, 1, can_id))
    assert_no_trip(run)
    assert run.ticks[-1].rejected >= 0.9 * len(run.ticks)


@pytest.mark.parametrize("can_id", [0x701, 0x702])
def test_a_flood_of_foreign_heartbeats_is_named_by_identifier_cause_and_what_to_do(can_id: int) -> None:
    """The trip used to say that frames are refused one after the other, neither which nor why."""
    run = play(
        scenario_data(rig={"safety": {"arm_timeout_s": 2.0}}), wrap=lambda bus: WithForeignHeartbeats(bus, 100, can_id)
    )
    assert run.outcome.status == "failed"
    assert run.outcome.reason.startswith(
        f"not ready within 2 s: consecutive frames of one identifier are refused; frames of {can_id:#05x} rejected: "
    )
    assert run.outcome.reason.endswith(
        " length (1 byte instead of 8, like a CANopen heartbeat); " + FOREIGN_HEARTBEAT.format(can_id, can_id - 0x700)
    )


def test_a_flood_of_foreign_heartbeats_in_a_run_trips_with_the_same_words() -> None:
    bus: WithForeignHeartbeats | None = None

    def wrap(ours: can.BusABC) -> can.BusABC:
        nonlocal bus
        bus = WithForeignHeartbeats(ours, 0, 0x701)
        return bus

    def on_step(t_s: float) -> None:
        assert bus is not None
        bus.count = 100 if t_s >= AT_S else 0

    run = play(scenario_data(), wrap=wrap, on_step=on_step)
    assert_tripped(run, AT_S, 2 * T_S, "frames_refused")
    text = next(event.text for _, event in run.events if event.code == "trip")
    assert "frames of 0x701 rejected: " in text
    assert "1 byte instead of 8, like a CANopen heartbeat" in text
    assert FOREIGN_HEARTBEAT.format(0x701, 1) in text


class Failing(can.BusABC):
    """Our end of the bus, whose sends or receives fail from the `count`-th send on."""

    def __init__(self, bus: can.BusABC, count: int, error: Exception, *, receives: bool) -> None:
        super().__init__(channel="failing")
        self._inner, self._left, self._error, self._receives = bus, count, error, receives

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._left -= 1
        if self._left < 0:
            raise self._error
        self._inner.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self._receives and self._left <= 0:
            raise self._error
        return self._inner.recv(timeout)

    def shutdown(self) -> None:
        super().shutdown()


NOT_ECHOED = "the pump node reports 0 V, but the last command was not echoed"
SENDS = 53
DOWN = OSError(errno.ENETDOWN, "Network is down")
FULL = can.CanOperationError("Transmit buffer full", errno.ENOBUFS)


def test_case_22_interface_down() -> None:
    """The interface goes down: safe within W, and the run ends; a new one is not armed by itself."""
    run = play(scenario_data(duration_s=30.0), wrap=lambda bus: Failing(bus, SENDS, DOWN, receives=True))
    assert run.cause == "bus_failed"
    down_s = run.at(run.trip_s).t_s
    assert_safe(run, down_s - T_S, W_S + T_S)
    assert run.outcome.t_s - down_s <= 5.0
    again = play(scenario_data(duration_s=5.0, rig={"safety": {"arm_timeout_s": 2.0}}), emulator=run.emulator)
    assert again.outcome.status == "failed"


def test_case_23_transmit_queue_full() -> None:
    """The queue takes nothing more: each refused command is dropped for good, trip within 3 T, node safe within W."""
    run = play(scenario_data(duration_s=30.0), wrap=lambda bus: Failing(bus, SENDS, FULL, receives=False))
    last_s = run.keeper.sent[-1][0] - run.start_s
    assert len(run.keeper.sent) == SENDS
    assert_tripped(run, last_s, T_S + 3 * T_S, "bus_failed", "node_tripped")
    assert_safe(run, last_s)


@pytest.mark.parametrize("garbage", [b"\xff", b"t18\xff7\r", b"\x80\x81\xfe\r"])
def test_case_25_slcan_byte_beyond_ascii(garbage: bytes) -> None:
    """A byte that is no ASCII: frames go on being received within Rx."""
    with closing(RawAdapter()) as adapter:
        started_s = time.monotonic()
        adapter.say(garbage)
        message = None
        while message is None:
            adapter.say(line(data=GOOD))
            message = next_frame(adapter.port, 0.02)
            assert time.monotonic() - started_s < RX_S
        assert bytes(message.data) == GOOD
        assert adapter.port.is_up


def test_case_26_slcan_line_without_end() -> None:
    """A line that never ends: no more than 1 kB of it is kept, and the next frame after it is received."""
    with closing(RawAdapter()) as adapter:
        for _ in range(60):
            adapter.say(b"A" * 256)
            adapter.port.receive(0.005)
            assert adapter.bus.lines.kept <= MAX_LINE_BYTES == 1024
        adapter.say(b"\r" + line(data=GOOD))
        assert bytes(not_none(next_frame(adapter.port)).data) == GOOD


@pytest.mark.parametrize("from_s", [0.0, AT_S])
def test_case_27_every_send_refused(from_s: float) -> None:
    """Sends that go nowhere: never armed on; in a run the node is safe within W, the missing echo trips within 5 T."""
    run = play(scenario_data(fault("frame_loss", from_s, "PumpCommand", 1.0)))
    assert_tripped(run, from_s, 5 * T_S, "echo_missing", "node_tripped")
    assert run.node_off_s(from_s) <= from_s + W_S
    assert run.outcome.reason == f"{run.cause}; {NOT_ECHOED}", "two facts, and the first is true"


def test_case_27_every_send_refused_from_the_start() -> None:
    """An adapter that says it sent and never does: the pumps never move, and the missing echo trips within 5 T."""
    refused = can.CanOperationError("refused")

    class Deaf(Failing):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            del msg, timeout  # says that it went out

    run = play(
        scenario_data(rig={"safety": {"arm_timeout_s": 2.0}}), wrap=lambda bus: Deaf(bus, 1, refused, receives=False)
    )
    assert run.cause == "echo_missing", run.told
    assert run.outcome.reason == f"echo_missing; {NOT_ECHOED}"
    assert run.trip_s <= 5 * T_S + TIME_TOLERANCE_S
    assert all(change.applied_V == OFF for change in run.keeper.changes if change.node == "pump")
