"""Where a run can be reached: its socket and its entry in the list of running runs, made again when they were removed.

A run folder that is removed takes the socket with it, and programs that tidy temporary folders up remove what is old.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from hil.edge.control.socket_path import ControlError, RunningRun, announce, listen, made_runtime_dir

Identity = tuple[int, int] | None
"""Device and inode; None for a file that is not there."""


class ListeningPlace:
    """The place of one run. Raises ControlError when nothing can listen there."""

    def __init__(self, path: Path, run: RunningRun) -> None:
        self.listener = listen(path)
        self._run = run
        self._path, self._socket = path, _identity(path)
        self._entry: Path | None = None
        self._announce()

    def renew(self) -> socket.socket | None:
        """The new listener where the old one can't be reached any more; None if there is nothing to do or no way."""
        if self._socket == _identity(self._path):
            if self._entry is not None and not self._entry.exists():
                self._announce()
            return None
        for path in (self._path, *_elsewhere(self._run.pid)):
            try:
                listener = listen(path)
            except ControlError:
                continue
            self.listener = listener
            self._path, self._socket = path, _identity(path)
            self._announce()
            return listener
        return None

    def remove(self) -> None:
        """Leave nothing behind, and nothing of another run alone."""
        if self._socket is not None and self._socket == _identity(self._path):
            with suppress(OSError):
                self._path.unlink()
        if self._entry is not None:
            with suppress(OSError):
                self._entry.unlink()

    def _announce(self) -> None:
        with suppress(Exception):  # then it is found by its folder alone
            self._entry = announce(replace(self._run, socket=str(self._path)))


def _elsewhere(pid: int) -> tuple[Path, ...]:
    try:
        return (made_runtime_dir() / f"{pid}.sock",)
    except ControlError:
        return ()


def _identity(path: Path) -> Identity:
    try:
        found = os.lstat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino
