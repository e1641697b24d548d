"""The tables: lateness beside cyclictest, skipped steps, receive-to-send latency with recording on and off."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.edge.host.realtime import DEFAULT_PRIORITY
from tools.benchmark.realtime import cyclictest
from tools.benchmark.realtime.load import busy
from tools.benchmark.tables import Section, as_time, as_verdict

Samples = NDArray[np.float64]

PERIODS_S = (0.001, 0.01, 0.1)
BUSY_PROCESSES = 3
RATIO_TARGET = 2.0
LATENCY_TARGET_US = 1000.0
DIFFERENCE_TARGET = 0.10
LATENCY_SHARE = 0.2
"""Share of the requested minutes for each row on latency."""


@dataclass(frozen=True)
class Plan:
    """Duration of each loop's measurement, duration of a turn, and folder."""

    minutes: float
    turn_s: float = 10.0
    priority: int = DEFAULT_PRIORITY
    cpu: int = max(os.sched_getaffinity(0))

    def turns(self, share: float = 1.0) -> tuple[int, float]:
        """Number of turns and seconds per turn."""
        total_s = self.minutes * share * 60.0
        count = max(1, round(total_s / self.turn_s))
        return count, total_s / count


@dataclass(frozen=True)
class Measured:
    """A loop's samples, in microseconds. recorder_share : of a processor, that the recorder's process takes."""

    late_us: Samples
    latency_us: Samples
    skipped: int
    recorder_share: float = 0.0


def lateness(plan: Plan) -> list[Section]:
    """The bare loop beside cyclictest, with busy processes beside both."""
    has_peer = cyclictest.is_there()
    rows: list[tuple[str, ...]] = []
    with busy(BUSY_PROCESSES):
        for period_s in PERIODS_S:
            peer, ours = _in_turns(plan, period_s, has_peer)
            name = f"{1e3 * period_s:g} ms"
            if has_peer:
                rows.append((name, "cyclictest", str(len(peer)), *_quantiles(peer), "", ""))
            ratio = np.quantile(ours.late_us, 0.99) / np.quantile(peer, 0.99) if has_peer else np.nan
            verdict = as_verdict(ratio <= RATIO_TARGET) if has_peer else "no cyclictest"
            skipped = f"{ours.skipped} skipped"
            rows.append(
                (
                    name,
                    "loop",
                    str(len(ours.late_us)),
                    *_quantiles(ours.late_us),
                    f"{ratio:.2f}",
                    f"{verdict}; {skipped}",
                )
            )
    note = (
        f"How late a period began, under SCHED_FIFO {plan.priority} on processor {plan.cpu}, memory locked, "
        f"{BUSY_PROCESSES} busy processes beside it; turns of {plan.turns()[1]:.0f} s. The loop is the runtime and its "
        "clock, with a step that does nothing, on a silent line; it waits in select as it does for SocketCAN and "
        "slcan, and the last 0.15 ms awake, which cyclictest does not. "
        f"Ratio: of the p99, to be at most {RATIO_TARGET:g}."
    )
    if not has_peer:
        note += f" {cyclictest.MISSING}."
    columns = ("period", "what", "periods", "p50", "p99", "p99.9", "max", "ratio", "verdict")
    return [Section("Lateness beside cyclictest", note, columns, rows)]


def latency(plan: Plan) -> list[Section]:
    """The controller in control, on both of the host's paths, recorded and not, in turns."""
    rows: list[tuple[str, ...]] = []
    for interface in ("virtual", "slcan"):
        for period_s in PERIODS_S:
            found = _recorded_and_not(plan, interface, period_s)
            worst = {name: float(np.quantile(one.latency_us, 0.99)) for name, one in found.items()}
            more = worst["process"] / worst["off"] - 1.0
            for name, one in found.items():
                is_met = worst[name] < LATENCY_TARGET_US
                verdict = as_verdict(is_met)
                if name != "off":
                    verdict += f"; difference {as_verdict(more < DIFFERENCE_TARGET)}"
                rows.append(
                    (
                        interface if interface == "virtual" else "slcan, TCP",
                        f"{1e3 * period_s:g} ms",
                        "on" if name == "process" else name,
                        str(len(one.latency_us)),
                        *_quantiles(one.latency_us),
                        "" if name == "off" else f"{100.0 * more:+.1f} %",
                        f"{as_time(float(np.quantile(one.late_us, 0.99)))}, {one.skipped} skipped",
                        verdict,
                    )
                )
    note = (
        "From the arrival of the newest frame that a step could use to the moment its command had been sent, as in "
        "ticks.csv. The whole controller in control, without a diagnosis, under SCHED_FIFO, no load; a node that "
        "answers each command with levels, status and heartbeats 0.5 ms before the next step is due, so that every "
        f"step has fresh ones. Target: p99 under 1 ms, with recording at most {100 * DIFFERENCE_TARGET:.0f} % more."
    )
    columns = (
        "path",
        "period",
        "record",
        "steps",
        "p50",
        "p99",
        "p99.9",
        "max",
        "p99, on to off",
        "lateness p99",
        "verdict",
    )
    return [Section("Receive to send", note, columns, rows)]


