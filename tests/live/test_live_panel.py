"""`hil run --panel` in a terminal of its own: the panel may end in any way, and the run goes on; the run may not."""

from __future__ import annotations

import asyncio
import fcntl
import getpass
import json
import os
import pty
import select
import signal
import struct
import subprocess
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from hil.panel.emulator_client import EmulatorClient
from hil.panel.panel_app import PanelApp
from hil.panel.run_search import run_finder
from tests.live.live_bench import BIN, Emulator, emulator, write_scenario
from tests.waiting import wait_for
from tools.panel_pictures import Session, bench

pytestmark = [pytest.mark.live, pytest.mark.long]
CTRL_C = b"\x03"


def become_the_terminals_leader() -> None:
    """Of the new process: a session of its own, with standard input as its terminal."""
    os.setsid()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


class PanelTerminal:
    """A terminal with `hil run --panel` in it, and what it was sent."""

    def __init__(self, command: list[str]) -> None:
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        self.run = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, preexec_fn=become_the_terminals_leader
        )
        os.close(slave)
        self.written = b""
        self._is_open = True
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while self._is_open:
            with suppress(OSError):
                if select.select([self._master], [], [], 0.05)[0]:
                    self.written += os.read(self._master, 65536)

    def press(self, keys: bytes) -> None:
        os.write(self._master, keys)

    def close(self) -> None:
        """Close the terminal."""
        if self._is_open:
            self._is_open = False
            self._reader.join()
            os.close(self._master)

    @property
    def panel(self) -> int:
        """Process of the panel; 0 when there is none."""
        children = Path(f"/proc/{self.run.pid}/task/{self.run.pid}/children").read_text().split()
        return next((int(pid) for pid in children if is_panel(int(pid))), 0)


def is_panel(pid: int) -> bool:
    """Whether that process is a panel, and no zombie of one."""
    try:
        return b"\0panel\0" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


@contextmanager
def panel_beside_run(tmp_path: Path) -> Iterator[tuple[PanelTerminal, Emulator]]:
    with emulator(tmp_path / "changes.jsonl") as emulated:
        command = [BIN / "hil", "run", write_scenario(tmp_path), "-i", "slcan", "-c", emulated.channel]
        terminal = PanelTerminal([*map(str, command), "--out", str(tmp_path / "run"), "--no-rerun", "--panel"])
        panel = 0
        try:
            emulated.wait_until_it_runs()
            wait_for(lambda: b"RUNNING" in terminal.written, timeout_s=20.0)
            panel = terminal.panel
            yield terminal, emulated
        finally:
            terminal.close()
            terminal.run.kill()
            terminal.run.wait()
            if is_panel(panel):
                os.kill(panel, signal.SIGKILL)


def goes_on(emulated: Emulator) -> None:
    """The run still commands the pumps."""
    commands = len(emulated.commanded())
    wait_for(lambda: len(emulated.commanded()) > commands + 5, timeout_s=10.0)


def test_a_killed_panel_leaves_the_run_and_a_terminal_in_order(tmp_path: Path) -> None:
    with panel_beside_run(tmp_path) as (terminal, emulated):
        os.kill(terminal.panel, signal.SIGKILL)
        wait_for(lambda: b"the panel has ended, the run goes on" in terminal.written, timeout_s=10.0)
        goes_on(emulated)
        terminal.press(CTRL_C)
        assert terminal.run.wait(15.0) == 130
        assert emulated.pump()[-1]["applied_V"] == [0.0, 0.0]


def test_a_stopped_panel_and_a_closed_terminal_leave_the_run(tmp_path: Path) -> None:
    with panel_beside_run(tmp_path) as (terminal, emulated):
        os.kill(terminal.panel, signal.SIGSTOP)
        goes_on(emulated)
        terminal.close()
        goes_on(emulated)
        terminal.run.send_signal(signal.SIGTERM)
        assert terminal.run.wait(15.0) == 143
        assert emulated.pump()[-1]["applied_V"] == [0.0, 0.0]


def test_a_killed_run_ends_at_zero_volts_and_its_panel_ends(tmp_path: Path) -> None:
    with panel_beside_run(tmp_path) as (terminal, emulated):
        panel = terminal.panel
        terminal.run.kill()
        wait_for(lambda: emulated.pump()[-1]["state"] == "tripped", timeout_s=5.0)
        assert emulated.pump()[-1]["applied_V"] == [0.0, 0.0]
        wait_for(lambda: not is_panel(panel), timeout_s=10.0)


def test_the_stop_key_of_the_panel_ends_the_run(tmp_path: Path) -> None:
    with panel_beside_run(tmp_path) as (terminal, emulated):
        terminal.press(b"n")
        wait_for(lambda: b"at most 1000 characters" in terminal.written, timeout_s=10.0)
        terminal.press(b"a note\x18")  # Ctrl+X while the note is typed
        wait_for(lambda: b"RUN ENDED" in terminal.written, timeout_s=15.0)
        assert emulated.pump()[-1]["applied_V"] == [0.0, 0.0]
        terminal.press(b"q")
        assert terminal.run.wait(15.0) == 0
        wait_for(lambda: b"live: stopped (operator)" in terminal.written, timeout_s=5.0)


def test_a_session_through_the_panel_is_in_the_record_with_its_author(tmp_path: Path) -> None:
    """Reference with a ramp, hold, manual and back, a fault from the console, its alarm, bypass, note and stop."""

    async def session() -> None:
        with bench(tmp_path) as run:
            app = PanelApp(run_finder(run, None), emulator=EmulatorClient(str(tmp_path / "emulator")))
            async with app.run_test(size=(80, 24)) as pilot:
                hand = Session(pilot, app, tmp_path)
                await hand.wait_until(0.5)
                await hand.press("h", "r", '"13"', "enter", '""', "enter", '"2"', "enter", "y")
                await hand.press("m", '"3.2"', "enter", "enter", "y")
                await hand.wait(lambda panel: panel.view.state.mode == "MANUAL")
                await hand.press("a", "y")
                await hand.wait(lambda panel: panel.view.state.mode == "RUNNING")
                await hand.press("4", "enter", "enter", '"0.3"', "enter", "enter", "enter", "1")
                await hand.wait(lambda panel: bool(panel.view.state.alarms))
                await hand.press("k", "b", "enter", '"5"', "enter", "y")
                await hand.wait(lambda panel: bool(panel.view.state.bypassed))
                await hand.wait(lambda panel: not panel.view.state.bypassed)
                await hand.press("n", '"done"', "enter", "ctrl+x")
                await hand.wait(lambda panel: "stopped" in panel.view.ended)

    asyncio.run(session())
    lines = (tmp_path / "first-hour" / "events.jsonl").read_text().splitlines()
    asked = [event["data"] for event in map(json.loads, lines) if event["code"] == "operator"]
    done = ["hold", "reference", "manual", "auto", "ack", "bypass", "note", "stop"]
    assert [data["request"]["do"] for data in asked] == done
    assert {data["pid"] for data in asked} == {os.getpid()}
    assert {data["user"] for data in asked} == {getpass.getuser()}
