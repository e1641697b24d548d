"""Receive-to-send latency and processor time of our slcan bus beside python-can's: `python -m tools.benchmark.slcan`.

The far end of the line is a process of its own. What is compared takes turns, round by round, on one line after the
other.
"""

from __future__ import annotations

import multiprocessing
import os
import select
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from statistics import median
from typing import Any

import can
from can.interfaces.slcan import slcanBus
from rich.console import Console

from firmware_sim.links import listen, open_pty
from firmware_sim.slcan_port import Channel, SlcanPort
from hil.edge.can.slcan_bus import SlcanBus
from tools.benchmark.tables import Section, as_rich, as_time

FRAME = can.Message(arbitration_id=0x182, is_extended_id=False, data=bytes(range(7)))
COMMAND = can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(6))
FILTERS: Any = [{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in (0x201, 0x181, 0x182, 0x282)]
PACE_S = 0.002
FLOOD_FRAMES = 2000
BUSES: dict[str, Callable[[str], can.BusABC]] = {
    "ours": lambda channel: SlcanBus(channel, 500_000, FILTERS),
    "python-can": lambda channel: slcanBus(channel, bitrate=500_000, sleep_after_open=0, can_filters=FILTERS),
}


def far_end(pipe: Connection, is_pty: bool) -> None:
    """The other process: an adapter that executes the requests from the pipe, one host after the other."""
    if is_pty:
        master, where = open_pty()
        os.open(where, os.O_RDWR | os.O_NOCTTY)  # keeps the master open between two hosts
        pipe.send(where)
        while pipe.recv() != "end":
            _serve(pipe, master)
        return
    with listen(0) as listener:
        listener.setblocking(True)
        pipe.send(f"socket://127.0.0.1:{listener.getsockname()[1]}")
        while pipe.recv() != "end":
            client, _ = listener.accept()
            with client:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                _serve(pipe, client.fileno())


def _serve(pipe: Connection, fd: int) -> None:
    """Serve one host, from opening to closing."""
    _be_opened(fd)
    pipe.send("open")
    while (order := pipe.recv()) != "closed":
        pipe.send(_latencies_us(fd, order) if order > 0 else _flood(fd))
    _swallow(fd)
    pipe.send("swallowed")


def _be_opened(fd: int) -> None:
    adapter = SlcanPort()
    while adapter.channel is not Channel.OPEN or select.select([fd], [], [], 0.05)[0]:
        os.write(fd, adapter.feed(os.read(fd, 4096))[0])


def _latencies_us(fd: int, count: int) -> list[float]:
    """From the last byte of a frame to the last byte of the command that answers it."""
    line = _line(FRAME)
    times = []
    for _ in range(count):
        time.sleep(PACE_S)
        started = time.perf_counter()
        os.write(fd, line)
        heard = b""
        while not heard.endswith(b"\r"):
            heard += os.read(fd, 4096)
        times.append((time.perf_counter() - started) * 1e6)
        os.write(fd, b"z\r")
    return times


def _flood(fd: int) -> int:
    """Write as many frames as fit; return their number."""
    for _ in range(FLOOD_FRAMES // 20):
        left = _line(FRAME) * 20
        while left:
            left = left[os.write(fd, left) :]
    return FLOOD_FRAMES


def _swallow(fd: int) -> None:
    try:
        while select.select([fd], [], [], 0.05)[0] and os.read(fd, 4096):
            pass
    except OSError:
        return


def _line(frame: can.Message) -> bytes:
    adapter = SlcanPort()
    adapter.feed(b"O\r")
    return adapter.frame_line(frame)


@contextmanager
def _far(is_pty: bool) -> Iterator[tuple[str, Connection]]:
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=far_end, args=(theirs, is_pty), daemon=True)
    process.start()
    try:
        yield ours.recv(), ours
        ours.send("end")
        process.join(5.0)
    finally:
        process.kill()


def _round(name: str, channel: str, pipe: Connection, count: int) -> tuple[list[float], float, float]:
    """Latencies in µs; processor time in µs for a frame answered, and for one of a flood received."""
    pipe.send("be opened")
    with BUSES[name](channel) as bus:
        pipe.recv()
        while bus.recv(0.0) is not None:
            pass
        pipe.send(count)
        started = time.process_time()
        for _ in range(count):
            while bus.recv(0.1) is None:
                pass
            bus.send(COMMAND, timeout=0)
        answered_us = (time.process_time() - started) / count * 1e6
        latencies = pipe.recv()
        pipe.send(0)
        started = time.process_time()
        for _ in range(FLOOD_FRAMES):
            while bus.recv(0.1) is None:
                pass
        flood_us = (time.process_time() - started) / FLOOD_FRAMES * 1e6
        pipe.recv()
    pipe.send("closed")
    pipe.recv()
    return latencies, answered_us, flood_us


def slcan_latency(rounds: int, count: int) -> Section:
    """Both buses in turns, over TCP and over a pty."""
    rows = []
    for is_pty in (False, True):
        found: dict[str, list[tuple[list[float], float, float]]] = {name: [] for name in BUSES}
        with _far(is_pty) as (channel, pipe):
            for number in range(rounds + 1):  # the first round is for warm-up
                for name, results in found.items():
                    one = _round(name, channel, pipe, count)
                    if number:
                        results.append(one)
        for name, results in found.items():
            rows.append(("pty" if is_pty else "TCP", name, *_figures(results)))
        rows.append(("", "ratio", *_ratios(found["python-can"], found["ours"])))
    note = (
        f"{rounds} rounds of {count} frames, one each {PACE_S * 1e3:g} ms, answered as soon as received, and of "
        f"{FLOOD_FRAMES} at once. Latency as the far end sees it; processor time is our end's, for a frame answered "
        "and for one of the flood. Ratio: python-can's over ours, median of the rounds."
    )
    columns = ("line", "bus", "latency p50", "p99", "max", "CPU answered", "CPU received")
    return Section("slcan", note, columns, rows)


def _quantile(values: list[float], share: float) -> float:
    return sorted(values)[min(int(share * len(values)), len(values) - 1)]


def _figures(results: list[tuple[list[float], float, float]]) -> tuple[str, ...]:
    all_us = [value for latencies, _, _ in results for value in latencies]
    figures = (_quantile(all_us, 0.5), _quantile(all_us, 0.99), max(all_us))
    return tuple(map(as_time, (*figures, median(r[1] for r in results), median(r[2] for r in results))))


def _ratios(
    theirs: list[tuple[list[float], float, float]], ours: list[tuple[list[float], float, float]]
) -> tuple[str, ...]:
    def ratio(what: Callable[[tuple[list[float], float, float]], float]) -> str:
        return f"{median(what(a) / what(b) for a, b in zip(theirs, ours, strict=True)):.1f}"

    return (
        ratio(lambda one: _quantile(one[0], 0.5)),
        ratio(lambda one: _quantile(one[0], 0.99)),
        ratio(lambda one: max(one[0])),
        ratio(lambda one: one[1]),
        ratio(lambda one: one[2]),
    )


def main() -> int:
    """Print the table."""
    section = slcan_latency(rounds=7, count=500)
    Console(width=120).print(as_rich(section), section.note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
