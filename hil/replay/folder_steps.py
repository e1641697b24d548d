"""The steps of a run folder: ticks.csv says when each took place, the order of can.log what each had read.

can.log has the frames in the order in which the controller read them, and its own commands between them: what stands
before a command was read before the step that sent it. The counts of accepted and rejected frames in ticks.csv say the
same for a step that sent nothing, and show whether can.log has gaps.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hil.core.counted import counted
from hil.core.reference_path import TIME_TOLERANCE_S
from hil.core.types import Mode, TripCause
from hil.edge.record.log_file import find_log
from hil.edge.record.manifest import Manifest
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.replay.candump_file import read_candump
from hil.replay.frame_log import FrameLog, ReplayError
from hil.replay.recorded_requests import placed_requests
from hil.replay.recorded_steps import RecordedStep, RecordedSteps
from hil.replay.step_order import ROUNDING_NS, merge
from hil.review.ticks import LoggedEvent, Ticks, read

Ints = npt.NDArray[np.int64]

NEEDED = ("mode", "lateness_s", "skipped", "accepted", "rejected")
"""Columns of ticks.csv besides t_s."""
EXACT_TIME = "t_ns"
"""Live runs have it."""

SIGNALS_THAT_STOP = ("SIGINT", "SIGTERM", "SIGHUP")


def read_folder_steps(folder: RunFolder, command_id: int) -> RecordedSteps:
    """The steps of a recorded run. command_id : identifier of PumpCommand. Raises RunFolderError, ReplayError."""
    manifest = folder.manifest()
    ticks, events = read(folder, (*NEEDED, EXACT_TIME))
    zero_s = manifest.clock.run_zero_epoch_s
    if not len(ticks):
        raise ReplayError(f"{folder.path}: the record has no control step in {folder.ticks_path.name} to replay")
    lacking = [name for name in NEEDED if name not in ticks.columns]
    if zero_s is None or lacking:
        what = (
            f"{folder.ticks_path.name} lacks {', '.join(lacking)}" if lacking else "run.json has no time of its start"
        )
        raise ReplayError(f"{folder.path}: an older record that can't be replayed: {what}")
    back = np.flatnonzero(np.diff(ticks["t_s"]) <= 0.0)
    if len(back):
        raise ReplayError(f"{folder.ticks_path}, line {back[0] + 3} is not later than the one before it")
    log = read_candump(folder.can_log_path)
    doubts: list[str] = list(log.doubts)
    ours = _own_rows(folder, log, command_id, doubts)
    _check_order(folder, log, ours)
    tick_ns = _tick_times(manifest, ticks, zero_s, doubts)
    received = log.rows_without(ours)
    delay_ns = _delay_ns(log.time_ns[ours], tick_ns, doubts) if manifest.plan.mode == "live" else 0
    merged = merge(log, ours, ticks, tick_ns, delay_ns)
    doubts += merged.doubts
    if not merged.steps:
        raise ReplayError(f"{folder.path}: {folder.can_log_path.name} has no frame of a control step")
    if manifest.recorder.get("dropped"):
        doubts.append(f"the recorder dropped {counted(int(manifest.recorder['dropped']), 'entry', 'entries')}")
    steps = _with_channel(_with_link(_with_stop(merged.steps, manifest), events), events)
    requests = placed_requests(events, steps, manifest.plan.period_s, doubts)
    return RecordedSteps(log, received, steps, requests, events, tuple(doubts), merged.missing)


def _own_rows(folder: RunFolder, log: FrameLog, command_id: int, doubts: list[str]) -> Ints:
    """Rows of what the controller sent: those of can.log that sent.log has, too."""
    candidates = log.rows_of(command_id)
    try:
        find_log(folder.sent_log_path)
    except RunFolderError:
        doubts.append("there is no sent.log: every pump command in can.log counts as the controller's own")
        return candidates
    sent = read_candump(folder.sent_log_path)
    if sent.has_same_frames(log.taken(candidates)):
        return candidates
    left = Counter((int(sent.time_ns[row]), sent.payload(row)) for row in range(len(sent)))
    rows = []
    for row in candidates.tolist():
        key = (int(log.time_ns[row]), log.payload(row))
        if left[key] > 0:
            left[key] -= 1
            rows.append(row)
    lacking = left.total()
    if lacking:
        doubts.append(f"can.log lacks {counted(lacking, 'command')} that sent.log has: those steps are not compared")
    return np.array(rows, dtype=np.int64)


def _check_order(folder: RunFolder, log: FrameLog, ours: Ints) -> None:
    """The controller's commands, and the frames of one identifier, were written in the order of their times."""
    for rows in (ours, *(log.rows_of(frame_id) for frame_id in np.unique(log.arbitration_id).tolist())):
        late = np.flatnonzero(np.diff(log.time_ns[rows]) < 0)
        if len(late):
            line = int(rows[late[0] + 1]) + 1
            raise ReplayError(
                f"{folder.can_log_path}, line {line} is earlier than the frame of its identifier before it: "
                "the lines are not in the order of the run, in which the controller read them"
            )


