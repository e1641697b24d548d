"""The slcan line as it may come from a bad cable, a bad adapter or one that has stopped reading."""

import fcntl
import os
import struct
import termios
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import can
import pytest

from firmware_sim.links import open_pty
from firmware_sim.slcan_port import SlcanPort
from hil.core.types import Pair
from hil.edge.can import slcan_bus
from hil.edge.can.bus import MAX_BATCH, BusAddress, BusPort
from hil.edge.can.slcan_bus import MAX_LATE_READS, STALE_S
from hil.edge.can.slcan_lines import MAX_LINE_BYTES
from tests.bus.bus_bench import (
    COMMAND_ID,
    GARBAGE,
    LEVELS_ID,
    RawAdapter,
    answer_opening,
    closing,
    line,
    next_frame,
)
from tests.narrowing import not_none
from tests.waiting import wait_for

GOOD = b"\x11\x22\x33\x44\x55\x66\x77"


@pytest.fixture
def adapter() -> Iterator[RawAdapter]:
    with closing(RawAdapter()) as one:
        yield one


def assert_still_receives(adapter: RawAdapter) -> None:
    adapter.say(line(data=GOOD))
    message = next_frame(adapter.port)
    assert message is not None, adapter.port.last_error
    assert bytes(message.data) == GOOD


def settle(port: BusPort) -> None:
    """Read until nothing comes any more."""
    for _ in range(6):
        port.receive(0.005)


@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE.keys())
def test_the_next_frame_after_garbage_is_received(adapter: RawAdapter, garbage: bytes) -> None:
    """One byte beyond ASCII used to count as a lost link: python-can hides the cause inside its own error."""
    adapter.say(garbage)
    settle(adapter.port)
    assert adapter.port.is_up, adapter.port.last_error
    assert_still_receives(adapter)


@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE.keys())
def test_garbage_in_the_midst_of_frames_costs_none_of_them(adapter: RawAdapter, garbage: bytes) -> None:
    for _ in range(30):
        adapter.say(line(data=GOOD) + garbage + line(data=GOOD))
    got = [next_frame(adapter.port) for _ in range(60)]
    assert [bytes(not_none(message).data) for message in got] == [GOOD] * 60
    assert adapter.port.is_up


REJECTED = {
    "byte beyond ASCII": {"rejected_garbled": 1},
    "letters for digits": {"rejected_identifier": 1},
    "length beyond 8": {"rejected_length": 1},
    "payload shorter than its length": {"rejected_payload": 1},
    "half a byte": {"rejected_payload": 1},
    "number above 0x7FF": {"rejected_identifier": 1},
    "many refusals": {"refused": 50},
    "answer to a command": {},
    "version": {},
}


@pytest.mark.parametrize("name", REJECTED)
def test_what_is_dropped_is_counted_by_its_cause(adapter: RawAdapter, name: str) -> None:
    adapter.say(GARBAGE[name])
    assert_still_receives(adapter)
    assert adapter.port.line_counts == {"refused": 0, "dropped": 0} | REJECTED[name]


def test_nothing_but_garbage_leaves_the_link_up(adapter: RawAdapter) -> None:
    """That nothing of ours comes is seen by its age, whatever else comes; a link whose bytes arrive is not lost."""
    adapter.say(GARBAGE["length beyond 8"] * 300)
    settle(adapter.port)
    assert adapter.port.line_counts["rejected_length"] == 300
    assert (adapter.port.is_up, adapter.port.receive_failures) == (True, 0)
    assert_still_receives(adapter)


def test_a_line_may_come_in_pieces(adapter: RawAdapter) -> None:
    whole = line(data=GOOD)
    for cut in range(1, len(whole)):
        adapter.say(whole[:cut])
        assert adapter.port.receive(0.005) is None
        adapter.say(whole[cut:])
        message = next_frame(adapter.port)
        assert message is not None
        assert bytes(message.data) == GOOD


def test_a_line_without_end_fills_no_memory_and_reception_goes_on(adapter: RawAdapter) -> None:
    for _ in range(100):
        adapter.say(b"A" * 1500)
        adapter.port.receive(0.002)
        assert adapter.bus.lines.kept <= MAX_LINE_BYTES
    adapter.say(b"\r")
    settle(adapter.port)
    assert adapter.port.line_counts["rejected_endless"] == 1
    assert adapter.port.is_up
    assert_still_receives(adapter)


def unread_bytes(adapter: RawAdapter) -> int:
    """Bytes that have arrived at our end and have not been read."""
    (count,) = struct.unpack("i", fcntl.ioctl(adapter.bus._line._fd, termios.FIONREAD, struct.pack("i", 0)))
    return int(count)


def test_a_babbling_line_can_not_hold_a_step_up(adapter: RawAdapter) -> None:
    frames = MAX_BATCH + 500
    adapter.say(line() * frames)
    wait_for(lambda: unread_bytes(adapter) == len(line()) * frames)
    assert len(adapter.port.waiting()) == MAX_BATCH
    assert len(adapter.port.waiting()) == 500, "none is lost"


