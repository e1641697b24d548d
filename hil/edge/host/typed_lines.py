"""Lines that are typed while the program does something else: nothing here waits."""

from __future__ import annotations

import os
import select
import sys


class TypedLines:
    """Lines of a file descriptor: a terminal, a pipe or a file. fd : standard input by default."""

    def __init__(self, fd: int | None = None) -> None:
        self._fd = sys.stdin.fileno() if fd is None else fd
        self._begun = b""
        self._lines: list[str] = []
        self._has_ended = False

    def next(self) -> str | None:
        """The next line without its end, None if there is none yet. Raises EOFError after the last one."""
        while not self._lines and not self._has_ended and select.select([self._fd], [], [], 0.0)[0]:
            self._read()
        if self._lines:
            return self._lines.pop(0)
        if self._has_ended:
            raise EOFError
        return None

    def _read(self) -> None:
        data = os.read(self._fd, 4096)
        *whole, self._begun = (self._begun + data).split(b"\n")
        if not data:
            self._has_ended = True
            whole, self._begun = ([self._begun] if self._begun else []), b""
        self._lines += [line.decode("utf-8", errors="replace") for line in whole]