def _tick_times(manifest: Manifest, ticks: Ticks, zero_s: float, doubts: list[str]) -> Ints:
    """(n,) when the recorded steps began, in ns since the epoch."""
    zero_ns = round(zero_s * 1e6) * 1000
    if manifest.plan.mode == "lockstep":  # steps are whole control periods from 0 on
        period_ns = round(manifest.plan.period_s * 1e9)
        return np.rint((zero_ns + ticks["t_s"] * 1e9) / period_ns).astype(np.int64) * period_ns
    exact = ticks.get(EXACT_TIME)
    if np.isfinite(exact).all():
        return zero_ns + exact.astype(np.int64)
    longest_s = float(np.abs(ticks["t_s"]).max())
    digits_us = 10.0 ** max(np.ceil(np.log10(max(longest_s, 1.0))) - 3.0, -1.0)
    doubts.append(f"an older live record: its steps' times are known to {digits_us:g} us (ticks.csv has no t_ns)")
    return zero_ns + np.rint(ticks["t_s"] * 1e9).astype(np.int64)


def _delay_ns(sent_ns: Ints, tick_ns: Ints, doubts: list[str]) -> int:
    """How long after its step began a command is recorded, live; the median. Used for steps without a row."""
    owner = np.searchsorted(tick_ns, sent_ns + ROUNDING_NS, side="right") - 1
    before = int(np.searchsorted(owner, 0))
    in_control = owner >= 0
    if not in_control.any():
        return 0
    delay_ns = int(np.median((sent_ns - tick_ns[owner])[in_control]))
    if before:
        steps = "the step" if before == 1 else f"the {counted(before, 'step')}"
        doubts.append(
            f"when {steps} before control began is not recorded: taken "
            f"as {delay_ns / 1e3:.0f} us before the command, the median of the other steps"
        )
    return delay_ns


def _with_stop(steps: tuple[RecordedStep, ...], manifest: Manifest) -> tuple[RecordedStep, ...]:
    """A signal that stopped the run, from the step on in which it did."""
    asked = manifest.reason.partition(";")[0]
    if asked not in SIGNALS_THAT_STOP:
        return steps
    stopping = (at for at, step in enumerate(steps) if step.mode == Mode.STOPPING)
    last = max((at for at, step in enumerate(steps) if step.is_in_control), default=len(steps) - 1)
    begun = next(stopping, last)
    return tuple(replace(step, stop_reason=asked) if at >= begun else step for at, step in enumerate(steps))


def _with_link(steps: tuple[RecordedStep, ...], events: tuple[LoggedEvent, ...]) -> tuple[RecordedStep, ...]:
    """A bus that was lost, from the step on that tripped for it."""
    lost_s = [one.t_s for one in events if one.code == "trip" and one.data.get("cause") == TripCause.BUS_FAILED]
    if not lost_s:
        return steps
    return tuple(
        replace(step, link_is_up=False) if step.is_in_control and step.t_s >= lost_s[0] - TIME_TOLERANCE_S else step
        for step in steps
    )


def _with_channel(steps: tuple[RecordedStep, ...], events: tuple[LoggedEvent, ...]) -> tuple[RecordedStep, ...]:
    """A control channel that was lost, from then on: such a run waits for nobody after a trip."""
    lost_s = [one.t_s for one in events if one.code == "control_lost"]
    if not lost_s:
        return steps
    return tuple(
        replace(step, has_channel=False) if step.is_in_control and step.t_s >= lost_s[0] - TIME_TOLERANCE_S else step
        for step in steps
    )
