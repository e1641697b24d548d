"""The steps of a log without a run folder, from the controller's commands in it.

The time base is the log's. The controller's steps have deadlines that are whole control periods apart; its commands
come a little later, by how late the step was and by how long it took. A step is therefore placed on a grid of periods
through the earliest commands, and is taken to have read every frame that is in the log before its command.

How late the first step in control was decides whether a step to a reference falls on one control step or on the next.
It is not in a log: the replay tries both (`with_late_start`) and keeps the one that fits the log better.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hil.core.counted import counted
from hil.replay.frame_log import FrameLog, ReplayError
from hil.replay.log_reader import read_log
from hil.replay.recorded_steps import RecordedStep, RecordedSteps
from hil.wire.contract import Contract, crc8

Ints = npt.NDArray[np.int64]

MAX_SHOWN = 3
LATER_NS = 300_000
"""By how much later the first step in control may have been than the others."""

MAX_PERIOD_ERROR = 0.05
EARLIEST = 0.05
"""Share of the commands that are earlier than the grid: an odd time stamp must not move it."""

TIME_BASE = (
    "steps are placed on whole control periods and taken to have read every frame before their commands; "
    "a log has neither the lateness of a step nor which frames had been read"
)
NOT_IN_A_LOG = "what an operator asked for, how the run was stopped and options of `hil run` are not in a log"


def read_log_steps(path: Path, contract: Contract, period_s: float) -> RecordedSteps:
    """The steps in a log, whose first step in control was on time. Raises ReplayError, RunFolderError."""
    log = read_log(path)
    known = np.isin(log.arbitration_id, contract.ids) & (log.kind == 0)
    if not known.any():
        ids = ", ".join(f"{frame_id:03X}" for frame_id in contract.ids)
        seen = ", ".join(f"{frame_id:03X}" for frame_id in np.unique(log.arbitration_id)[:6].tolist())
        raise ReplayError(f"{path}: no frame of the bench in this log: bench.dbc has {ids}; the log has {seen}")
    log = _on_one_channel(log, contract)
    ours = _commands(path, log, contract)
    now_ns, number_of = _on_grid(path, log.time_ns[ours], period_s)
    steps = [
        RecordedStep(at_ns, row - number, row)
        for number, (at_ns, row) in enumerate(zip(now_ns.tolist(), ours.tolist(), strict=True))
    ]
    doubts = [*log.doubts, TIME_BASE, NOT_IN_A_LOG]
    missing = _missing(log, ours, contract, number_of, doubts)
    received = log.rows_without(ours)
    return RecordedSteps(log, received, tuple(steps), {}, None, tuple(doubts), missing)


def with_late_start(recorded: RecordedSteps, contract: Contract) -> RecordedSteps:
    """The same, but the first step in control was later than the others."""
    layout = contract.frames["PumpCommand"]
    steps = list(recorded.steps)
    for number, step in enumerate(steps):
        values = layout.decode(recorded.log.payload(step.command))
        if values is not None and values["Enable"]:
            steps[number] = replace(step, now_ns=step.now_ns + LATER_NS)
            break
    return replace(recorded, steps=tuple(steps))


def _on_grid(path: Path, sent_ns: Ints, period_s: float) -> tuple[Ints, Ints]:
    """(m,) when the steps began, and their numbers in periods. Raises ReplayError for another period."""
    period_ns = round(period_s * 1e9)
    usual_ns = float(np.median(np.diff(sent_ns))) if len(sent_ns) > 1 else float(period_ns)
    if abs(usual_ns / period_ns - 1.0) > MAX_PERIOD_ERROR:
        raise ReplayError(
            f"{path}: commands come every {usual_ns * 1e-9:g} s, but control.period_s of the rig is {period_s:g} s: "
            "this log is of another rig; name it with --rig"
        )
    number_of = np.concatenate([[0], np.cumsum(np.rint(np.diff(sent_ns) / period_ns).astype(np.int64))])
    begun_ns = int(np.quantile(sent_ns - number_of * period_ns, EARLIEST, method="lower"))
    return begun_ns + number_of * period_ns, number_of


def _on_one_channel(log: FrameLog, contract: Contract) -> FrameLog:
    """Of several buses, the one with most commands."""
    if len(log.channels) < 2:
        return log
    rows = log.rows_of(contract.frames["PumpCommand"].frame_id)
    chosen = int(np.argmax(np.bincount(log.channel[rows], minlength=len(log.channels))))
    name = log.channels[chosen]
    return log.taken(
        np.flatnonzero(log.channel == chosen), f"of several buses in the log, the one with commands: {name}"
    )


def _commands(path: Path, log: FrameLog, contract: Contract) -> Ints:
    """Rows of the controller's commands. Raises ReplayError for none, and for a log that begins within a run."""
    layout = contract.frames["PumpCommand"]
    rows = [
        row
        for row in log.rows_of(layout.frame_id).tolist()
        if len(data := log.payload(row)) == layout.length and crc8(data[:-1], layout.crc_start) == data[-1]
    ]
    if not rows:
        raise ReplayError(
            f"{path}: no command of a controller in this log (PumpCommand, {layout.frame_id:03X}): "
            "steps can't be told from it"
        )
    first = layout.decode(log.payload(rows[0]))
    if first is not None and first["Enable"]:
        raise ReplayError(
            f"{path}: the log begins within a run, its first command is enabled already: what the controller knew by "
            "then is not in it; a log has to begin before the run does"
        )
    return np.array(rows, dtype=np.int64)


def _missing(log: FrameLog, ours: Ints, contract: Contract, number_of: Ints, doubts: list[str]) -> frozenset[int]:
    """Numbers of steps before which others are missing, by the counter of the commands or by a gap in their times."""
    layout = contract.frames["PumpCommand"]
    counters = np.array([(layout.decode(log.payload(row)) or {"Counter": -1.0})["Counter"] for row in ours.tolist()])
    jumps = np.mod(np.diff(counters), 16.0) != 1.0
    at = (np.flatnonzero(jumps | (np.diff(number_of) > 1)) + 1).tolist()
    if at:
        begun_ns = int(log.time_ns[0])
        shown = ", ".join(f"{(int(log.time_ns[ours[number]]) - begun_ns) * 1e-9:.3f} s" for number in at[:MAX_SHOWN])
        more = f" and {counted(len(at) - MAX_SHOWN, 'gap')} more" if len(at) > MAX_SHOWN else ""
        doubts.append(f"steps or commands are missing before these times of the log: {shown}{more}")
    return frozenset(at)
