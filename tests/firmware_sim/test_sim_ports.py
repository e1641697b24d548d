"""Ports and service without real time: virtual bus, sockets and pseudo-terminals driven by hand."""

import os
import socket
import tty
from collections.abc import Iterator
from typing import NoReturn, cast

import can
import pytest

from firmware_sim.frames import NodeState
from firmware_sim.links import OUTPUT_MAX_BYTES, LineQueue, listen
from firmware_sim.ports import BusPort, PtyPort, TcpPort
from firmware_sim.pump_node import Change
from firmware_sim.rig import Rig
from tests.firmware_sim.sim_bench import MS, SECOND, command, shipped
from tests.narrowing import not_none

GOOD = b"t2016983A204E1106\r"


def bench(changes: list[Change] | None = None) -> Rig:
    return Rig(shipped(), (), 1, 0, changes.append if changes is not None else None)


@pytest.fixture
def virtual_pair(request: pytest.FixtureRequest) -> Iterator[list[can.BusABC]]:
    name = request.node.name
    buses = [can.Bus(name, "virtual", ignore_config=True, preserve_timestamps=True) for _ in range(2)]
    yield buses
    for bus in buses:
        bus.shutdown()


def received(bus: can.BusABC) -> list[can.Message]:
    frames = []
    while (frame := bus.recv(0)) is not None:
        frames.append(frame)
    return frames


def test_lockstep_over_a_virtual_bus_keeps_simulated_time(virtual_pair: list[can.BusABC]) -> None:
    mine, rigs = virtual_pair
    port = BusPort(bench(), rigs)
    port.step(300 * MS)
    assert [frame.timestamp for frame in received(mine)][-1] == 0.3
    mine.send(command(3.0, 3.0))
    port.step(300 * MS)
    assert port.rig.truth().pump_state is NodeState.RUN
    assert port.rig.start_ns == 300 * MS
    assert received(mine) == []
    port.step(400 * MS)
    assert [frame.timestamp for frame in received(mine)] == [
        *[0.32] * 2,
        *[0.34] * 2,
        0.35,
        *[0.36] * 2,
        *[0.38] * 2,
        *[0.4] * 5,
    ]


