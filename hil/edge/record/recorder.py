"""The recorder: takes steps, frames and events from the control loop and writes them to files.

`Recorder` writes at once, in the caller's thread: for lockstep, where two runs with the same seed must give the same
bytes. For a live run, where nothing may delay the loop, `hil.edge.record.process_recorder` puts it into a process of
its own. Both have the same methods. A file that fails (a full disk, a lost mount) is closed and the others go on; no
error reaches the loop. `health()` reports it at once, `events.jsonl` and `run.json` record it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Protocol, TextIO

from hil.core.types import Event, Quad, Severity, TickRecord
from hil.edge.record.manifest import Status
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.record_format import Row, TickFormat, event_line, frame_line
from hil.edge.record.run_folder import RunFolder
from hil.edge.record.signals import UNKNOWN_LEVELS, Step, recorded

if TYPE_CHECKING:  # it takes longer to import than all the rest of the recorder's process
    import can


class Timeline(Protocol):
    """A further record of the run beside the files, such as Rerun's. It may raise; the recorder then stops using it."""

    def tick(self, row: Row) -> None:
        """Take one step; `row` in the order of the signals that this mode of run records."""

    def event(self, t_s: float, event: Event) -> None:
        """Record one event."""

    def flush(self) -> None:
        """Write what was recorded so far to the disk; raises when that fails."""

    def close(self) -> None:
        """Flush and finalise the file."""


@dataclass(frozen=True, slots=True)
class RecorderHealth:
    """errors : what failed, one line each. dropped : entries lost from a full queue. waiting : entries in the queue."""

    errors: tuple[str, ...] = ()
    dropped: int = 0
    waiting: int = 0

    @property
    def is_ok(self) -> bool:
        """Whether everything so far is in the record or on its way there."""
        return not self.errors and self.dropped == 0


class _Sink:
    """A text file that is closed at its first error."""

    def __init__(self, name: str, file: TextIO, on_failure: Callable[[str], None]) -> None:
        self._name, self._file, self._on_failure = name, file, on_failure
        self._is_open = True

    def write(self, line: str) -> None:
        if self._is_open:
            try:
                self._file.write(line)
            except (OSError, ValueError) as error:
                self._give_up(error)

    def flush(self) -> None:
        if self._is_open:
            try:
                self._file.flush()
            except (OSError, ValueError) as error:
                self._give_up(error)
            self._check()

    def close(self) -> None:
        self._check()
        if self._is_open:
            try:
                self._file.close()
                self._is_open = False
            except OSError as error:
                self._give_up(error)

    def _check(self) -> None:
        """Give up a file that somebody has removed: the system would write on, into a file without a name."""
        with suppress(OSError, ValueError):  # closed, or no file of the system's
            if self._is_open and os.fstat(self._file.fileno()).st_nlink == 0:
                self._give_up("somebody has removed it")

    def _give_up(self, error: Exception | str) -> None:
        self._is_open = False
        with suppress(OSError):
            self._file.close()
        self._on_failure(f"{self._name} is lost from here on: {error}")


