"""The recorder's process: takes the entries of a `ProcessRecorder` from a local socket, and writes the record.

A killed controller loses what it had not yet handed over, at most one step; this process then finishes the files by
itself.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import socket
import sys
import time

from hil.core.counted import counted
from hil.core.types import Event, Severity
from hil.edge.record.manifest import Status
from hil.edge.record.recorder import Recorder

MAX_MESSAGE = 1 << 20
FLUSH_S = 0.1
FLUSHES_PER_TIMELINE = 600
"""Rerun keeps every chunk's entry in memory until the file is closed: at five chunks a second 4 MB a minute. If the
controller is killed nothing is lost, since this process goes on and closes the file."""
Entry = tuple[str, tuple[object, ...]]
"""Name of a method of `Recorder`, and its arguments."""


class _Writer:
    """The other end: entries as they come, files flushed ten times a second."""

    def __init__(self, recorder: Recorder, line: socket.socket) -> None:
        self._recorder, self._line = recorder, line
        self._taken = self._rounds = 0
        self._sent_status: object = None
        self._has_failed_entry = False
        self._is_closed = False

    def work(self) -> None:
        """Until the controller asks to close, or is gone."""
        flush_at_s = time.monotonic() + FLUSH_S
        while not self._is_closed:
            remaining_s = flush_at_s - time.monotonic()
            if remaining_s > 0.0:
                if select.select([self._line], [], [], remaining_s)[0]:
                    data = self._receive()
                    if not data:
                        break
                    self._take(pickle.loads(data))  # noqa: S301 - from our own parent
                continue
            self._flush()
            flush_at_s = time.monotonic() + FLUSH_S
        if not self._is_closed:
            self._recorder.abandon()

    def _receive(self) -> bytes:
        """The next batch; empty when the controller is gone and all that it had sent is taken."""
        try:
            return self._line.recv(MAX_MESSAGE)
        except (
            ConnectionResetError
        ):  # raised once, before the entries that still wait, when it ended with status unread
            return self._line.recv(MAX_MESSAGE)

    def _take(self, batch: list[Entry]) -> None:
        for name, arguments in batch:
            self._taken += 1
            try:
                if name == "close":
                    self._close(*arguments)  # type: ignore[arg-type]
                else:
                    getattr(self._recorder, name)(*arguments)
            except Exception as error:  # noqa: BLE001 - one entry that can't be written must not end the record
                if not self._has_failed_entry:
                    self._has_failed_entry = True
                    self._recorder.note_failure(f"an entry could not be written: {type(error).__name__}: {error}")

    def _close(self, status: Status, reason: str, speed_x: float | None, dropped: int) -> None:
        self._is_closed = True
        if dropped:
            text = f"the record has gaps: the queue was full, {counted(dropped, 'entry', 'entries')} dropped"
            self._recorder.event(0.0, Event(Severity.WARNING, "record_dropped", text, {"dropped": dropped}))
        self._recorder.close(status, reason, speed_x=speed_x, dropped=dropped)
        self._send_status()

    def _flush(self) -> None:
        self._rounds += 1
        if self._rounds % FLUSHES_PER_TIMELINE == 0:
            self._recorder.flush()
        else:
            self._recorder.flush_files()
        self._send_status()

    def _send_status(self) -> None:
        status = (self._taken, self._recorder.health().errors)
        if status != self._sent_status:
            self._sent_status = status
            with contextlib.suppress(OSError):  # a controller that is stopped or gone reads nothing
                self._line.send(pickle.dumps(status), socket.MSG_DONTWAIT)


def main(descriptor: int) -> int:
    """Serve one controller, on the socket that it has handed to this process."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the record ends when the controller asks for it, or is gone
    with socket.socket(fileno=descriptor) as line:
        data = line.recv(MAX_MESSAGE)
        if not data:
            return 0
        try:
            recorder = pickle.loads(data)()  # noqa: S301 - from our own parent
        except Exception as error:  # noqa: BLE001 - whatever it is, the controller says it in one line
            line.send(pickle.dumps(f"{error}"))
            return 1
        line.send(pickle.dumps(None))
        _Writer(recorder, line).work()
    return 0


if __name__ == "__main__":
    # All files are closed. An orderly exit of the interpreter would still wait for a blocked terminal.
    os._exit(main(int(sys.argv[1])))
