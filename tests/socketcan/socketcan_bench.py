"""`hil run` and `firmware-sim` as processes of their own: forks, so that what they import is imported once.

In the guest that takes its time, and its clock runs on while a file is fetched from the host: nothing that is timed may
read one for the first time.
"""

import json
import multiprocessing
import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import firmware_sim.change_record
import firmware_sim.cli
import firmware_sim.command_server
import firmware_sim.kernel_port
import firmware_sim.rig
import firmware_sim.serve
import firmware_sim.settings
import hil.cli.app
import hil.edge.can.socketcan
from hil.bench import (
    assembly,  # noqa: F401 - imported before the forks
    live_run,  # noqa: F401 - imported before the forks
)
from hil.cli import run_display  # noqa: F401 - imported before the forks
from tests.narrowing import not_none
from tests.waiting import wait_for

PERIOD_S = 0.1
WATCHDOG_S = 0.25
START_S = 300.0
OFF = [0.0, 0.0]
SCENARIO = """
[scenario]
name = "kernel"
duration_s = {duration}
[diagnosis]
method = "none"
[rig]
safety.arm_timeout_s = 10.0
start.phase = "never"
"""

_fork = multiprocessing.get_context("fork")


def _become(main: Callable[[], None], arguments: Sequence[object], output: Path) -> None:
    """In the fork: a console script, at a priority at which the tests themselves don't hold it up."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    with Path(os.devnull).open() as nothing, output.open("w", buffering=1) as sink:
        os.dup2(nothing.fileno(), 0)
        os.dup2(sink.fileno(), 1)
        os.dup2(sink.fileno(), 2)
        sys.stdout = sys.stderr = sink
        sys.stdin = nothing
        sys.argv = [str(one) for one in arguments]
        main()


class Forked:
    """A process, and what it has printed."""

    def __init__(self, main: Callable[[], None], arguments: Sequence[object], output: Path) -> None:
        self._output = output
        self._process = _fork.Process(target=_become, args=(main, arguments, output), daemon=True)
        self._process.start()
        self.pid = self._process.pid

    @property
    def out(self) -> str:
        return self._output.read_text() if self._output.exists() else ""

    @property
    def is_alive(self) -> bool:
        return self._process.exitcode is None

    def signal(self, number: signal.Signals) -> None:
        os.kill(not_none(self.pid), number)

    def wait(self, timeout_s: float = 20.0) -> int:
        """Exit code. No way of ending may show a traceback."""
        self._process.join(timeout_s)
        assert self._process.exitcode is not None, ("does not end", self.out)
        assert "Traceback" not in self.out, self.out
        return self._process.exitcode

    def end(self) -> None:
        if self._process.exitcode is None:
            self.signal(signal.SIGCONT)
            self._process.kill()
            self._process.join()


class Rig:
    """A running firmware-sim and what its pump node has recorded."""

    def __init__(self, process: Forked, record: Path, control: Path) -> None:
        self.process, self._control = process, control
        self._lines = record.open()
        self._changes: list[dict[str, Any]] = []

    def pump(self) -> list[dict[str, Any]]:
        self._changes += [
            change for line in self._lines if (change := json.loads(line))["node"] == "pump" and line.endswith("\n")
        ]
        return self._changes

    def fail(self, words: str) -> None:
        """A failure by command, in the emulator's words."""
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(self._control))
            client.sendall(f"failure {words}\n".encode())
            answer = client.recv(4096).decode()
        assert answer.startswith("ok"), answer

    def wait_until_it_runs(self, since: int, changes: int = 5) -> None:
        """Until the pump node has obeyed some commands of a run that began when it had `since` changes."""
        wait_for(lambda: sum(one["cause"] == "command" for one in self.pump()[since:]) >= changes, START_S, 0.03)

    def wait_until_safe(self, since: int) -> tuple[str, float]:
        """The trip of the pump node at 0 V, and how long after the last command it obeyed."""
        is_safe = lambda: self.pump()[-1]["applied_V"] == OFF and self.pump()[-1]["state"] == "tripped"  # noqa: E731
        wait_for(is_safe, 3.0, 0.03)
        commands = [one for one in self.pump()[since:] if one["cause"] == "command"]
        trip = next(
            one for one in self.pump()[since:] if one["state"] == "tripped" and one["t_s"] > commands[-1]["t_s"]
        )
        assert trip["applied_V"] == OFF
        return trip["cause"], trip["t_s"] - commands[-1]["t_s"]


class Run:
    """A running `hil run` and its folder."""

    def __init__(self, process: Forked, folder: Path) -> None:
        self.process, self.folder = process, folder
        self.since = 0
        """How many changes the pump node had recorded before."""

    def wait(self, timeout_s: float = 20.0) -> int:
        return self.process.wait(timeout_s)

    @property
    def out(self) -> str:
        return self.process.out

    def json(self, name: str) -> Any:
        return json.loads((self.folder / name).read_text())

    def events(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.folder / "events.jsonl").read_text().splitlines()]

    @property
    def cause(self) -> str:
        (trip,) = self.json("kpi.json")["trips"]
        return str(trip["cause"])


@contextmanager
def emulator(channel: str, folder: Path, *options: str) -> Iterator[Rig]:
    record, control = folder / "node.jsonl", folder / "control"
    arguments = ["firmware-sim", "-i", "socketcan", "-c", channel, "--record", record, "--control", control, *options]
    process = Forked(firmware_sim.cli.main, arguments, folder / "rig.out")
    try:
        wait_for(lambda: "firmware-sim ready: socketcan" in process.out or not process.is_alive, START_S)
        assert process.is_alive, process.out
        yield Rig(process, record, control)
    finally:
        process.end()


@contextmanager
def controller(channel: str, folder: Path, *options: str, duration: float = 60.0, clear: bool = True) -> Iterator[Run]:
    scenario = folder / "scenario.toml"
    scenario.write_text(SCENARIO.format(duration=duration))
    out = folder / "run"
    more = [*options, *(["--clear-trip"] if clear else [])]
    arguments = ["hil", "run", scenario, "-i", "socketcan", "-c", channel, "--out", out, "--no-rerun", "--no-report"]
    process = Forked(hil.cli.app.main, [*arguments, *more], folder / "run.out")
    try:
        yield Run(process, out)
    finally:
        process.end()
