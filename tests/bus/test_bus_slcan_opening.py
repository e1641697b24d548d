"""Opening an slcan adapter in whatever state it is: booting, open, listening, talking, mute, or no adapter at all."""

import os
import select
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import can
import pytest

from firmware_sim.links import open_pty
from firmware_sim.slcan_port import Channel, SlcanPort
from hil.edge.can.bus import BusAddress, BusError
from hil.edge.can.serial_line import SerialLine
from hil.edge.can.slcan_bus import MAX_REFUSALS, OPEN_TIMEOUT_S, SlcanBus
from tests.bus.bus_bench import BITRATE, IDS, LEVELS_ID, line

SOON_S = 0.5
"""For those that are never opened: time for two attempts."""


class Adapter:
    """A pty with an adapter behind it, which may be odd. heard : all commands that reached it."""

    def __init__(self) -> None:
        self.heard = bytearray()
        self.port = SlcanPort()
        self.is_answering: bool | None = None  # as our end found it

    def answer(self, data: bytes) -> bytes:
        """What it says to these bytes."""
        self.heard += data
        return self.port.feed(data)[0]

    def unasked(self) -> bytes:
        """What it says by itself, once a turn of a millisecond."""
        return b""


@contextmanager
def plugged(adapter: Adapter) -> Iterator[str]:
    """The path of its tty."""
    master, path = open_pty()
    held = os.open(path, os.O_RDWR | os.O_NOCTTY)
    os.set_blocking(master, False)
    is_over = threading.Event()

    def serve() -> None:
        while not is_over.is_set():
            if select.select([master], [], [], 0.001)[0]:
                say(adapter.answer(os.read(master, 4096)))
            say(adapter.unasked())

    def say(data: bytes) -> None:
        with suppress(BlockingIOError):
            os.write(master, data)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield path
    finally:
        is_over.set()
        thread.join()
        os.close(held)
        os.close(master)


def opened(adapter: Adapter, bitrate: int = BITRATE, timeout_s: float = OPEN_TIMEOUT_S) -> int:
    """How many attempts it took to open it; it must be open then, and answer."""
    with plugged(adapter) as path:
        with SlcanBus(path, bitrate, open_timeout_s=timeout_s) as bus:
            assert adapter.port.channel is Channel.OPEN
            assert bus.counts == {"refused": 0, "dropped": 0}, "what the opening took is nothing to report"
            adapter.is_answering = bus.is_answering
            bus.send(can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(6)))
            assert_heard(adapter, line(0x201, bytes(6)))
        assert_heard(adapter, b"C\r")
        return attempts(adapter)


def attempts(adapter: Adapter) -> int:
    """Each attempt asks for the version once, and takes a bounded time: counted, as a busy machine makes none more."""
    return adapter.heard.count(b"V\r")


def assert_heard(adapter: Adapter, what: bytes) -> None:
    end_s = time.monotonic() + 2.0
    while not adapter.heard.endswith(what):
        assert time.monotonic() < end_s, bytes(adapter.heard)
        time.sleep(0.001)


def refused(adapter: Adapter, timeout_s: float = SOON_S) -> str:
    with plugged(adapter) as path, pytest.raises(can.CanInitializationError) as caught:
        SlcanBus(path, open_timeout_s=timeout_s)
    assert adapter.port.channel is not Channel.OPEN
    return str(caught.value)


@pytest.mark.parametrize(
    ("bitrate", "command"),
    [
        (10_000, b"S0"),
        (20_000, b"S1"),
        (50_000, b"S2"),
        (100_000, b"S3"),
        (125_000, b"S4"),
        (250_000, b"S5"),
        (500_000, b"S6"),
        (800_000, b"S7"),
        (1_000_000, b"S8"),
    ],
)
def test_every_bit_rate_has_its_command(bitrate: int, command: bytes) -> None:
    adapter = Adapter()
    assert opened(adapter, bitrate) <= 2
    assert b"C\rV\r" + command + b"\rO\r" in adapter.heard


