"""The process of a run, as a way to stop it when its control channel does not answer: SIGTERM, an orderly stop."""

from __future__ import annotations

import os
import signal
from pathlib import Path

PROC = Path("/proc")
START_TIME = 19
"""Place of the start time among the fields of /proc/PID/stat that follow the program's name (man 5 proc)."""


class RunProcess:
    """Remembers which process a run is, so that a later one with the same number is never signalled."""

    def __init__(self) -> None:
        self._pid, self._started = 0, ""

    def note(self, pid: int, started: str | None = None) -> None:
        """The run has said that this is its process. started : as by `start_time`; None: the one that is there now."""
        self._pid, self._started = pid, start_time(pid) if started is None else started

    @property
    def is_alive(self) -> bool:
        """Whether that process is still there."""
        return self._pid > 1 and self._started != "" and start_time(self._pid) == self._started

    def terminate(self) -> bool:
        """Send SIGTERM. False when the process is not there, or not this user's."""
        if not self.is_alive:
            return False
        try:
            os.kill(self._pid, signal.SIGTERM)
        except OSError:
            return False
        return True


def start_time(pid: int) -> str:
    """When a process started, in ticks since boot; "" when there is none."""
    try:
        fields = (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
        return "" if fields[0] == "Z" else fields[START_TIME]
    except (OSError, IndexError):
        return ""
