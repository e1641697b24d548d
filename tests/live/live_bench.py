"""Two processes in real time, the emulator and the controller: forked from a warm server, or as console scripts."""

import json
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import can

from firmware_sim.links import listen
from firmware_sim.slcan_port import SlcanPort
from tests import fork_server
from tests.fork_server import ForkedProgram
from tests.waiting import wait_for

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
BIN = Path(sys.executable).parent
WATCHDOG_S = 0.25
PERIOD_S = 0.1
LEVELS_AGE_MAX_S = 0.3
HEARTBEAT_AGE_MAX_S = 0.25

signal.signal(signal.SIGINT, signal.default_int_handler)  # started in a shell's background we would hand on none

SCENARIO = """
[scenario]
name = "live"
duration_s = {duration}

[[reference]]
at_s = 2.0
change_V = [0.2, 0.1]

[[fault]]
at_s = 4.0
kind = "pump_effectiveness"
target = 1
value = 0.7

[diagnosis]
method = "ideal"

[[window]]
name = "after_the_step"
from_s = 2.0
to_s = 6.0

[rig]
safety.arm_timeout_s = {arm_timeout}
"""


def write_scenario(folder: Path, *, duration: float = 60.0, arm_timeout: float = 5.0) -> Path:
    path = folder / "live.toml"
    path.write_text(SCENARIO.format(duration=duration, arm_timeout=arm_timeout))
    return path


Program = ForkedProgram | subprocess.Popen[str]


class Emulator:
    """A running firmware-sim, where it is reached, and what its nodes have recorded."""

    def __init__(self, process: Program, channel: str, record: Path) -> None:
        self.process, self.channel, self._record = process, channel, record

    def changes(self) -> list[dict[str, Any]]:
        lines = self._record.read_text().split("\n")[:-1]
        return [json.loads(line) for line in lines]

    def pump(self) -> list[dict[str, Any]]:
        return [change for change in self.changes() if change["node"] == "pump"]

    def commanded(self) -> list[dict[str, Any]]:
        return [change for change in self.pump() if change["cause"] == "command"]

    def has_ever_applied(self) -> bool:
        return any(change["applied_V"] != [0.0, 0.0] for change in self.pump())

    def wait_until_it_runs(self, changes: int = 5) -> None:
        wait_for(lambda: len(self.commanded()) >= changes, timeout_s=40.0)  # a busy machine starts slowly


def start(command: Sequence[Path | str | int], *, is_forked: bool = True) -> Program:
    """A program of ours, its outputs on pipes. is_forked : by the fork server; otherwise it is the console script."""
    if is_forked:
        return ForkedProgram(command)
    name, *arguments = command
    return subprocess.Popen(
        [BIN / str(name), *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@contextmanager
def emulator(
    record: Path,
    *arguments: str | Path,
    scenario: Path | None = None,
    transport: tuple[str, ...] = ("--slcan", "0"),
    is_forked: bool = True,
) -> Iterator[Emulator]:
    scenario_data = () if scenario is None else ("--scenario", scenario)
    command = ["firmware-sim", *transport, "--seed", "1", "--record", record, *scenario_data, *arguments]
    process = start(command, is_forked=is_forked)
    try:
        assert process.stdout is not None
        readable, _, _ = select.select([process.stdout], [], [], 20.0)
        assert readable, "the emulator does not come up"
        line = process.stdout.readline()
        assert process.stderr is not None
        assert line.startswith("firmware-sim ready: slcan on "), process.stderr.read()
        yield Emulator(process, line.split()[-1], record)
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.communicate()


@contextmanager
def lone_adapter() -> Iterator[tuple[str, list[can.Message]]]:
    """An slcan adapter on a bus where nobody else speaks: its address, and the frames that it was given to send."""
    listener = listen(0)
    listener.setblocking(True)
    sent = []

    def serve() -> None:
        with suppress(OSError):
            client, _ = listener.accept()
            adapter = SlcanPort()
            with client:
                while data := client.recv(4096):
                    reply, frames = adapter.feed(data)
                    sent.extend(frames)
                    client.sendall(reply)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}", sent
    finally:
        listener.close()


class Controller:
    """A running `hil run`, and the folder that it writes."""

    def __init__(self, process: Program, folder: Path) -> None:
        self.process, self.folder = process, folder
        self.out = self.err = ""

    def wait(self, timeout_s: float = 30.0) -> int | None:
        """Exit code; the outputs are kept. No way of ending may show a traceback."""
        self.out, self.err = self.process.communicate(timeout=timeout_s)
        assert "Traceback" not in self.err, self.err
        return self.process.returncode

    def json(self, name: str) -> Any:
        return json.loads((self.folder / name).read_text())


@contextmanager
def controller(
    scenario: Path, channel: str, folder: Path, *options: str | int, is_forked: bool = True
) -> Iterator[Controller]:
    command = ["hil", "run", scenario, "-i", "slcan", "-c", channel, "--out", folder, *options]
    process = start(command, is_forked=is_forked)
    try:
        yield Controller(process, folder)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.communicate()


def child(run: Controller, module: str) -> int:
    """Process number of the run's recorder ("recorder_process") or of the server of its control channel ("server")."""
    pid = run.process.pid
    for number in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        if module.encode() in Path(f"/proc/{number}/cmdline").read_bytes():
            return int(number)
    raise AssertionError(f"the run has no process {module}")


PLAIN = ("--no-rerun", "--no-report")


def hil(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return fork_server.run(["hil", *arguments])


def sent_s(folder: Path) -> list[float]:
    """Times of the commands in sent.log, s; every line there and in can.log has to be one of candump's."""
    frames = _frames(folder / "can.log")
    sent = _frames(folder / "sent.log")
    assert {frame_id for _, frame_id in sent} <= {"201"}
    assert set(sent) <= set(frames), "can.log has them all"
    return [stamp_s for stamp_s, _ in sent]


def _frames(log: Path) -> list[tuple[float, str]]:
    """Time in s and identifier of each line."""
    frames = []
    for line in log.read_text().split("\n")[:-1]:
        stamp, channel, content = line.split()
        frame_id, _, payload = content.partition("#")
        assert channel == "can0"
        assert len(bytes.fromhex(payload)) <= 8
        frames.append((float(stamp.strip("()")), frame_id))
    return frames


def row(text: str, check: str) -> str:
    """The line of a printed table that has this check."""
    return next(line for line in text.splitlines() if check in line)