@pytest.mark.parametrize("read_ms", [0.01, 1.0, 5.0])
def test_an_endless_flood_of_foreign_frames_does_not_keep_receive_past_its_time(
    adapter: RawAdapter, monkeypatch: pytest.MonkeyPatch, read_ms: float
) -> None:
    """On a clock that is handed in: each read takes read_ms and brings frames, for ever."""
    now_s, reads = 100.0, 0

    class Flood:
        def read(self, timeout_s: float | None) -> bytes:
            nonlocal now_s, reads
            del timeout_s
            now_s += read_ms * 1e-3
            reads += 1
            assert now_s < 200.0, "never returns"
            return line(0x333) * 10

    with monkeypatch.context() as patch:
        patch.setattr(adapter.bus, "_line", Flood())
        patch.setattr(slcan_bus, "time", SimpleNamespace(monotonic=lambda: now_s, time=time.time))
        assert adapter.port.receive(0.02) is None
    in_time = round(20.0 / read_ms)
    assert reads <= max(in_time + 1, MAX_LATE_READS), "at most 64 kB after its time is over"


def test_a_command_goes_out_as_one_line_with_nothing_added(adapter: RawAdapter) -> None:
    assert adapter.port.send(COMMAND_ID, GOOD[:6], 0.0)
    assert wait_for(adapter.heard) == line(COMMAND_ID, GOOD[:6])


def send_until_it_fails(port: BusPort, longest_s: float) -> Pair:
    """Sends that succeeded before three failed, and how long the third slowest of all took.

    If a full line blocked sends, the three that failed would all be slow. One or two may be: a busy machine's doing.
    """
    sent, times_s, end_s = 0, [], time.monotonic() + longest_s
    while port.is_up and time.monotonic() < end_s:
        started_s = time.monotonic()
        sent += port.send(COMMAND_ID, bytes(6), 0.0)
        times_s.append(time.monotonic() - started_s)
    return sent, sorted(times_s)[-3]


def test_an_adapter_that_does_not_read_fails_sends_and_never_blocks_them() -> None:
    """Writing without waiting used to spin for ever inside pyserial once the line's buffer was full."""
    with closing(RawAdapter(receive_buffer=2048)) as adapter:
        sent, third_slowest_s = send_until_it_fails(adapter.port, 20.0)
        assert not adapter.port.is_up, sent
        assert adapter.port.send_failures == 3
        assert third_slowest_s < 0.1


def test_after_a_failed_send_nothing_of_it_is_sent_later() -> None:
    """What the line's buffer took before it was full comes out; the refused commands do not follow."""
    with closing(RawAdapter(receive_buffer=2048)) as adapter:
        sent, _ = send_until_it_fails(adapter.port, 20.0)
        heard = b""
        quiet_s = time.monotonic() + 0.3
        while time.monotonic() < quiet_s:
            more = adapter.heard()
            heard += more
            if more:
                quiet_s = time.monotonic() + 0.3
        assert heard.count(line(COMMAND_ID, bytes(6))) == sent


@pytest.fixture
def opened_pty() -> Iterator[tuple[int, BusPort]]:
    """The master of a pty whose slave is open as a bus, after which nobody answers any more."""
    master, path = open_pty()
    held = os.open(path, os.O_RDWR | os.O_NOCTTY)
    opening = threading.Thread(
        target=answer_opening, args=(lambda: os.read(master, 4096), lambda data: os.write(master, data)), daemon=True
    )
    opening.start()
    port = BusPort(BusAddress("slcan", path, 500_000).open((LEVELS_ID,)))
    opening.join()
    os.close(held)
    yield master, port
    os.close(master)
    port.close()


def test_a_tty_is_not_waited_for_to_drain(opened_pty: tuple[int, BusPort], monkeypatch: pytest.MonkeyPatch) -> None:
    """An adapter that has stalled would otherwise hold the control loop in tcdrain until a signal came."""
    monkeypatch.setattr(termios, "tcdrain", lambda _: pytest.fail("waits for the adapter"))
    _, port = opened_pty
    assert port.send(COMMAND_ID, GOOD[:6], 0.0), port.last_error


def test_a_pty_that_nobody_reads_fails_sends_and_never_blocks_them(opened_pty: tuple[int, BusPort]) -> None:
    _, port = opened_pty
    sent, third_slowest_s = send_until_it_fails(port, 10.0)
    assert not port.is_up, sent
    assert third_slowest_s < 0.1