def live(plan: Plan) -> list[Section]:
    """The controller in control with and without `--live`, in turns."""
    rows: list[tuple[str, ...]] = []
    for period_s in PERIODS_S[1:]:
        found = _recorded_and_not(plan, "slcan", period_s, ("file", "live"))
        before = found["file"]
        for name, one in found.items():
            p50, p99, _, top = _quantiles(one.latency_us)
            late = [float(np.quantile(m.late_us, 0.99)) for m in (one, before)]
            ratio = float(np.quantile(one.latency_us, 0.99) / np.quantile(before.latency_us, 0.99))
            shown = ("", "") if name == "file" else (f"{ratio:.2f}", f"{late[0] / late[1]:.2f}")
            rows.append(
                (
                    f"{1e3 * period_s:g} ms",
                    "file" if name == "file" else "file and --live",
                    str(len(one.latency_us)),
                    *(p50, p99, top, shown[0]),
                    *(as_time(late[0]), shown[1], str(one.skipped)),
                    f"{100.0 * one.recorder_share:.1f} %",
                )
            )
    note = (
        "The whole controller in control under SCHED_FIFO, as in the table on receive to send, on slcan over TCP, with "
        "everything recorded; in turns without and with the live picture, which one viewer takes that draws nothing. "
        "Ratios: of the p99, with over without. Recorder: processor time of its process, which serves the picture, too."
    )
    columns = (
        *("period", "record", "steps", "receive to send, p50", "p99", "max", "ratio"),
        *("lateness p99", "ratio", "skipped", "recorder"),
    )
    return [Section("Cost of the live picture", note, columns, rows)]


def _in_turns(plan: Plan, period_s: float, has_peer: bool) -> tuple[Samples, Measured]:
    count, turn_s = plan.turns()
    peer: list[Samples] = []
    ours: list[Measured] = []
    for _ in range(count):
        if has_peer:
            peer.append(cyclictest.lateness_us(period_s, turn_s, plan.priority, plan.cpu))
        ours.append(_measure(plan, {"loop": "bare", "period_s": period_s, "seconds": turn_s}))
    return (np.concatenate(peer) if peer else np.empty(0)), _pooled(ours)


def _recorded_and_not(
    plan: Plan, interface: str, period_s: float, kinds: tuple[str, ...] = ("off", "process")
) -> dict[str, Measured]:
    count, turn_s = plan.turns(LATENCY_SHARE)
    found: dict[str, list[Measured]] = {kind: [] for kind in kinds}
    for _ in range(count):
        for recording, turns in found.items():
            settings = {"loop": "whole", "period_s": period_s, "seconds": turn_s}
            turns.append(_measure(plan, settings | {"interface": interface, "recording": recording}))
    return {recording: _pooled(turns) for recording, turns in found.items()}


def _measure(plan: Plan, settings: Mapping[str, Any]) -> Measured:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "samples.npz"
        asked = json.dumps({**settings, "priority": plan.priority, "cpu": plan.cpu})
        command = [sys.executable, "-m", "tools.benchmark.realtime.loops", str(out), asked]
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # as `hil run --realtime` does
        subprocess.run(command, check=True, env=environment)
        with np.load(out) as data:
            if len(data["refusals"]):
                raise RuntimeError(f"no real time, nothing to measure: {data['refusals'][0]}")
            latency_us = data["latency_us"] if "latency_us" in data else np.empty(0)
            share = float(data["recorder_share"]) if "recorder_share" in data else 0.0
            return Measured(data["late_us"], latency_us, int(data["skipped"]), share)


def _pooled(turns: list[Measured]) -> Measured:
    def joined(what: Callable[[Measured], Samples]) -> Samples:
        return np.concatenate([what(turn) for turn in turns])

    return Measured(
        joined(lambda one: one.late_us),
        joined(lambda one: one.latency_us),
        sum(one.skipped for one in turns),
        float(np.mean([one.recorder_share for one in turns])),
    )


def _quantiles(values: Samples) -> tuple[str, ...]:
    return tuple(as_time(float(np.quantile(values, share))) for share in (0.5, 0.99, 0.999, 1.0))
