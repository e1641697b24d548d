"""Endurance test of emulator and controller over slcan at 100 Hz: `python -m tools.soak [--minutes M] [--realtime]`.

Watches both processes from outside (/proc), counts the frames on the line between them with a relay, and compares that
with the counts of both sides. Exit code 1 if memory grew, the number of threads changed, or a frame is missing that
neither side counted.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.edge.host.realtime import DEFAULT_PRIORITY

BIN = Path(sys.executable).parent
SCENARIO = Path(__file__).with_suffix(".toml")
SAMPLE_S = 1.0
WARM_UP_SHARE, WARM_UP_MAX_S = 0.25, 120.0
GROWTH_MAX = 0.02
PATIENCE_S = 60.0
IN_FLIGHT = 6
"""Frames that may be in transit when the last command is sent: one of each identifier."""


@dataclass
class Watched:
    """Observations of one process: resident memory in kB and number of threads at each sample, and its time."""

    name: str
    pid: int
    times_s: list[float] = field(default_factory=list)
    memory_kB: list[float] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)

    def sample(self, t_s: float) -> None:
        """Take a sample; a process that has ended gives none."""
        with suppress(OSError, KeyError):
            text = Path(f"/proc/{self.pid}/status").read_text(encoding="ascii", errors="replace")
            status = dict(line.split(":", 1) for line in text.splitlines() if ":" in line)
            memory_kB, threads = float(status["VmRSS"].split()[0]), int(status["Threads"])
            self.times_s.append(t_s)
            self.memory_kB.append(memory_kB)
            self.threads.append(threads)

    def steady(self, from_s: float, to_s: float) -> tuple[list[float], set[int]]:
        """Memory and numbers of threads between two times."""
        kept = [i for i, t_s in enumerate(self.times_s) if from_s <= t_s <= to_s]
        return [self.memory_kB[i] for i in kept], {self.threads[i] for i in kept}


class Relay:
    """A TCP line between both that counts the slcan lines which carry frames, each way. Forwards at once."""

    def __init__(self, emulator_port: int) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.channel = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._emulator_port = emulator_port
        self._ends: tuple[socket.socket, socket.socket] | None = None
        self._rest = [b"", b""]
        self.frames = [0, 0]  # from the controller, from the emulator
        self.frames_at_last_command = 0  # from the emulator; the controller does not read later ones

    def serve(self, until_s: float) -> None:
        """Forward until that time."""
        while (remaining_s := until_s - time.monotonic()) > 0.0:
            if self._ends is None:
                self._admit(remaining_s)
                continue
            for one in select.select(self._ends, [], [], remaining_s)[0]:
                if not self._forward(self._ends.index(one)):
                    self._hang_up()
                    break

    def close(self) -> None:
        """Close all connections."""
        self._hang_up()
        self._listener.close()

    def _admit(self, timeout_s: float) -> None:
        if select.select([self._listener], [], [], timeout_s)[0]:
            controller, _ = self._listener.accept()
            emulator = socket.create_connection(("127.0.0.1", self._emulator_port))
            for one in (controller, emulator):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._ends = (controller, emulator)

    def _forward(self, which: int) -> bool:
        assert self._ends is not None  # noqa: S101 - for the type checker
        try:
            data = self._ends[which].recv(65536)
            if data:
                self._ends[1 - which].sendall(data)
        except OSError:
            return False
        *lines, self._rest[which] = (self._rest[which] + data).split(b"\r")
        count = sum(line.lstrip(b"\a")[:1] == b"t" for line in lines)
        self.frames[which] += count
        if which == 0 and count:
            self.frames_at_last_command = self.frames[1]
        return bool(data)

    def _hang_up(self) -> None:
        for one in self._ends or ():
            one.close()
        self._ends = None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        "python -m tools.soak", description="Endurance test: the bench at 100 Hz over slcan."
    )
    parser.add_argument("--minutes", type=float, default=3.0, help="how long (default: 3; 30 is thorough)")
    parser.add_argument("--realtime", action="store_true", help="run the controller with --realtime")
    parser.add_argument("--keep", metavar="DIR", type=Path, help="keep the run folder there")
    options = parser.parse_args(arguments)
    if not 0.2 <= options.minutes <= 1440.0:
        parser.error(f"--minutes {options.minutes:g} is outside 0.2..1440")
    with tempfile.TemporaryDirectory() as folder:
        return soak(60.0 * options.minutes, options.realtime, options.keep or Path(folder) / "run", Path(folder))


def soak(seconds: float, realtime: bool, run: Path, folder: Path) -> int:
    """One run; 0 if all checks pass."""
    emulator = subprocess.Popen(
        [BIN / "firmware-sim", "--slcan", "0", "--record", folder / "node.jsonl"],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    relay = controller = None
    try:
        ready = emulator.stdout.readline() if emulator.stdout else ""
        relay = Relay(int(ready.rsplit(":", 1)[1]))
        line = ("-i", "slcan", "-c", relay.channel)
        more = ("--duration", str(seconds), *(("--realtime",) if realtime else ()))
        command = [str(BIN / "hil"), "run", str(SCENARIO), *line, "--out", str(run), "--no-report", *more]
        controller = subprocess.Popen(command)
        if realtime:
            _raise_priority(emulator.pid, 0)
        watched = [Watched("emulator", emulator.pid), Watched("controller", controller.pid)]
        started_s = time.monotonic()
        while controller.poll() is None and time.monotonic() - started_s < seconds + PATIENCE_S:
            relay.serve(time.monotonic() + SAMPLE_S)
            _sample(watched, controller.pid, time.monotonic() - started_s)
        return report(Console(width=110), seconds, run, watched, relay, controller.poll())
    finally:
        for process in (controller, emulator):
            if process is not None:
                process.kill()
                process.wait()
        if relay is not None:
            relay.close()


def report(console: Console, seconds: float, run: Path, watched: list[Watched], relay: Relay, code: int | None) -> int:
    """Print the results; 0 if all checks pass."""
    warm_s = min(WARM_UP_SHARE * seconds, WARM_UP_MAX_S)
    verdicts = [_processes(console, watched, warm_s, seconds)]
    kpi = json.loads((run / "kpi.json").read_text()) if code is not None and (run / "kpi.json").exists() else {}
    if not kpi:
        console.print(f"the controller ended with {code} and left no key figures")
        return 1
    received, sent = _logged(run)
    counted = kpi["commands"]
    missing = max(relay.frames_at_last_command - received, 0)
    on_time = {name: f"{1e3 * value:.3f} ms" for name, value in kpi["lateness_s"].items()}
    rows = {
        "the run": f"{kpi['status']} ({kpi['reason']}), exit code {code}",
        "steps, skipped": f"{kpi['ticks']}, {kpi['skipped']}",
        "lateness": ", ".join(f"{name} {value}" for name, value in on_time.items()),
        "frames to the controller: on the line, in its record": f"{relay.frames_at_last_command}, {received}",
        "missing, and counted by their counters": f"{missing}, {counted['frames_lost']}",
        "commands: on the line, in the record": f"{relay.frames[0]}, {sent}",
        "commands that the node did not accept": str(counted["commands_lost"]),
        "refused by the controller": str(kpi["rejected"]),
        "the record: dropped, longest queue, errors": (
            f"{kpi['recorder']['dropped']}, {kpi['recorder_queue_max']:.0f}, {kpi['recorder']['errors']}"
        ),
        "alarms": str(len(kpi["alarms"])),
    }
    table = Table(show_header=False)
    for name, value in rows.items():
        table.add_row(name, value)
    console.print(table)
    verdicts += [
        _check(console, code == 0, "the run completed"),
        _check(console, missing <= counted["frames_lost"] + IN_FLIGHT, "no frame is missing that was not counted"),
        _check(console, relay.frames[0] == sent, "every command of the record was on the line"),
        _check(console, kpi["recorder"]["dropped"] == 0, "the record has no gaps"),
    ]
    return 0 if all(verdicts) else 1


def _processes(console: Console, watched: list[Watched], warm_s: float, until_s: float) -> bool:
    table = Table(title=f"After {warm_s:.0f} s of warming up", title_justify="left")
    for column in ("process", "memory, start", "end", "largest", "growth", "threads"):
        table.add_column(column)
    verdicts = []
    for one in watched:
        memory_kB, threads = one.steady(warm_s, until_s)
        tenth = max(1, len(memory_kB) // 10)
        if not memory_kB:
            verdicts.append(_check(console, False, f"{one.name}: could be observed"))
            continue
        first, last = float(np.mean(memory_kB[:tenth])), float(np.mean(memory_kB[-tenth:]))
        growth = last / first - 1.0
        megabytes = (f"{kB / 1024:.1f} MB" for kB in (first, last, max(memory_kB)))
        table.add_row(one.name, *megabytes, f"{100 * growth:+.2f} %", ", ".join(map(str, sorted(threads))))
        verdicts.append(_check(console, abs(growth) <= GROWTH_MAX, f"{one.name}: memory flat within 2 %"))
        verdicts.append(_check(console, len(threads) == 1, f"{one.name}: threads constant"))
    console.print(table)
    return all(verdicts)


def _raise_priority(*processes: int) -> None:
    """Emulator and line replace hardware, which no process delays: run them before the controller."""
    for pid in processes:
        with suppress(PermissionError):
            os.sched_setscheduler(pid, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(DEFAULT_PRIORITY + 1))


def _sample(watched: list[Watched], controller: int, t_s: float) -> None:
    """Sample each process; the controller's recorder is added when it has started."""
    if len(watched) == 2:
        with suppress(OSError):
            children = Path(f"/proc/{controller}/task/{controller}/children").read_text().split()
            watched += [Watched("recorder", int(child)) for child in children[:1]]
    for one in watched:
        one.sample(t_s)


def _logged(run: Path) -> tuple[int, int]:
    """Frames received and sent in the controller's record: all are in can.log, those sent also in sent.log."""
    everything, sent = (sum(1 for _ in (run / name).open("rb")) for name in ("can.log", "sent.log"))
    return everything - sent, sent


def _check(console: Console, is_so: bool, what: str) -> bool:
    console.print(f"{'pass' if is_so else 'FAIL'}  {what}", highlight=False)
    return is_so


if __name__ == "__main__":
    sys.exit(main())
