"""Far ends of a bus: a second node on a virtual bus, the emulator's slcan adapter, a raw adapter that may misbehave."""

import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Protocol, TypeVar, cast

import can

from firmware_sim.links import SlcanLink, listen, open_pty
from firmware_sim.slcan_port import Channel, SlcanPort
from hil.edge.can.bus import BusAddress, BusPort
from hil.edge.can.slcan_bus import SlcanBus
from tests.waiting import wait_for

IDS = (0x201, 0x181, 0x182, 0x282, 0x701, 0x702)
LEVELS_ID, STATUS_ID, COMMAND_ID, FOREIGN_ID = 0x182, 0x181, 0x201, 0x333
BITRATE = 500_000

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


def frame(can_id: int = LEVELS_ID, data: bytes = b"\x01\x02\x03\x04\x05\x06\x07", **kind: Any) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, **({"is_extended_id": False} | kind))


def line(can_id: int = LEVELS_ID, data: bytes = b"\x01\x02\x03\x04\x05\x06\x07") -> bytes:
    """A data frame as an slcan adapter says it."""
    return f"t{can_id:03X}{len(data)}{data.hex().upper()}\r".encode()


def filters_for(ids: Iterable[int]) -> list[dict[str, Any]]:
    return [{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in ids]


def next_frame(port: BusPort, timeout_s: float = 2.0) -> can.Message | None:
    """The next frame, however many calls it takes; None when there is none in time or the link is gone."""
    end_s = time.monotonic() + timeout_s
    while port.is_up and time.monotonic() < end_s:
        message = port.receive(0.02)
        if message is not None:
            return message
    return None


def port_on(bus: object) -> BusPort:
    """A port on what stands in for a bus."""
    return BusPort(cast(can.BusABC, bus))


class VirtualFar:
    """A second node on a virtual bus."""

    def __init__(self, channel: str) -> None:
        self._bus = can.Bus(interface="virtual", channel=channel, ignore_config=True)
        self.port = BusPort(BusAddress("virtual", channel, BITRATE).open(IDS))

    def send(self, *frames: can.Message) -> None:
        for one in frames:
            self._bus.send(one)

    def received(self, count: int) -> list[can.Message | None]:
        frames = [self._bus.recv(1.0) for _ in range(count)]
        assert self._bus.recv(0) is None
        return frames

    def vanish(self) -> None:
        self.port._bus.shutdown()  # a virtual bus has no cable: its own end is closed

    def close(self) -> None:
        self.port.close()
        self._bus.shutdown()


class SlcanFar:
    """The emulator's slcan adapter behind a descriptor, served in a thread from before our end is opened."""

    def __init__(self, channel: str, connect: Callable[[], tuple[int, Callable[[], object]]]) -> None:
        """connect : waits for our end; returns the descriptor of the far one, and what closes it."""
        self._connect = connect
        self._lock = threading.Lock()
        self._frames: list[can.Message] = []
        self._is_over = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        self.port = BusPort(BusAddress("slcan", channel, BITRATE).open(IDS))
        assert self._link.port.channel is Channel.OPEN

    @classmethod
    def on_tcp(cls) -> "SlcanFar":
        listener = listen(0)
        listener.setblocking(True)

        def connect() -> tuple[int, Callable[[], None]]:
            with listener:
                client, _ = listener.accept()
            return client.fileno(), client.close

        return cls(f"socket://127.0.0.1:{listener.getsockname()[1]}", connect)

    @classmethod
    def on_pty(cls) -> "SlcanFar":
        master, path = open_pty()
        held = os.open(path, os.O_RDWR | os.O_NOCTTY)  # without anybody the master would hang up

        def close() -> None:
            os.close(master)
            os.close(held)

        def connect() -> tuple[int, Callable[[], object]]:
            return master, close

        return cls(path, connect)

    def send(self, *frames: can.Message) -> None:
        with self._lock:
            for one in frames:
                self._link.send(one)

    def received(self, count: int) -> list[can.Message]:
        wait_for(lambda: len(self._frames) >= count)
        time.sleep(0.02)
        return list(self._frames)

    def vanish(self) -> None:
        if self._thread.is_alive():
            self._is_over = True
            self._thread.join()
            self._let_go()

    def close(self) -> None:
        self.port.close()
        self.vanish()

    def _serve(self) -> None:
        fd, self._let_go = self._connect()
        self._link = SlcanLink(fd)
        while not self._is_over:
            select.select([self._link.fd], [], [], 0.002)
            with self._lock:
                self._frames += self._link.read() or []
                self._link.flush()


def answer_opening(read: Callable[[], bytes], write: Callable[..., int | None]) -> None:
    """Be an adapter until its channel is open; what else comes meanwhile is answered as it would be."""
    adapter = SlcanPort()
    while adapter.channel is not Channel.OPEN:
        reply, _ = adapter.feed(read())
        write(reply)


class RawAdapter:
    """A TCP end of an slcan line that, once opened, says what it is told to, and reads only when asked."""

    def __init__(self, receive_buffer: int | None = None) -> None:
        self._listener = socket.socket()
        if receive_buffer is not None:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self._listener.bind(("127.0.0.1", 0))
        self._listener.listen(1)
        self.channel = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        opening = threading.Thread(target=self._open, daemon=True)
        opening.start()
        self.port = BusPort(BusAddress("slcan", self.channel, BITRATE).open(IDS))
        opening.join()
        if receive_buffer is not None:  # then our end's is small too: it is full sooner
            ours = socket.socket(fileno=self.bus._line._fd)
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, receive_buffer)
            ours.detach()

    def _open(self) -> None:
        self.client, _ = self._listener.accept()
        self.client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        answer_opening(lambda: self.client.recv(4096), self.client.sendall)

    @property
    def bus(self) -> SlcanBus:
        bus = self.port._bus
        assert isinstance(bus, SlcanBus)
        return bus

    def say(self, data: bytes) -> None:
        self.client.sendall(data)

    def heard(self) -> bytes:
        self.client.setblocking(False)
        with suppress(BlockingIOError):
            return self.client.recv(1 << 20)
        return b""

    def close(self) -> None:
        self.client.close()
        self._listener.close()
        self.port.close()


class Closes(Protocol):
    def close(self) -> None: ...


C = TypeVar("C", bound=Closes)


@contextmanager
def closing(far: C) -> Iterator[C]:
    try:
        yield far
    finally:
        far.close()
