"""The run as it goes on: the recording, served to viewers on this machine while the file is written.

A server in the recorder's process keeps what was recorded for viewers that come later, up to `MEMORY`; then it forgets
the oldest first. It listens on 127.0.0.1 only. A viewer that is missing, slow, stopped or killed is the server's
affair: nothing waits for it. Whatever goes wrong here ends the live picture, and nothing else.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress

import rerun as rr

from hil.core.types import Event
from hil.edge.record.record_format import Row
from hil.edge.record.recorder import Timeline
from hil.edge.record.rerun_log import RerunLog

HOST = "127.0.0.1"
MEMORY = "512MiB"
SEND_S = 0.5
"""What was gathered in this time is sent together: each send costs about 1 kB for each plot."""

LINGER_S = 1.0
"""For viewers to get the end of the run, before the server goes."""


def server_on(port: int) -> rr.GrpcServerSink:
    """A server for viewers on this machine."""
    return rr.GrpcServerSink(bind_ip=HOST, port=port, server_memory_limit=MEMORY)


class LiveLog:
    """A `Timeline` that passes everything to the file's timeline, and to the live one as long as that works.

    live : makes the live timeline; called at once.
    """

    def __init__(self, file: Timeline, live: Callable[[], RerunLog], clock_s: Callable[[], float] = time.monotonic):
        self._file, self._clock_s = file, clock_s
        self._live: RerunLog | None = live()
        self._send_at_s = clock_s()

    def tick(self, row: Row) -> None:
        """Take one step."""
        self._file.tick(row)
        if self._live is not None:
            self._try(lambda live: live.tick(row))
            self._send_if_due()

    def event(self, t_s: float, event: Event) -> None:
        """Take one event."""
        self._file.event(t_s, event)
        self._try(lambda live: live.event(t_s, event))

    def flush(self) -> None:
        """Write the file to the disk; raises when that fails."""
        self._file.flush()

    def close(self) -> None:
        """Send the rest, finalise the file, end the server."""
        self._try(lambda live: live.send())
        live, self._live = self._live, None
        try:
            self._file.close()
        finally:
            if live is not None:
                time.sleep(LINGER_S)
                with suppress(Exception):  # the run is over, and its file is closed
                    live.close()

    def _send_if_due(self) -> None:
        now_s = self._clock_s()
        if now_s >= self._send_at_s:
            self._send_at_s = now_s + SEND_S
            self._try(lambda live: live.send())

    def _try(self, call: Callable[[RerunLog], None]) -> None:
        if self._live is None:
            return
        try:
            call(self._live)
        except Exception as error:  # noqa: BLE001 - whatever Rerun raises: the run goes on, recorded as ever
            self._live = None
            with suppress(OSError):
                sys.stderr.write(f"hil: the live picture has ended, the record goes on: {error}\n")
