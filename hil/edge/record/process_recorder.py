"""The controller's end of the recorder in a process of its own: entries are handed over, and nothing waits for a disk.

    loop -> ProcessRecorder -> batches over a local socket -> `recorder_process` -> Recorder -> run folder

A batch is handed over when a step ends; what the socket does not accept waits in a bounded queue, whose oldest batches
are dropped and counted. A recorder that dies is noticed at the next step: the loop goes on without a record, and the
folder says so at the end.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any

from hil.core.types import Event, Quad, Severity, TickRecord
from hil.edge.record.manifest import Status
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.record_format import event_line
from hil.edge.record.recorder import Recorder, RecorderHealth
from hil.edge.record.recorder_process import MAX_MESSAGE, Entry
from hil.edge.record.run_folder import RunFolder

if TYPE_CHECKING:
    import can

MAX_BATCH = 200
"""Entries; some 10 kB, of the 200 kB or more that the socket takes."""

MAX_BATCH_AGE_S = 0.05
"""While no steps are recorded, frames are handed over when the first of a batch is this old."""

ALLOCATOR_SETTINGS = {"MIMALLOC_PURGE_DELAY": "0"}
"""Tells Rerun's allocator to return freed memory at once; otherwise its reserve grows for the first hours of a run."""

START_TIMEOUT_S = 60.0
CLOSE_TIMEOUT_S = 90.0
"""For the last writes and Rerun's compaction of its file. The pumps are off by then."""

Opener = Callable[[], Recorder]


