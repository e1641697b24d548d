"""Reads a log of a bus, whoever recorded it: candump, BLF, ASC, MF4 and what else python-can reads."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterable, Iterator
from importlib import import_module, reload
from importlib.util import find_spec
from pathlib import Path
from traceback import clear_frames
from types import ModuleType

import can
import numpy as np
from can.io.generic import MessageReader

from hil.core.counted import counted
from hil.edge.record.log_file import COMPRESSIONS
from hil.lean_start import LOADER
from hil.replay.candump_file import read_candump
from hil.replay.frame_log import ERROR, EXTENDED, FD, REMOTE, Entry, FrameLog, ReplayError, frame_log

CANDUMP = (".log", ".candump", "")
READ = (".asc", ".blf", ".mf4", ".trc", ".csv", ".db")
"""Suffixes that python-can's readers know."""


def read_log(path: Path) -> FrameLog:
    """The frames of a log in the order of their times. Raises ReplayError, RunFolderError.

    What can be read of a damaged file is kept, and its end is said.
    """
    if not path.is_file():
        raise ReplayError(f"{path}: there is no such log, nor a run folder of that name")
    suffix = path.suffix.lower()
    if suffix.lstrip(".") in COMPRESSIONS:
        suffix = Path(path.stem).suffix.lower()
    if suffix in CANDUMP:
        log = read_candump(path)
    elif path.suffix.lower() in READ:
        log = _read_with_reader(path)
    else:
        raise ReplayError(f"{path}: {path.suffix} is no log that can be read; known are .log and {', '.join(READ)}")
    if not len(log):
        raise ReplayError(f"{path}: there is no frame in this log")
    return _in_order(path, log)


def _read_with_reader(path: Path) -> FrameLog:
    entries: list[Entry] = []
    doubts: tuple[str, ...] = ()
    try:
        with _reader(path) as reader:
            size = getattr(reader, "file_size", None)
            entries.extend(_entries(reader))
        if isinstance(size, int) and size > path.stat().st_size:  # BLF: its reader ends without a word
            doubts = (f"{path.name} is cut off: it was {size} bytes, it is {path.stat().st_size}",)
    except ReplayError:
        raise
    except Exception as error:  # noqa: BLE001 - the readers raise what they meet, of many kinds, on a damaged file
        what = " ".join(str(error).split())[:200] or type(error).__name__
        _discard(error)
        if not entries:
            raise ReplayError(f"{path} can't be read as {path.suffix[1:].upper()}: {what}") from None
        doubts = (f"{path.name} can be read up to its frame {len(entries)}, then: {what}",)
    return frame_log(entries, doubts)


def _discard(error: Exception) -> None:
    """Remove what a reader had opened; asammdf's then fails a second time, which Python would show as a traceback."""
    shown, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        clear_frames(error.__traceback__)
        error.__traceback__ = error.__context__ = error.__cause__ = None
        gc.collect()
    finally:
        sys.unraisablehook = shown


def _reader(path: Path) -> MessageReader:
    """Raises ReplayError for MF4 without asammdf."""
    if path.suffix.lower() != ".mf4":
        return can.LogReader(path)
    if find_spec("asammdf") is None:
        raise ReplayError(f"{path}: MF4 needs asammdf, which is not installed: pip install 'fourtank-hil[mf4]'")
    reader: MessageReader = mf4_module().MF4Reader(path)
    return reader


def mf4_module() -> ModuleType:
    """python-can's module for MF4, with asammdf, which `hil.lean_start` keeps out of its first import."""
    return reload(import_module(LOADER))


def _entries(reader: Iterable[can.Message]) -> Iterator[Entry]:
    for message in reader:
        kind = EXTENDED * (message.is_extended_id and not message.is_error_frame) + REMOTE * message.is_remote_frame
        kind += ERROR * message.is_error_frame + FD * message.is_fd
        yield round(message.timestamp * 1e9), message.arbitration_id, kind, bytes(message.data), str(message.channel)


def _in_order(path: Path, log: FrameLog) -> FrameLog:
    """Sorted by time; frames of equal times keep their order."""
    late = int((np.diff(log.time_ns) < 0).sum())
    if not late:
        return log
    order = np.argsort(log.time_ns, kind="stable")
    return log.taken(
        order, f"{path.name} is not in the order of time ({counted(late, 'frame')} earlier than the one before): sorted"
    )
