"""Hosts that abuse the emulator's adapter, over TCP and over a pty: it goes on, keeps little, serves the next one."""

import os
import socket
import struct
import termios
import tty
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_sim.links import OUTPUT_MAX_BYTES, listen
from firmware_sim.ports import PtyPort, TcpPort
from firmware_sim.rig import Rig
from firmware_sim.slcan_port import LINE_MAX
from tests.firmware_sim.sim_bench import MS, shipped
from tests.narrowing import not_none

COMMAND = b"t2016983A204E1106\r"
BYTES = st.binary(max_size=200) | st.sampled_from(
    [
        b"O\r",
        b"C\r",
        b"L\r",
        b"S6\r",
        b"Z1\r",
        b"V\r" * 300,
        b"\r" * 4096,
        b"\a\a",
        b"t" * 3000,
        COMMAND,
        COMMAND[:9],
        COMMAND * 200,
        b"T1FFFFFFF0\rr2018\rt2018" + b"\xff" * 8 + b"\r",
        b"t2010\rt18180000000000000000\r",
        b"\x80\xff\x00\n",
    ]
)
HOST = st.sampled_from(["connect", "close", "reset", "half close", "read"]) | BYTES


class Turns:
    """A port and its rig, turn by turn, 20 ms apart."""

    def __init__(self, port: TcpPort | PtyPort, rig: Rig) -> None:
        self.port, self.rig, self.now_ns = port, rig, 0

    def turn(self) -> None:
        self.now_ns += 20 * MS
        assert self.port.read(self.now_ns)
        self.port.send(self.rig.advance(self.now_ns))
        if self.port._link is not None:
            assert len(self.port._link.port._line) <= LINE_MAX
            assert len(self.port._link.queue) <= OUTPUT_MAX_BYTES
        assert all(0.0 <= volts <= 10.0 for volts in self.rig.truth().applied_V)


class TcpHost:
    """The near end of a TCP port."""

    def __init__(self, port: TcpPort) -> None:
        self._address = port._listener.getsockname()
        self._socket: socket.socket | None = None

    def do(self, what: Any) -> None:
        if what == "connect":
            self.do("close")
            self._socket = socket.create_connection(self._address)
            self._socket.setblocking(False)
        elif self._socket is None:
            return
        elif what == "close":
            self._socket.close()
            self._socket = None
        elif what == "reset":
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self.do("close")
        else:
            with suppress(OSError):  # refused, closed by the other end, or full
                if what == "half close":
                    self._socket.shutdown(socket.SHUT_WR)
                elif what == "read":
                    self._socket.recv(4096)
                else:
                    self._socket.send(what)

    def asks(self, what: bytes, turns: Turns) -> bytes | None:
        near = not_none(self._socket)
        near.send(what)
        for _ in range(200):
            turns.turn()
            with suppress(BlockingIOError):
                return near.recv(65_536)
        return None


class PtyHost:
    """The near end of a pty."""

    def __init__(self, port: PtyPort) -> None:
        self._path = port.path
        self._fd: int | None = None

    def do(self, what: Any) -> None:
        if what == "connect":
            self.do("close")
            self._fd = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self._fd)
        elif self._fd is None:
            return
        elif what in ("close", "reset"):
            os.close(self._fd)
            self._fd = None
        else:
            with suppress(OSError):
                if what == "half close":
                    termios.tcsendbreak(self._fd, 0)
                elif what == "read":
                    os.read(self._fd, 4096)
                else:
                    os.write(self._fd, what)

    def asks(self, what: bytes, turns: Turns) -> bytes | None:
        near = not_none(self._fd)
        os.write(near, what)
        for _ in range(200):
            turns.turn()
            with suppress(BlockingIOError):
                return os.read(near, 65_536)
        return None


def on_tcp() -> tuple[Turns, TcpHost]:
    rig = Rig(shipped(), (), 1, 0)
    port = TcpPort(rig, listen(0))
    return Turns(port, rig), TcpHost(port)


def on_pty() -> tuple[Turns, PtyHost]:
    rig = Rig(shipped(), (), 1, 0)
    port = PtyPort(rig)
    return Turns(port, rig), PtyHost(port)


@pytest.mark.parametrize("make", [on_tcp, on_pty])
@given(st.lists(HOST, max_size=25))
@settings(max_examples=60, deadline=None)
def test_whatever_hosts_do_the_rig_goes_on_and_the_next_host_is_served(
    make: Callable[[], tuple[Turns, TcpHost | PtyHost]], steps: list[str | bytes]
) -> None:
    turns, host = make()
    try:
        host.do("connect")
        for what in steps:
            host.do(what)
            turns.turn()
        host.do("close")
        for _ in range(3):
            turns.turn()
        host.do("connect")
        for _ in range(3):
            turns.turn()
        assert not_none(host.asks(b"V\r", turns)).endswith(b"V1013\r")
    finally:
        host.do("close")
        turns.port.close()


@pytest.mark.parametrize("make", [on_tcp, on_pty])
def test_a_host_that_floods_and_never_reads_is_taken_a_bounded_piece_a_turn(
    make: Callable[[], tuple[Turns, TcpHost | PtyHost]],
) -> None:
    turns, host = make()
    try:
        host.do("connect")
        host.do(b"O\r")
        for _ in range(300):
            host.do(COMMAND * 500)
            turns.turn()
        host.do("close")
        for _ in range(100):  # what it has left in the line comes first
            turns.turn()
        assert turns.port._link is None
        host.do("connect")
        turns.turn()
        assert not_none(host.asks(b"V\r", turns)).endswith(b"V1013\r")
    finally:
        host.do("close")
        turns.port.close()