@pytest.mark.parametrize("bitrate", [0, 9_999, 83_300, 300_000, 750_000, 1_000_001])
def test_another_bit_rate_is_refused_before_anything_is_opened(bitrate: int) -> None:
    with pytest.raises(BusError, match=f"slcan has no {bitrate} bit/s, only 10000, 20000, .*1000000$"):
        BusAddress("slcan", "/dev/nothing-there", bitrate).open(IDS)


@pytest.mark.parametrize("before", [b"O\r", b"L\r", b"Z1\rO\r", b"t2016983A20", b"O\rt20169", b"C\rS", b"x" * 3000])
def test_whatever_state_it_was_left_in(before: bytes) -> None:
    """Open, listening, stamping frames, or with half a command in its buffer: opened at the first asking."""
    adapter = Adapter()
    adapter.port.feed(before)
    assert opened(adapter) <= 2


def test_frames_of_the_last_host_are_not_taken_for_new_ones_and_hold_nothing_up() -> None:
    """It was left open on a busy bus: frames stand before and between its answers."""

    class Busy(Adapter):
        number = closed_at = 0

        def answer(self, data: bytes) -> bytes:
            before = self.unasked()  # a frame that was on its way
            self.closed_at = self.number if b"C\r" in data else self.closed_at
            return before + super().answer(data)

        def unasked(self) -> bytes:
            self.number += 1
            return self.port.frame_line(
                can.Message(arbitration_id=LEVELS_ID, is_extended_id=False, data=self.number.to_bytes(4, "big"))
            )

    adapter = Busy()
    adapter.port.feed(b"O\r")
    with plugged(adapter) as path:
        while adapter.number < 30:
            time.sleep(0.01)
        with SlcanBus(path) as bus:
            first = bus.recv(2.0)
            assert first is not None
            assert int.from_bytes(first.data, "big") > adapter.closed_at >= 30
            assert bus.counts == {"refused": 0, "dropped": 0}


@pytest.mark.parametrize("boot_s", [0.2, 0.9])
@pytest.mark.parametrize("banner", [b"", b"\xff\x00boot v1.2\rok\r"], ids=["quiet", "banner"])
def test_one_that_boots_slowly_is_asked_again(boot_s: float, banner: bytes) -> None:
    """Opening the line resets many adapters; what they are told meanwhile is lost."""

    class Booting(Adapter):
        def __init__(self) -> None:
            super().__init__()
            self.ready_s = time.monotonic() + boot_s
            self.banner = banner

        def answer(self, data: bytes) -> bytes:
            if time.monotonic() > self.ready_s:
                return super().answer(data)
            said, self.banner = self.banner, b""
            return said

    adapter = Booting()
    assert opened(adapter) <= 2, "once it has booted; what it was told before is lost"
    assert adapter.is_answering


class OneCommandAWrite(Adapter):
    """Obeys the first command of what it reads at a time, and forgets the rest."""

    def answer(self, data: bytes) -> bytes:
        self.heard += data
        return self.port.feed(data[: data.index(b"\r") + 1] if b"\r" in data else data)[0]


@pytest.mark.parametrize("before", [b"", b"O\r", b"L\r", b"Z1\rO\r", b"O\rt20169"])
def test_one_that_obeys_one_command_a_write_is_opened_whatever_a_killed_program_left(before: bytes) -> None:
    """All closing commands used to go out in one write: such an adapter stayed open and refused S6 for ever."""
    adapter = OneCommandAWrite()
    adapter.port.feed(before)
    assert opened(adapter) <= 2


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
@pytest.mark.parametrize("before", [b"", b"O\r"])
def test_one_that_ends_its_lines_otherwise_is_opened_and_its_answers_counted(end: bytes, before: bytes) -> None:
    class OtherEnds(Adapter):
        def answer(self, data: bytes) -> bytes:
            return super().answer(data).replace(b"\r", end)

    adapter = OtherEnds()
    adapter.port.feed(before)
    assert opened(adapter) <= 2
    assert adapter.is_answering


