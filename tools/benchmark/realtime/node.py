"""The emulated rig as a node that answers each command, shortly before the controller's next step is due.

Its own time goes on by one level period for each command, so that every step has fresh levels, at any control period.
It stands for hardware and so goes before the controller.
"""

from __future__ import annotations

import os
import select
import socket
import sys
import time
from collections.abc import Iterable
from typing import Protocol

import can

from firmware_sim import settings
from firmware_sim.links import SlcanLink, listen
from firmware_sim.rig import Rig
from tools.benchmark import ROOT

LEVEL_PERIOD_NS = 20_000_000
LEAD_NS = 500_000
"""The answer is sent so long before the next step. Steps are at whole multiples of the period on the same clock."""

FIRST_PATIENCE_S, PATIENCE_S = 60.0, 1.0


class Line(Protocol):
    """The node's side of the bus."""

    def receive(self, timeout_s: float) -> can.Message | None:
        """The next frame, or None."""
        ...

    def send(self, frames: Iterable[can.Message]) -> None:
        """Send them now."""
        ...


class VirtualLine:
    """A virtual bus of this process."""

    def __init__(self, channel: str) -> None:
        self._bus = can.Bus(channel, "virtual", ignore_config=True)

    def receive(self, timeout_s: float) -> can.Message | None:
        """See `Line`."""
        return self._bus.recv(timeout_s)

    def send(self, frames: Iterable[can.Message]) -> None:
        """See `Line`."""
        for frame in frames:
            self._bus.send(frame)


class SlcanLine:
    """The emulator's slcan adapter on a TCP port; waits for its host."""

    def __init__(self) -> None:
        with listen(0) as listener:
            print(f"socket://127.0.0.1:{listener.getsockname()[1]}", flush=True)
            listener.setblocking(True)
            self._client, _ = listener.accept()
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._link = SlcanLink(self._client.fileno())
        self._frames: list[can.Message] = []

    def receive(self, timeout_s: float) -> can.Message | None:
        """See `Line`."""
        end_s = time.monotonic() + timeout_s
        while not self._frames and (remaining_s := end_s - time.monotonic()) > 0.0:
            select.select([self._client], [], [], remaining_s)
            frames = self._link.read()
            if frames is None:
                return None
            self._frames += frames
            self._link.flush()
        return self._frames.pop(0) if self._frames else None

    def send(self, frames: Iterable[can.Message]) -> None:
        """See `Line`."""
        for frame in frames:
            self._link.send(frame)
        self._link.flush()


def serve(line: Line, period_s: float, priority: int) -> None:
    """Answer and wait in turns, until no frame has arrived for a second; the first command may take longer."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    truth, faults = settings.load(ROOT / "config/emulator.toml", None)
    rig = Rig(truth, faults, 1, settings.load_fingerprint(ROOT / "config/bench.dbc"))
    rig_ns, period_ns = 0, round(period_s * 1e9)
    patience_s = FIRST_PATIENCE_S
    while (command := line.receive(patience_s)) is not None:
        next_step_ns = (time.monotonic_ns() // period_ns + 1) * period_ns
        patience_s = PATIENCE_S
        rig.receive(command, rig_ns)
        rig_ns += LEVEL_PERIOD_NS
        frames = rig.advance(rig_ns)
        time.sleep(max(next_step_ns - LEAD_NS - time.monotonic_ns(), 0) * 1e-9)
        line.send(frames)


if __name__ == "__main__":
    serve(SlcanLine(), float(sys.argv[1]), int(sys.argv[2]))
