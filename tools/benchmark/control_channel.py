"""Lateness of the control steps with many clients on the control channel, beside the same without any.

    python -m tools.benchmark.control_channel [--seconds S] [--pairs N]
        [--realtime [--own-processor [--awake]] | --apart [--ordinary-clients]]

Pairs of runs in real time on the emulator over slcan, in turns. The clients are a process of their own: 100 connect, of
which as many as are served subscribe to states at 20 Hz; one never reads, one sends 10 MB without an end of line again
and again, one sends requests without pause.

--own-processor : the control thread has the last processor for itself, all other programs of the benchmark the rest, as
with `isolcpus` and `hil run --realtime --cpu N`. With --awake a program of the class SCHED_IDLE, which gives way to all
others, keeps that processor from halting, as `idle=poll` does.

--apart : on a computer that is busy with other programs. All programs of the benchmark, the process that serves the
clients and the clients among them, get SCHED_RR 1: others hardly count, and none of these stands back for the control
thread, which has to wait for what runs on its processor. Needs CAP_SYS_NICE. With --ordinary-clients the clients' own
processor time does not count: what is left is what the control channel does.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from tools.benchmark import ROOT

BIN = Path(sys.executable).parent
CLIENTS = 100
BURST = b"x" * 10_000_000
SUBSCRIBE = b'{"do": "subscribe", "rate_hz": 20}\n'
NOTABLE_MS = 0.1
FLOOD = b'{"do": "note", "text": "x"}\n' * 50


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser("python -m tools.benchmark.control_channel")
    parser.add_argument("--seconds", type=float, default=20.0, help="of a run (default: 20)")
    parser.add_argument("--pairs", type=int, default=3, help="of runs, without and with clients (default: 3)")
    parser.add_argument("--realtime", action="store_true", help="runs with SCHED_FIFO, as `hil run --realtime`")
    parser.add_argument("--own-processor", action="store_true", help="with --realtime: nothing else on its processor")
    parser.add_argument("--awake", action="store_true", help="with --own-processor: it never halts")
    parser.add_argument(
        "--apart", action="store_true", help="all programs of the benchmark before all others (SCHED_RR)"
    )
    parser.add_argument("--ordinary-clients", action="store_true", help="with --apart: but the clients")
    parser.add_argument("--clients-of", metavar="SOCKET", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.clients_of:
        if options.ordinary_clients:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        be_clients(options.clients_of, options.seconds)
        return 0
    if options.apart:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    realtime = ["--realtime"] if options.realtime else []
    if options.own_processor:
        *others, own = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, others)
        realtime += ["--cpu", f"{own}"]
        if options.awake:
            keep_awake(own)
    clients = ["--ordinary-clients"] if options.ordinary_clients else []
    late = {False: np.empty(0), True: np.empty(0)}
    skipped = {False: 0, True: 0}
    for number in range(2 * options.pairs):
        with_clients = number % 2 == 1
        lateness_ms, count = one_run(options.seconds, with_clients, realtime, options.apart, clients)
        late[with_clients] = np.append(late[with_clients], lateness_ms)
        skipped[with_clients] += count
    for with_clients, name in ((False, "no client"), (True, f"{CLIENTS} clients")):
        p50, p99, top = np.percentile(late[with_clients], (50, 99, 100))
        above = int((late[with_clients] > NOTABLE_MS).sum())
        print(
            f"{name:12} {late[with_clients].size} steps: lateness p50 {p50:.3f}, p99 {p99:.3f}, largest {top:.3f} ms; "
            f"{above} more than {NOTABLE_MS:g} ms late, {skipped[with_clients]} skipped"
        )
    ratio = float(np.percentile(late[True], 99) / np.percentile(late[False], 99))
    print(f"p99 with clients over without: {ratio:.3f}")
    return 0


def one_run(
    seconds: float, with_clients: bool, realtime: list[str], apart: bool, more: list[str]
) -> tuple[np.ndarray, int]:
    """Lateness of each step, ms, and the steps skipped."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "run"
        emulator = subprocess.Popen(
            [BIN / "firmware-sim", "--slcan", "0", "--seed", "1"], stdout=subprocess.PIPE, text=True, cwd=ROOT
        )
        channel = emulator.stdout.readline().split()[-1] if emulator.stdout is not None else ""
        run = clients = None
        try:
            if with_clients:  # before the run, so that what its libraries take to load is no load of clients
                path = f"{folder / 'control.sock'}"
                me = [sys.executable, "-m", "tools.benchmark.control_channel", "--clients-of", path]
                clients = subprocess.Popen([*me, "--seconds", f"{seconds + 60.0}", *more], cwd=ROOT)
                time.sleep(2.0)
            command: list[str | Path] = [BIN / "hil", "run", "hold", "-i", "slcan", "-c", channel, "--out", folder]
            options = ["--duration", f"{seconds}", "--no-rerun", "--no-report", *realtime]
            run = subprocess.Popen([*command, *options], stdout=subprocess.DEVNULL, cwd=ROOT)
            while run.poll() is None and not (folder / "control.sock").exists():
                time.sleep(0.05)
            if apart:
                keep_apart(run.pid)
            run.wait(seconds + 60.0)
        finally:
            for process in (clients, run, emulator):
                if process is not None:
                    process.kill()
                    process.wait()
        lines = (folder / "ticks.csv").read_text().splitlines()
        header = lines[0].split(",")
        late, skipped = header.index("lateness_s"), header.index("skipped")
        rows = [line.split(",") for line in lines[1:]]
        return np.array([float(row[late]) * 1e3 for row in rows]), int(float(rows[-1][skipped]))


def keep_awake(processor: int) -> None:
    """Begin a program that keeps this processor busy and gives way to every other one, until this one ends."""
    parent = os.getpid()
    if os.fork() == 0:
        os.sched_setaffinity(0, {processor})
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        while os.getppid() == parent:
            pass
        os._exit(0)


def keep_apart(run: int) -> None:
    """The process that serves the clients of this run does not stand back."""
    time.sleep(0.5)
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == run and b"hil.edge.control.server" in (folder / "cmdline").read_bytes():
                os.sched_setscheduler(int(folder.name), os.SCHED_RR, os.sched_param(1))


def be_clients(path: str, seconds: float) -> None:
    """All the clients, in one thread."""
    end_s = time.monotonic() + seconds
    while not Path(path).exists():
        time.sleep(0.02)
    time.sleep(0.1)
    readers: list[socket.socket] = []
    for _ in range(CLIENTS - 3):
        readers += connected(path, SUBSCRIBE)
    silent = connected(path, SUBSCRIBE)
    bulky, flooding = connected(path), connected(path)
    while time.monotonic() < end_s:
        for reader in readers:
            with suppress(OSError):
                while reader.recv(65536):
                    pass
        for sockets, data in ((bulky, BURST), (flooding, FLOOD)):
            for one in sockets:
                with suppress(BlockingIOError):
                    try:
                        one.send(data)
                    except (BrokenPipeError, ConnectionError):
                        sockets[:] = connected(path)
                        break
            if not sockets:
                sockets[:] = connected(path)
        time.sleep(0.02)
    del silent


def connected(path: str, data: bytes = b"") -> list[socket.socket]:
    """A connection, if one is to be had."""
    one = socket.socket(socket.AF_UNIX)
    try:
        one.setblocking(False)
        one.connect(path)
        if data:
            one.send(data)
    except OSError:
        one.close()
        return []
    return [one]


if __name__ == "__main__":
    sys.exit(main())