def test_one_that_acknowledges_nothing_but_tells_its_version_is_opened_all_the_same() -> None:
    """Widespread firmware answers nothing else. That it is there is known then; that it is open shows by its frames."""

    class Mute(Adapter):
        def answer(self, data: bytes) -> bytes:
            return b"canable-1a2b3c\r" if b"V1013" in super().answer(data) else b""

    adapter = Mute()
    assert opened(adapter) <= 2
    assert not adapter.is_answering


class Silent(Adapter):
    def answer(self, data: bytes) -> bytes:
        self.heard += data
        return b""


def test_one_that_never_answers_is_an_error_in_bounded_time() -> None:
    started_s, adapter = time.monotonic(), Silent()
    assert refused(adapter) == "the adapter does not answer"
    assert time.monotonic() - started_s >= SOON_S
    assert 1 <= attempts(adapter) <= 2


@pytest.mark.parametrize("command", [b"S6", b"O"])
def test_one_that_refuses_is_an_error_that_says_what(command: bytes) -> None:
    class Refusing(Adapter):
        def answer(self, data: bytes) -> bytes:
            return b"\a" if data == command + b"\r" else super().answer(data)

    adapter = Refusing()
    assert refused(adapter, timeout_s=60.0) == f"the adapter refuses {command.decode()}"
    assert attempts(adapter) == MAX_REFUSALS, "an answer is final: the rest of the minute is not waited for"


@pytest.mark.parametrize("command", [b"S6", b"O"])
def test_one_that_answers_all_but_one_command_is_an_error_that_says_which(command: bytes) -> None:
    class Forgetful(Adapter):
        def answer(self, data: bytes) -> bytes:
            return b"" if data == command + b"\r" else super().answer(data)

    assert refused(Forgetful()) == f"the adapter does not answer {command.decode()}"


def test_what_talks_but_is_no_adapter_is_refused_in_bounded_time() -> None:
    """A GPS receiver, say, or an adapter at another baud rate."""

    class Talking(Silent):
        def unasked(self) -> bytes:
            return b"\xf8\x80garbage"

    adapter = Talking()
    assert refused(adapter) == "the adapter does not answer"
    assert 1 <= attempts(adapter) <= 2


def test_a_line_that_takes_no_commands_is_an_error_in_bounded_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SerialLine, "write", lambda *_: 0)
    assert refused(Silent()) == "the adapter accepts no commands"


NO_ADAPTER = {
    "/dev/nothing-there": "No such file",
    "/dev/null": "Could not configure port",
    "/dev": "Is a directory",
    "socket://127.0.0.1:1": "no program listens on this TCP port; start it first (firmware-sim --slcan PORT)",
    "socket://127.0.0.1:70000": "the TCP port must be a number from 1 to 65535",
    "socket://127.0.0.1": "the TCP port must be a number from 1 to 65535",
    "udp://127.0.0.1:5": "protocol 'udp' not known",
    "loop://": "descriptor",
    "": "",
}


@pytest.mark.parametrize(("channel", "why"), NO_ADAPTER.items(), ids=[name or "nothing" for name in NO_ADAPTER])
def test_what_is_no_line_is_one_clear_error(channel: str, why: str) -> None:
    with pytest.raises(BusError) as caught:
        BusAddress("slcan", channel, BITRATE).open(IDS)
    assert str(caught.value).startswith(f"bus slcan {channel!r} at 500000 bit/s can't be opened: ")
    assert why.lower() in str(caught.value).lower()


def test_a_device_that_another_program_has_open_is_refused() -> None:
    adapter = Adapter()
    with plugged(adapter) as path, SlcanBus(path), pytest.raises(BusError, match="lock"):
        BusAddress("slcan", path, BITRATE).open(IDS)


def test_a_baud_rate_may_stand_behind_the_device() -> None:
    adapter = Adapter()
    with plugged(adapter) as path, SlcanBus(f"{path}@57600") as bus:
        assert bus._line._port.baudrate == 57_600


def test_one_that_goes_while_it_is_opened_is_an_error() -> None:
    master, path = open_pty()
    gone = threading.Timer(0.15, os.close, [master])
    gone.start()
    with pytest.raises(BusError, match="the link to the adapter has failed: "):
        BusAddress("slcan", path, BITRATE).open(IDS)
    gone.join()