class Recorder:
    """Writes steps, frames and events as they come, in the caller's thread. No method raises for what a disk does.

    Not for use from several threads at once; `health` may be called from any.
    """

    def __init__(
        self,
        folder: RunFolder,
        *,
        ticks: TextIO,
        frames: TextIO,
        sent: TextIO,
        events: TextIO,
        channel: str = "can0",
        timeline: Timeline | None = None,
        on_event: Callable[[Event], None] | None = None,
    ) -> None:
        """ticks, frames, sent, events : the open files. on_event : called with every event, must not block."""
        manifest = folder.manifest()
        self._format = TickFormat(recorded(manifest.plan.mode, manifest.plan.shown))
        self._is_live = manifest.plan.mode == "live"
        self._epoch_s = manifest.clock.monotonic_zero_epoch_s or 0.0
        self._has_run_zero = False
        self._on_event = on_event
        self._folder = folder
        self._channel = channel
        self._errors: tuple[str, ...] = ()
        self._timeline = timeline
        self._t_s = 0.0
        self._received_s = self._latency_s = nan
        self._is_closed = False
        self._ticks = _Sink(folder.ticks_path.name, ticks, self.note_failure)
        self._frames = _Sink(folder.can_log_path.name, frames, self.note_failure)
        self._sent = _Sink(folder.sent_log_path.name, sent, self.note_failure)
        self._events = _Sink(folder.events_path.name, events, self.note_failure)
        self._ticks.write(self._format.header)
        self._ticks.flush()  # a table from the first moment on, even if this process dies in the next

    @classmethod
    def open(
        cls,
        folder: RunFolder,
        *,
        channel: str = "can0",
        timeline: Timeline | None = None,
        on_event: Callable[[Event], None] | None = None,
    ) -> Recorder:
        """A recorder into the folder's files. channel : the bus's name in can.log.

        Raises RunFolderError when a file can't be opened, or does not even take its first line.
        """
        paths = (folder.ticks_path, folder.can_log_path, folder.sent_log_path, folder.events_path)
        with ExitStack() as opened:
            try:
                files = [opened.enter_context(path.open("x", encoding="utf-8", newline="\n")) for path in paths]
            except OSError as error:
                raise RunFolderError(f"cannot open the record in {folder.path}: {error.strerror}") from error
            opened.pop_all()
        ticks, frames, sent, events = files
        recorder = cls(
            folder,
            ticks=ticks,
            frames=frames,
            sent=sent,
            events=events,
            channel=channel,
            timeline=timeline,
            on_event=on_event,
        )
        if not recorder.health().is_ok:
            recorder.abandon()
            raise RunFolderError(f"cannot open the record in {folder.path}: {recorder.health().errors[0]}")
        return recorder

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None, queue: int = 0) -> None:
        """Write one step and its events.

        true_level_cm : the emulator's levels, known in lockstep. queue : entries that waited for the recorder.
        """
        self._t_s = record.t_s
        if not self._has_run_zero:
            self._note_run_zero(record)
        levels_cm = UNKNOWN_LEVELS if true_level_cm is None else true_level_cm
        row = self._format.row(Step(record, levels_cm, self._latency_s, queue))
        self._latency_s = nan
        self._ticks.write(self._format.line(row))
        if self._timeline is not None:
            self._try_timeline(self._timeline.tick, row)
        for event in record.events:
            self.event(record.t_s, event)

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """Write one ordinary frame (11-bit id, data); the quick way. timestamp_s : on the monotonic clock."""
        line = f"({timestamp_s + self._epoch_s:.6f}) {self._channel} {arbitration_id:03X}#{data.hex().upper()}\n"
        self._frames.write(line)
        if is_rx:
            self._received_s = timestamp_s
        else:
            self._latency_s = timestamp_s - self._received_s
            self._sent.write(line)

    def message(self, timestamp_s: float, message: can.Message) -> None:
        """Write any python-can message. timestamp_s : on the monotonic clock."""
        self._frames.write(frame_line(timestamp_s + self._epoch_s, self._channel, message))

    def event(self, t_s: float, event: Event) -> None:
        """Write one event and hand it to the operating system."""
        self._events.write(event_line(t_s, event))
        self._events.flush()
        if self._timeline is not None:
            self._try_timeline(self._timeline.event, t_s, event)
        if self._on_event is not None:
            self._on_event(event)

    def flush_files(self) -> None:
        """Hand ticks and frames to the operating system."""
        self._ticks.flush()
        self._frames.flush()
        self._sent.flush()

    def flush(self) -> None:
        """Hand everything to it, the timeline too."""
        self.flush_files()
        if self._timeline is not None:
            self._try_timeline(self._timeline.flush)

    def health(self) -> RecorderHealth:
        """What has failed so far."""
        return RecorderHealth(self._errors)

    def close(self, status: Status, reason: str, *, speed_x: float | None = None, dropped: int = 0) -> None:
        """Finish all files and record how the run ended. A second call does nothing."""
        if self._is_closed:
            return
        self.abandon()
        troubles = {"errors": list(self._errors), "dropped": dropped}
        try:
            self._folder.finish(status, reason, speed_x=speed_x, recorder=troubles)
        except (OSError, RunFolderError) as error:
            self._errors += (f"{self._folder.manifest_path.name} keeps the status running: {error}",)

    def abandon(self) -> None:
        """Finish all files but run.json: the run was interrupted, how it ended is not known."""
        self._is_closed = True
        if self._timeline is not None:
            self._try_timeline(self._timeline.close)
        for sink in (self._ticks, self._frames, self._sent, self._events):
            sink.close()

    def _note_run_zero(self, record: TickRecord) -> None:
        """At the first step: from here on times of frames and times of steps can be set against each other."""
        self._has_run_zero = True
        try:
            self._folder.note_run_zero(record.monotonic_ns * 1e-9 - record.t_s)
        except (OSError, RunFolderError) as error:
            self.note_failure(f"{self._folder.manifest_path.name} has no time of the run's start: {error}")

    def _try_timeline(self, call: Callable[..., None], *arguments: object) -> None:
        try:
            call(*arguments)
        except Exception as error:  # noqa: BLE001 - whatever the viewer's library raises must not stop the loop
            self._timeline = None
            self.note_failure(f"{self._folder.rrd_path.name} is lost from here on: {error}")

    def note_failure(self, text: str) -> None:
        """Note a failure of the record itself: for `health`, run.json and as an event."""
        self._errors += (text,)
        self.event(self._t_s, Event(Severity.ERROR, "recorder_failed", text))
