"""The loops that are measured, as programs: `python -m tools.benchmark.realtime.loops OUT.npz {settings as JSON}`.

bare     the runtime and its clock, with a step that only notes when it began, on a line that stays silent
whole    the controller in control, on a bus with a node that answers each command (`node.py`)
"""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import can
import numpy as np

from hil import runtime
from hil.bench import assembly
from hil.bench.open_record import TimelineSettings, open_record
from hil.bench.run_options import timeline_of
from hil.bench.run_plan import run_plan
from hil.core.controller import ControllerConfig
from hil.core.types import Event, Quad, TickRecord, Timing
from hil.edge.can.bus import BusAddress, BusPort
from hil.edge.host import realtime
from hil.edge.host.clock import MonotonicClock
from hil.edge.host.realtime import RealTime
from hil.edge.record.process_recorder import ProcessRecorder
from hil.edge.record.run_folder import RunFolder
from hil.loop import Outcome
from hil.review import viewer
from tools.benchmark.realtime.node import VirtualLine, serve

SCENARIO = """
[scenario]
name = "answer"
duration_s = {seconds}
[diagnosis]
method = "none"
[rig]
control.period_s = {period_s}
safety.levels_age_max_s = 1.0
safety.status_age_max_s = 1.0
safety.heartbeat_age_max_s = 5.0
safety.echo_age_max_s = 1.0
safety.echo_mismatch_s = 100.0
"""
WARM_UP_STEPS = 20


class BareStep:
    """An empty control loop; `outcome` after so many steps."""

    def __init__(self, steps: int) -> None:
        self.late_s: list[float] = []
        self.skipped = 0
        self.outcome: Outcome | None = None
        self._steps = steps

    def tick(self, now_ns: int, timing: Timing, stop_reason: str = "") -> None:
        """Record the lateness."""
        del now_ns, stop_reason
        self.late_s.append(timing.lateness_s)
        self.skipped = timing.skipped
        if len(self.late_s) >= self._steps:
            self.outcome = Outcome("complete", "", 0.0, 0, 0, 0)

    def receive(self, frame: object, received_ns: int) -> None:
        """Receive no frame."""

    def make_safe(self, now_ns: int) -> None:
        """Do nothing: there is no pump."""


class SilentPort:
    """A bus without frames; it waits as the descriptors of SocketCAN and slcan do."""

    is_up = True

    def __init__(self) -> None:
        self._ours, self._theirs = socket.socketpair()

    def receive(self, timeout_s: float) -> None:
        """Wait."""
        select.select([self._ours], [], [], timeout_s)

    def waiting(self) -> tuple[()]:
        """Return no frame."""
        return ()

    def take_events(self) -> tuple[()]:
        """Return no events."""
        return ()


class Stopwatch:
    """A recorder that measures the time from the newest frame to each command, and passes all on to another one."""

    def __init__(self, inner: Any) -> None:
        self.latency_s: list[float] = []
        self.late_s: list[float] = []
        self.skipped = 0
        self._inner = inner
        self._received_s = float("nan")

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """One frame."""
        if is_rx:
            self._received_s = timestamp_s
        else:
            self.latency_s.append(timestamp_s - self._received_s)
        if self._inner is not None:
            self._inner.frame(timestamp_s, arbitration_id, data, is_rx)

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        """One step."""
        self.late_s.append(record.lateness_s)
        self.skipped = record.skipped
        if self._inner is not None:
            self._inner.tick(record, true_level_cm)

    def message(self, timestamp_s: float, message: can.Message) -> None:
        """One unexpected frame."""
        if self._inner is not None:
            self._inner.message(timestamp_s, message)

    def event(self, t_s: float, event: Event) -> None:
        """One event."""
        if self._inner is not None:
            self._inner.event(t_s, event)


def bare(out: Path, period_s: float, seconds: float, priority: int, cpu: int) -> None:
    """The runtime alone."""
    step = BareStep(round(seconds / period_s))
    port: Any = SilentPort()
    loop: Any = step
    with realtime.applied(RealTime(priority, cpu)) as applied:
        runtime.run(loop, port, MonotonicClock(), period_s, lambda: "", applied.housekeeping)
    np.savez(out, late_us=1e6 * np.array(step.late_s), skipped=step.skipped, refusals=applied.refusals)