def test_an_adapter_that_has_stopped_answering_gets_no_more_commands(adapter: RawAdapter) -> None:
    """What waits in the line can't be taken back: of an adapter that answers, it is a quarter of a second's worth."""
    adapter.port.send(COMMAND_ID, GOOD[:6], 0.0)
    adapter.say(b"z\r")
    adapter.port.receive(0.02)
    adapter.heard()
    started_s = time.monotonic()
    while adapter.port.send(COMMAND_ID, GOOD[:6], 0.0):
        assert time.monotonic() - started_s < 2.0
        time.sleep(0.02)
    assert STALE_S <= time.monotonic() - started_s < STALE_S + 0.5
    assert adapter.port.line_counts["dropped"] == 1
    assert "not answered" in adapter.port.last_error
    adapter.heard()
    adapter.say(b"z\r")
    wait_for(lambda: adapter.port.receive(0.01) or adapter.port.send(COMMAND_ID, GOOD[:6], 0.0))
    assert wait_for(adapter.heard) == line(COMMAND_ID, GOOD[:6]), "the refused one does not follow"


def test_answers_that_wait_unread_are_seen_before_a_command_is_dropped(adapter: RawAdapter) -> None:
    """A controller that was stopped for a second finds them when it goes on."""
    adapter.port.send(COMMAND_ID, GOOD[:6], 0.0)
    adapter.say(b"z\r")
    adapter.port.receive(0.02)
    adapter.port.send(COMMAND_ID, GOOD[:6], 0.0)
    adapter.say(line(data=GOOD) * 200 + b"z\r")
    time.sleep(STALE_S + 0.1)
    assert adapter.port.send(COMMAND_ID, GOOD[:6], 0.0), adapter.port.last_error
    assert len(adapter.port.waiting()) == 200


@pytest.mark.parametrize("refusal", [b"\a", b"\a\r"])
def test_refused_commands_are_counted_and_leave_the_link_up(adapter: RawAdapter, refusal: bytes) -> None:
    for _ in range(5):
        assert adapter.port.send(COMMAND_ID, GOOD[:6], 0.0)
        adapter.say(refusal)
        adapter.port.receive(0.02)
    assert adapter.port.line_counts["refused"] == 5
    assert adapter.port.is_up


def test_a_line_of_which_a_part_went_out_is_not_completed_by_the_next(
    adapter: RawAdapter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of a command in the adapter's buffer: what comes next must not make it whole, or be swallowed by it."""
    serial_line = adapter.bus._line
    whole, sizes = serial_line.write, [7, 3]
    monkeypatch.setattr(
        serial_line, "write", lambda data, timeout_s: whole(data[: sizes.pop()] if sizes else data, timeout_s)
    )
    assert not adapter.port.send(COMMAND_ID, GOOD[:6], 0.0)
    assert not adapter.port.send(COMMAND_ID, GOOD[:6], 0.0)
    assert adapter.port.send(COMMAND_ID, b"\xee" * 6, 0.0)
    heard = wait_for(adapter.heard)
    _, frames = opened_adapter().feed(heard)
    assert [bytes(frame.data) for frame in frames] == [b"\xee" * 6]


def opened_adapter() -> SlcanPort:
    adapter = SlcanPort()
    adapter.feed(b"O\r")
    return adapter


def test_what_python_cans_users_know_works(adapter: RawAdapter) -> None:
    """Notifier, filters, recv without a time, frames that can't be said, shutdown twice."""
    bus = adapter.bus
    heard = can.BufferedReader()
    notifier = can.Notifier(bus, [heard], timeout=0.05)
    adapter.say(line(data=GOOD))
    assert bytes(not_none(heard.get_message(2.0)).data) == GOOD
    notifier.stop()
    bus.set_filters([{"can_id": 0x333, "can_mask": 0x7FF}])
    adapter.say(line(data=GOOD) + line(0x333, b"\x01"))
    message = bus.recv()
    assert message is not None
    assert (message.arbitration_id, bytes(message.data), message.is_rx) == (0x333, b"\x01", True)
    assert message.timestamp == pytest.approx(time.time(), abs=5.0)
    with pytest.raises(ValueError, match="slcan has neither"):
        bus.send(can.Message(is_fd=True, data=bytes(12)))
    bus.shutdown()
    bus.shutdown()
    calls: tuple[Callable[[], object], ...] = (lambda: bus.recv(0.0), lambda: bus.send(can.Message(data=b"")))
    for call in calls:
        with pytest.raises(can.CanOperationError, match="the line is closed"):
            call()


def test_a_frame_sent_waits_for_room_as_long_as_it_is_told_to(opened_pty: tuple[int, BusPort]) -> None:
    """A pty stays full, unlike a TCP line, once the system has moved on what it had taken."""
    _, port = opened_pty
    failed = 0
    while failed < 50:
        failed = 0 if port.send(COMMAND_ID, bytes(6), 0.0) else failed + 1
        time.sleep(0.01 if failed else 0.0)
    started_s = time.monotonic()
    with pytest.raises(can.CanOperationError, match="accepts no more"):
        port._bus.send(can.Message(data=b""), timeout=0.2)
    assert 0.2 <= time.monotonic() - started_s < 0.7
