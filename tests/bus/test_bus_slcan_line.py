"""The slcan line as it may come from a bad cable, a bad adapter or one that has stopped reading."""

import os
import time

import can
import pytest
import serial
from bus_bench import COMMAND_ID, LEVELS_ID, RawAdapter, closing, line, next_frame, wait_for

from firmware_sim.links import open_pty
from hil.edge.bus import LARGEST_BATCH, BusAddress, BusPort

GOOD = b"\x11\x22\x33\x44\x55\x66\x77"


@pytest.fixture
def adapter():
    with closing(RawAdapter()) as one:
        yield one


def assert_still_receives(adapter):
    adapter.say(line(data=GOOD))
    message = next_frame(adapter.port)
    assert message is not None, adapter.port.last_error
    assert bytes(message.data) == GOOD


def settle(port):
    """Read until nothing comes any more."""
    for _ in range(6):
        port.receive(0.005)


GARBAGE = {
    "byte beyond ASCII": b"t18\xff7\r",
    "only bytes beyond ASCII": b"\x80\x81\xfe\xff\r",
    "null bytes": b"\x00\x00\x00\r",
    "noise": bytes(range(1, 256)) + b"\r",
    "letters for digits": b"tXYZ8\r",
    "no length": b"t182\r",
    "nothing but its kind": b"t\r",
    "length beyond 8": b"t182F11\r",
    "payload shorter than its length": b"t18271122\r",
    "half a byte": b"t18271122334455667\r",
    "number above 0x7FF": b"tFFF0\r",
    "negative number": b"t-110\r",
    "empty line": b"\r",
    "refusal": b"\a",
    "many refusals": b"\a" * 50,
    "answer to a command": b"z\r",
    "version": b"V1013\r",
}


@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE.keys())
def test_the_next_frame_after_garbage_is_received(adapter, garbage):
    """One byte beyond ASCII used to count as a lost link: python-can hides the cause inside its own error."""
    adapter.say(garbage)
    settle(adapter.port)
    assert adapter.port.is_up, adapter.port.last_error
    assert_still_receives(adapter)


@pytest.mark.parametrize("garbage", [GARBAGE["byte beyond ASCII"], GARBAGE["length beyond 8"]])
def test_garbage_in_the_midst_of_frames_costs_frames_but_not_the_link(adapter, garbage):
    for _ in range(30):
        adapter.say(line() + garbage + line())
        settle(adapter.port)
    assert adapter.port.receive_failures >= 30
    assert adapter.port.is_up
    assert_still_receives(adapter)


def test_nothing_but_garbage_is_a_lost_link(adapter):
    adapter.say(GARBAGE["length beyond 8"] * 30)
    for _ in range(30):
        adapter.port.receive(0.005)
    assert not adapter.port.is_up


def test_a_line_may_come_in_pieces(adapter):
    whole = line(data=GOOD)
    for cut in range(1, len(whole)):
        adapter.say(whole[:cut])
        assert adapter.port.receive(0.005) is None
        adapter.say(whole[cut:])
        message = next_frame(adapter.port)
        assert message is not None
        assert bytes(message.data) == GOOD


def test_a_line_without_end_fills_no_memory_and_reception_goes_on(adapter):
    for failures in range(1, 11):
        adapter.say(b"A" * 1500)
        while adapter.port.receive_failures < failures:
            adapter.port.receive(0.002)
            assert len(adapter.port._bus._buffer) <= 1500
    adapter.say(b"\r")
    settle(adapter.port)
    assert adapter.port.is_up
    assert_still_receives(adapter)


def test_a_line_without_any_end_is_a_lost_link(adapter):
    end_s = time.monotonic() + 10.0
    while adapter.port.is_up and time.monotonic() < end_s:
        adapter.say(b"A" * 1500)
        adapter.port.receive(0.005)
    assert not adapter.port.is_up


def test_a_babbling_line_can_not_hold_a_step_up(adapter):
    for _ in range(15):
        adapter.say(line() * 100)
    time.sleep(0.1)
    started_s = time.monotonic()
    batch = adapter.port.waiting()
    assert 0 < len(batch) <= LARGEST_BATCH
    assert time.monotonic() - started_s < 1.0


def test_a_flood_of_foreign_frames_does_not_keep_receive_past_its_time(adapter):
    adapter.say(line(0x333) * 2000)
    started_s = time.monotonic()
    assert adapter.port.receive(0.02) is None
    assert time.monotonic() - started_s < 0.1


def test_a_command_goes_out_as_one_line_with_nothing_added(adapter):
    wait_for(lambda: adapter.heard().endswith(b"O\r"))
    assert adapter.port.send(COMMAND_ID, GOOD[:6], 0.0)
    assert wait_for(adapter.heard) == line(COMMAND_ID, GOOD[:6])


def send_until_it_fails(port, longest_s):
    """Sends that succeeded before three failed, and the longest that any one took."""
    sent, slowest_s, end_s = 0, 0.0, time.monotonic() + longest_s
    while port.is_up and time.monotonic() < end_s:
        started_s = time.monotonic()
        sent += port.send(COMMAND_ID, bytes(6), 0.0)
        slowest_s = max(slowest_s, time.monotonic() - started_s)
    return sent, slowest_s


def test_an_adapter_that_does_not_read_fails_sends_and_never_blocks_them():
    """Writing without waiting used to spin for ever inside pyserial once the line's buffer was full."""
    with closing(RawAdapter(receive_buffer=2048)) as adapter:
        sent, slowest_s = send_until_it_fails(adapter.port, 20.0)
        assert not adapter.port.is_up, sent
        assert adapter.port.send_failures == 3
        assert slowest_s < 0.1


def test_after_a_failed_send_nothing_of_it_is_sent_later():
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


def test_a_tty_is_not_waited_for_to_drain(monkeypatch):
    """An adapter that has stalled would otherwise hold the control loop in tcdrain until a signal came."""
    master, path = open_pty()
    monkeypatch.setattr("can.interfaces.slcan.time.sleep", lambda _: None)
    bus = BusAddress("slcan", path, 500_000).open((LEVELS_ID,))
    monkeypatch.setattr(serial.Serial, "flush", lambda _: pytest.fail("waits for the adapter"))
    port = BusPort(bus)
    try:
        assert port.send(COMMAND_ID, GOOD[:6], 0.0), port.last_error
    finally:
        os.close(master)
        port.close()


def test_a_pty_that_nobody_reads_fails_sends_and_never_blocks_them():
    master, path = open_pty()
    port = BusPort(can.Bus(path, "slcan", bitrate=500_000, sleep_after_open=0, ignore_config=True))
    try:
        sent, slowest_s = send_until_it_fails(port, 10.0)
        assert not port.is_up, sent
        assert slowest_s < 0.1
    finally:
        os.close(master)
        port.close()
