"""A disk that fills up: files below one folder whose n-th operation, and those after it, fail with ENOSPC.

Each creation of a file, each write of its buffer and each fsync is one operation. Only Python's own files are reached;
what Rerun writes is tried on a real file system.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


class FailingDisk:
    """fails_from : the first operation that fails, counted from 1; None: none. only_once : those after it succeed."""

    def __init__(self, folder: Path, fails_from: int | None = None, *, only_once: bool = False) -> None:
        self.folder = folder.resolve()
        self.operations: list[str] = []
        self._fails_from = fails_from
        self._only_once = only_once
        self._open = io.open
        self._fsync = os.fsync
        self._open_files: weakref.WeakSet[_Raw] = weakref.WeakSet()

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Until the monkeypatch is undone."""
        for module in (io, builtins):
            monkeypatch.setattr(module, "open", self.open)
        monkeypatch.setattr(os, "fsync", self.fsync)

    def operate(self, name: str) -> None:
        """Count an operation; raise when the disk is full."""
        self.operations.append(name)
        count, first = len(self.operations), self._fails_from
        if first is not None and (count == first or (count > first and not self._only_once)):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def open(self, file: Any, mode: str = "r", buffering: int = -1, *more: Any, **options: Any) -> Any:
        """As `io.open`; files below the folder that are opened for writing are watched."""
        is_mine = isinstance(file, (str, Path)) and self.folder in Path(file).resolve().parents
        if not is_mine or not set(mode) & set("wxa+"):
            return self._open(file, mode, buffering, *more, **options)
        name = Path(file).name
        if not Path(file).exists():
            self.operate(f"create {name}")
        raw = _Raw(str(file), mode.replace("b", "").replace("t", ""), self.operate)
        self._open_files.add(raw)
        buffered: Any = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, *more, **options)

    def fsync(self, descriptor: int) -> None:
        """As `os.fsync`."""
        for raw in self._open_files:
            if not raw.closed and raw.fileno() == descriptor:
                self.operate(f"fsync {raw.file_name}")
        self._fsync(descriptor)


class _Raw(io.FileIO):
    def __init__(self, file: str, mode: str, operate: Callable[[str], None]) -> None:
        super().__init__(file, mode)
        self._operate = operate
        self.file_name = Path(file).name

    def write(self, data: Any) -> int:
        self._operate(f"write {self.file_name}")
        return super().write(data)
