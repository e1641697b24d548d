"""Puts the commands in a log and the rows of ticks.csv together: the steps in the order in which they took place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.core.counted import counted
from hil.replay.frame_log import FrameLog
from hil.replay.recorded_steps import NOTHING, RecordedStep
from hil.review.ticks import Ticks

Ints = npt.NDArray[np.int64]

ROUNDING_NS = 2_000
"""Times of frames are recorded in whole microseconds."""

MAX_SHOWN = 3


@dataclass(frozen=True, eq=False)
class MergedSteps:
    """steps, missing, doubts : see `RecordedSteps`."""

    steps: tuple[RecordedStep, ...]
    missing: frozenset[int]
    doubts: tuple[str, ...]


def merge(log: FrameLog, ours: Ints, ticks: Ticks, tick_ns: Ints, delay_ns: int) -> MergedSteps:
    """One step for each row of ticks.csv, and one for each command that no row explains.

    ours : (m,) rows of the log that the controller sent. tick_ns : (n,) when the steps of ticks.csv began. delay_ns :
    by how much a command is later than the beginning of its step.
    """
    return _Merge(log, ours, ticks, tick_ns, delay_ns).run()


class _Merge:
    def __init__(self, log: FrameLog, ours: Ints, ticks: Ticks, tick_ns: Ints, delay_ns: int) -> None:
        self._sent_ns, self._ours = log.time_ns[ours], ours
        self._read = ours - np.arange(len(ours))  # frames received before each command
        self._frames = len(log) - len(ours)
        self._ticks, self._tick_ns, self._delay_ns = ticks, tick_ns, delay_ns
        self._counts = (ticks["accepted"] + ticks["rejected"]).astype(np.int64)
        self._steps: list[RecordedStep] = []
        self._missing: set[int] = set()
        self._lacking: list[str] = []
        self._until = self._counted = 0
        """Frames read up to the last step: by the order of the log, and by the counts of ticks.csv."""

    def run(self) -> MergedSteps:
        """Steps, and what is missing between them."""
        first_of = np.searchsorted(self._sent_ns + ROUNDING_NS, self._tick_ns, side="left")
        for at in range(int(first_of[0])):
            self._add_command(at)
        doubts: tuple[str, ...] = ()
        for tick in range(len(self._tick_ns)):
            at = int(first_of[tick])
            behind = int(first_of[tick + 1]) if tick + 1 < len(first_of) else len(self._ours)
            if at == behind and self._counts[tick] - self._counted > self._frames - self._until:
                doubts = (self._cut(tick),)
                break
            self._add_tick(tick, at if at < behind else NOTHING)
            for extra in range(at + 1, behind):
                self._add_command(extra)
        return MergedSteps(tuple(self._steps), frozenset(self._missing), doubts + self._gaps())

    def _add_command(self, at: int) -> None:
        """A step that ticks.csv has no row for: before control, one that failed, or the command at the very end."""
        self._counted += int(self._read[at]) - self._until
        self._until = int(self._read[at])
        now_ns = int(self._sent_ns[at]) - self._delay_ns
        self._steps.append(RecordedStep(now_ns, self._until, int(self._ours[at])))

    def _add_tick(self, tick: int, at: int) -> None:
        count, ticks = int(self._counts[tick]), self._ticks
        t_s = float(ticks["t_s"][tick])
        if at == NOTHING:
            self._until = min(self._until + count - self._counted, self._frames)
        else:
            lacking = count - self._counted - (int(self._read[at]) - self._until)
            if lacking:
                self._missing.add(len(self._steps))
                self._lacking.append(f"{counted(abs(lacking), 'frame')} {'missing' if lacking > 0 else 'too many'} "
                                     f"before {t_s:.3f} s")  # fmt: skip
            self._until = int(self._read[at])
        self._counted = count
        self._steps.append(
            RecordedStep(
                now_ns=int(self._tick_ns[tick]),
                until=self._until,
                command=NOTHING if at == NOTHING else int(self._ours[at]),
                t_s=t_s,
                mode=int(ticks["mode"][tick]),
                lateness_s=float(ticks["lateness_s"][tick]) or 0.0,  # one number for all steps of a simulated run
                skipped=int(ticks["skipped"][tick]),
            )
        )

    def _cut(self, tick: int) -> str:
        first_s, last_s = float(self._ticks["t_s"][tick]), float(self._ticks["t_s"][-1])
        return (
            f"can.log ends before the step at {first_s:.3f} s, ticks.csv goes on to {last_s:.3f} s: "
            "what the log does not have is not replayed"
        )

    def _gaps(self) -> tuple[str, ...]:
        if not self._lacking:
            return ()
        shown = ", ".join(self._lacking[:MAX_SHOWN])
        more = len(self._lacking) - MAX_SHOWN
        return (f"can.log has gaps: {shown}" + (f" and {counted(more, 'gap')} more" if more > 0 else ""),)