class BrokenBus:
    """A bus whose every call fails in its own way."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def recv(self, _timeout: float) -> NoReturn:
        raise self._error

    def send(self, _frame: can.Message, timeout: float) -> NoReturn:  # noqa: ARG002 - named by its callers
        raise self._error

    def fileno(self) -> NoReturn:
        raise self._error


@pytest.mark.parametrize(
    "error", [can.CanOperationError("down"), OSError(100, "down"), ValueError("x"), IndexError("y")]
)
def test_errors_of_a_bus_are_counted_and_survived(error: Exception) -> None:
    port = BusPort(bench(), cast(can.BusABC, BrokenBus(error)))
    port.step(100 * MS)
    assert port.errors["receive"] == 1
    assert port.errors["send"] == 7
    assert port.filenos() == []


def connected(tcp_port: TcpPort) -> socket.socket:
    client = socket.create_connection(tcp_port._listener.getsockname())
    client.setblocking(False)
    return client


def text_of(client: socket.socket) -> bytes | None:
    try:
        return client.recv(65_536)
    except BlockingIOError:
        return None


@pytest.fixture
def tcp() -> Iterator[TcpPort]:
    port = TcpPort(bench(), listen(0))
    yield port
    port.close()


def turn(port: TcpPort | PtyPort, now_ns: int) -> None:
    port.read(now_ns)
    port.read(now_ns)
    port.send(port._rig.advance(now_ns))


def test_tcp_host_opens_reads_levels_and_commands(tcp: TcpPort) -> None:
    with connected(tcp) as client:
        turn(tcp, 100 * MS)
        assert text_of(client) is None
        client.send(b"S6\rO\r")
        turn(tcp, 250 * MS)
        assert not_none(text_of(client)).startswith(b"\r\rt181")
        client.send(GOOD)
        turn(tcp, 300 * MS)
        assert not_none(text_of(client)).startswith(b"z\r")
        assert tcp._rig.truth().pump_state is NodeState.RUN


def test_tcp_takes_one_host_at_a_time_and_a_new_one_after_it_left(tcp: TcpPort) -> None:
    first = connected(tcp)
    turn(tcp, 10 * MS)
    with connected(tcp) as second:
        turn(tcp, 20 * MS)
        assert text_of(second) == b""
        assert tcp.refused == 1
    first.send(b"O\r")
    turn(tcp, 30 * MS)
    assert text_of(first) == b"\r"
    first.close()
    with connected(tcp) as third:
        turn(tcp, 40 * MS)
        third.send(b"V\r")
        turn(tcp, 50 * MS)
        assert text_of(third) == b"V1013\r"


def test_a_new_host_finds_a_closed_channel(tcp: TcpPort) -> None:
    with connected(tcp) as first:
        first.send(b"O\r")
        turn(tcp, 100 * MS)
    with connected(tcp) as second:
        turn(tcp, 300 * MS)
        turn(tcp, 400 * MS)
        assert text_of(second) is None


def test_a_host_that_does_not_read_never_blocks_the_rig_and_is_replaced(tcp: TcpPort) -> None:
    with connected(tcp) as lazy:
        lazy.send(b"O\r")
        for step in range(1, 9000):
            turn(tcp, step * 100 * MS)
            assert tcp._link is not None
            if tcp._link.is_stuck:
                break
        assert tcp._link is not None
        assert tcp._link.queue.dropped > 0
        assert len(tcp._link.queue) <= OUTPUT_MAX_BYTES
        with connected(tcp) as eager:
            turn(tcp, 1000 * SECOND)
            eager.send(b"V\r")
            turn(tcp, 1000 * SECOND)
            assert text_of(eager) == b"V1013\r"


def test_a_second_service_cannot_take_the_port(tcp: TcpPort) -> None:
    with pytest.raises(OSError, match="in use"):
        listen(tcp._listener.getsockname()[1])


def test_queue_drops_whole_oldest_lines_but_never_a_begun_one() -> None:
    queue = LineQueue()
    queue.put(b"begun\r")
    queue.discard(2)
    line = b"x" * 99 + b"\r"
    for _ in range(OUTPUT_MAX_BYTES // 100 + 5):
        queue.put(line)
    assert queue.dropped > 0
    assert queue.waiting() == b"gun\r" + line * (len(queue) // 100)
    queue.discard(4 + 100)
    assert queue.waiting().startswith(line)
    queue.discard(len(queue))
    assert not queue
    assert queue.waiting() == b""


@pytest.fixture
def pty_port() -> Iterator[PtyPort]:
    port = PtyPort(bench())
    yield port
    port.close()


def opened(path: str) -> int:
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(fd)
    return fd


def test_pty_host_comes_goes_and_comes_again(pty_port: PtyPort) -> None:
    turn(pty_port, 50 * MS)
    assert pty_port.filenos() == []
    for start in (100, 1000):
        fd = opened(pty_port.path)
        os.write(fd, b"V\rO\r")
        turn(pty_port, start * MS)
        turn(pty_port, (start + 200) * MS)
        assert os.read(fd, 65_536).startswith(b"V1013\r\rt1")
        assert pty_port.filenos() != []
        os.close(fd)
        turn(pty_port, (start + 300) * MS)
        assert pty_port.filenos() == []


def test_pty_host_that_does_not_read_never_blocks_the_rig(pty_port: PtyPort) -> None:
    fd = opened(pty_port.path)
    os.write(fd, b"O\r")
    for step in range(1, 900):
        turn(pty_port, step * 100 * MS)
    assert pty_port._link is not None
    assert pty_port._link.queue.dropped > 0
    os.close(fd)
