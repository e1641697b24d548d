"""A control channel with its process, and a control thread that does what the test says."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from hil.cli.ctl_command import CtlOptions, run
from hil.core import controller
from hil.core.controller import ControllerState, Output
from hil.core.types import Event, NodeState
from hil.edge.control.client import ControlClient
from hil.edge.control.control_channel import ControlChannel
from hil.edge.control.socket_path import RunningRun, ServerSettings
from tests.core.core_bench import PERIOD_S, SECOND, Plant, bench_loop, controller_config, inputs, volts

CONFIG = controller_config(bench_loop())


class Bench:
    """Steps of a run in process, with its channel's process beside it."""

    def __init__(self, channel: ControlChannel, path: Path) -> None:
        self.channel, self.path = channel, path
        self.plant, self.state, self.number = Plant(), ControllerState(), 0
        self.events: list[Event] = []
        self.output: Output | None = None

    def step(self, steps: int = 1) -> None:
        for _ in range(steps):
            applied = self.state.supervision.command_V
            node = NodeState.RUN if applied != (0.0, 0.0) else NodeState.READY
            seen, now_ns = inputs(volts(self.plant.level_cm), applied, node), round(self.number * PERIOD_S * SECOND)
            asked = self.channel.requests()
            self.state, self.output = controller.step(CONFIG, self.state, seen, now_ns, asked)
            self.events += [*self.output.events, *self.channel.show(seen, self.output, self.state, now_ns)]
            self.number += 1

    def restart(self) -> None:
        """A new run behind the same socket, after a stop."""
        self.state = ControllerState()
        self.step(4)

    def codes(self) -> list[str]:
        return [event.code for event in self.events if event.code != "mode"]

    def connect(self) -> ControlClient:
        return ControlClient.connect(self.path)

    def raw(self) -> socket.socket:
        """A connection of which the greeting has been read."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(5.0)
        connection.connect(os.fspath(self.path))
        assert b'"hello"' in connection.recv(4096)
        return connection


def answer(bench: Bench, client: ControlClient, do: str, **keys: object) -> dict[str, object]:
    """Ask, step until the answer is there."""
    request_id = client.send(do, **keys)
    for _ in range(200):
        bench.step()
        for message in client.messages(0.02):
            if message.get("id") == request_id:
                return message
    raise AssertionError(f"no answer to {do}")


def ctl(action: str, *values: str, folder: Path | None = None) -> int:
    """`hil ctl`: its exit code."""
    return run(CtlOptions(action, values, False, False, 0.0, False, folder, None))


@contextmanager
def control_bench(folder: Path, pid: int | None = None, period_s: float = 0.0) -> Iterator[Bench]:
    """pid : a living process that the run says it is; None: this one. period_s : of the steps, if they have one."""
    path = folder / "control.sock"
    with ControlChannel() as channel:
        channel.open(replace(settings(path, pid), period_s=period_s), CONFIG)
        bench = Bench(channel, path)
        bench.step(4)
        yield bench


def settings(path: Path, pid: int | None = None) -> ServerSettings:
    run = RunningRun(pid or os.getpid(), str(path.parent), str(path), "toy", "2026-01-01T00:00:00+00:00")
    return ServerSettings(path, run, {"folder": str(path.parent), "scenario": "toy"})