def whole(
    out: Path,
    period_s: float,
    seconds: float,
    priority: int,
    cpu: int,
    interface: str,
    recording: str,
) -> None:
    """The controller in control."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        scenario = Path(folder) / "answer.toml"
        scenario.write_text(SCENARIO.format(seconds=seconds, period_s=period_s))
        bench = assembly.load(scenario)
        config = assembly.controller_config(bench)
        recorder = stack.enter_context(_recorder(recording, Path(folder) / "run", bench, config))
        channel = stack.enter_context(_node(interface, period_s, priority + 1))
        port = BusPort(BusAddress(interface, channel, bench.rig.bus.bitrate).open(bench.contract.ids))
        stack.callback(port.close)
        watch = Stopwatch(recorder)
        clock = MonotonicClock()
        loop = assembly.make_loop(bench, config, port, watch, clock_ns=clock.now_ns)
        applied = stack.enter_context(realtime.applied(RealTime(priority, cpu)))
        period_ns = round(period_s * 1e9)
        clock.sleep_until((clock.now_ns() // period_ns + 1) * period_ns)  # the node relies on it
        used_s = _processor_s(recorder)
        outcome = runtime.run(loop, port, clock, period_s, lambda: "", applied.housekeeping)
        used_s = _processor_s(recorder) - used_s
        if outcome.status != "complete":
            raise RuntimeError(f"the run ended {outcome.status}: {outcome.reason}")
        if recorder is not None:
            recorder.close(outcome.status, outcome.reason)
    kept = slice(WARM_UP_STEPS, -1)  # the last command is the 0 V at the end
    np.savez(
        out,
        latency_us=1e6 * np.array(watch.latency_s[kept]),
        late_us=1e6 * np.array(watch.late_s[kept]),
        skipped=watch.skipped,
        refusals=applied.refusals,
        recorder_share=used_s / seconds,
    )


@contextmanager
def _recorder(kind: str, folder: Path, bench: assembly.Bench, config: ControllerConfig) -> Iterator[Any]:
    if kind == "off":
        yield None
        return
    run = RunFolder.create(folder, run_plan(bench, is_live=True, seed=None))
    timeline = TimelineSettings(bench.rig.tank_model.level_gain_V_cm, config.duration_s)
    if kind != "process":
        timeline = timeline_of(bench.rig, config.duration_s)  # with the picture, as `hil run`
    port = viewer.free_port() if kind == "live" else None
    with ProcessRecorder() as recorder:
        recorder.open(run, partial(open_record, run, replace(timeline, live_port=port)))
        with nullcontext() if port is None else _reader(port, folder / "read.rrd"):
            yield recorder


@contextmanager
def _reader(port: int, path: Path) -> Iterator[None]:
    """A viewer that takes all that is served, but draws nothing; with the priority of one that `hil` starts."""
    command = [sys.executable, "-m", "rerun_cli", viewer.live_url(port), "--save", str(path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        os.setpriority(os.PRIO_PROCESS, process.pid, viewer.LIVE_NICENESS)
        try:
            yield
        finally:
            process.kill()


def _processor_s(recorder: Any) -> float:
    """Processor time of the recorder's process so far; 0 without one."""
    if recorder is None:
        return 0.0
    times = Path(f"/proc/{recorder._process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(times[11]) + int(times[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _node(interface: str, period_s: float, priority: int) -> Iterator[str]:
    """A thread on a virtual bus, or a process on an slcan line; yields the channel."""
    if interface == "virtual":
        line = VirtualLine("answer")
        threading.Thread(target=serve, args=(line, period_s, priority), daemon=True).start()
        yield "answer"
        return
    command = [sys.executable, "-m", "tools.benchmark.realtime.node", str(period_s), str(priority)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().strip() if process.stdout else ""
        finally:
            process.kill()


def main(arguments: list[str]) -> int:
    """One loop, its samples into a file."""
    settings: dict[str, Any] = json.loads(arguments[1])
    measure: Callable[..., None] = whole if settings.pop("loop") == "whole" else bare
    measure(Path(arguments[0]), **settings)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