class ProcessRecorder:
    """A `Recorder` in another process, with its methods. No call waits but `open` and `close`. Use as a context.

    The process is started at once, since loading its libraries takes as long; `open` tells it which record to make. Use
    from one thread. capacity : entries that may wait here.
    """

    def __init__(self, *, capacity: int = 50_000) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - ourselves
                [sys.executable, "-m", "hil.edge.record.recorder_process", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                env={**ALLOCATOR_SETTINGS, **os.environ},
                start_new_session=True,  # Ctrl-C and a closed terminal are for the controller alone
            )
        self._capacity = capacity
        self._folder: RunFolder | None = None
        self._batch: list[Entry] = []
        self._batch_since_s = 0.0
        self._queue: deque[tuple[bytes, int]] = deque()
        self._queued = self._put = self._taken = self._dropped = 0
        self._errors: tuple[str, ...] = ()
        self._t_s = 0.0
        self._lost_at_s: float | None = None
        self._reported, self._has_reported_drop = 0, False

    def __enter__(self) -> ProcessRecorder:
        """Nothing to do: the process is on its way up."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Disconnect from the process: without `close`, it leaves the record as that of an interrupted run."""
        self._socket.close()
        if self._folder is None:
            self._process.kill()
            self._process.wait()

    def open(self, folder: RunFolder, opener: Opener) -> None:
        """Open the record there. opener : makes the `Recorder`, in that process; it is pickled.

        Raises RunFolderError when it can't.
        """
        self._folder = folder
        self._socket.settimeout(START_TIMEOUT_S)
        try:
            self._socket.send(pickle.dumps(opener))
            answer: Any = pickle.loads(self._socket.recv(MAX_MESSAGE) or pickle.dumps("it ended"))  # noqa: S301 - our own child
        except OSError as error:
            answer = str(error)
        if answer is not None:
            raise RunFolderError(f"the recorder can't be started: {answer}")
        self._socket.setblocking(False)

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        """Hand over one step and all entries before it."""
        self._t_s = record.t_s
        self._poll_status()
        self._append("tick", record, true_level_cm, self._put - self._taken - self._dropped)
        self._hand_over()

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """Note one ordinary frame; `data` must not change before the step ends."""
        if not self._batch:
            self._batch_since_s = timestamp_s
        self._append("frame", timestamp_s, arbitration_id, data, is_rx)
        if timestamp_s - self._batch_since_s > MAX_BATCH_AGE_S or len(self._batch) >= MAX_BATCH:
            self._hand_over()

    def message(self, timestamp_s: float, message: can.Message) -> None:
        """Note any python-can message."""
        self._append("message", timestamp_s, message)
        if len(self._batch) >= MAX_BATCH:
            self._hand_over()

    def event(self, t_s: float, event: Event) -> None:
        """Hand over one event."""
        self._append("event", t_s, event)
        self._hand_over()

    def health(self) -> RecorderHealth:
        """What has failed, was dropped, and waits here or there."""
        return RecorderHealth(self._errors, self._dropped, self._put - self._taken - self._dropped)

    def troubles(self) -> tuple[Event, ...]:
        """What has failed since the last call, for an operator; the record says it as far as it can."""
        if len(self._errors) == self._reported and (self._dropped == 0 or self._has_reported_drop):
            return ()
        new, self._reported = self._errors[self._reported :], len(self._errors)
        if self._lost_at_s is None:
            found = [Event(Severity.ERROR, "recorder_failed", text) for text in new]
        else:
            found = [Event(Severity.ERROR, "recorder_lost", text) for text in new]
        if self._dropped and not self._has_reported_drop:
            self._has_reported_drop = True
            found.append(Event(Severity.WARNING, "record_dropped", "the record has gaps: the recorder can't keep up"))
        return tuple(found)

    def close(
        self, status: Status, reason: str, *, speed_x: float | None = None, timeout_s: float = CLOSE_TIMEOUT_S
    ) -> None:
        """Finish the record. A recorder that is lost, or stuck for `timeout_s`, is given up; `run.json` says so."""
        self._hand_over()
        end_s = time.monotonic() + timeout_s
        self._drain(end_s)
        if self._lost_at_s is None:
            self._append("close", status, reason, speed_x, self._dropped)
            self._hand_over()
            self._drain(end_s)
            self._await_end(end_s)
        if self._lost_at_s is not None:
            self._finish_without(status, reason, speed_x)

    def _append(self, name: str, *arguments: object) -> None:
        self._batch.append((name, arguments))

    def _hand_over(self) -> None:
        """Queue the batch, send what is taken, drop the oldest batches that are too many."""
        if self._batch:
            self._queue.append((pickle.dumps(self._batch, pickle.HIGHEST_PROTOCOL), len(self._batch)))
            self._put += len(self._batch)
            self._queued += len(self._batch)
            self._batch.clear()
        self._send()
        while self._queued > self._capacity:
            self._drop()

    def _drop(self) -> None:
        _, count = self._queue.popleft()
        self._queued -= count
        self._dropped += count

    def _send(self) -> None:
        while self._queue:
            if self._lost_at_s is not None:
                self._drop()
                continue
            try:
                self._socket.send(self._queue[0][0])
            except BlockingIOError:
                return
            except OSError as error:
                self._lose(f"the recorder is lost: {error.strerror}")
                continue
            self._queued -= self._queue.popleft()[1]

    def _drain(self, end_s: float) -> None:
        """Wait until the socket has accepted all that is queued."""
        while self._queue and self._lost_at_s is None and time.monotonic() < end_s:
            select.select([], [self._socket], [], 0.1)
            self._send()

    def _poll_status(self) -> None:
        """Read the recorder's status messages: how many entries it has taken, what has failed."""
        if self._lost_at_s is not None:
            return
        with contextlib.suppress(BlockingIOError):
            try:
                while data := self._socket.recv(MAX_MESSAGE):
                    self._taken, self._errors = pickle.loads(data)  # noqa: S301 - our own child
                self._lose("the recorder is lost: it ended")
            except ConnectionError as error:
                self._lose(f"the recorder is lost: {error.strerror}")

    def _lose(self, text: str) -> None:
        self._lost_at_s = self._t_s
        self._errors += (text,)

    def _await_end(self, end_s: float) -> None:
        try:
            code = self._process.wait(max(end_s - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            self._lose("the recorder is stuck and given up")
            self._process.kill()
            return
        if code != 0:
            self._lose(f"the recorder ended with {code}")
            return
        with contextlib.suppress(OSError):
            while data := self._socket.recv(MAX_MESSAGE):
                self._taken, self._errors = pickle.loads(data)  # noqa: S301 - our own child

    def _finish_without(self, status: Status, reason: str, speed_x: float | None) -> None:
        """Write how the run ended in place of the lost recorder. A disk that takes no more was reported before."""
        if self._folder is None:
            return
        text = self._errors[-1]
        data: dict[str, object] = {"dropped": self._dropped}
        event = Event(Severity.ERROR, "recorder_lost", text, data)
        troubles = {"errors": list(self._errors), "dropped": self._dropped}
        with contextlib.suppress(OSError, RunFolderError):
            with self._folder.events_path.open("a", encoding="utf-8", newline="\n") as file:
                file.write(event_line(self._lost_at_s or 0.0, event))
            self._folder.finish(status, reason, speed_x=speed_x, recorder=troubles)
