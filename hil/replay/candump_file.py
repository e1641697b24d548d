"""Reads the log of a run folder, or any that `candump -L` writes, plain or compressed, in the order of its lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.data.can_log import CanLog, read_can_log
from hil.edge.record.log_file import find_log
from hil.replay.frame_log import ERROR, EXTENDED, REMOTE, FrameLog


def read_candump(path: Path) -> FrameLog:
    """Raises RunFolderError; for a line that is no frame, a DamagedLogError that names it.

    A half line at the end is left out, and said.
    """
    return frames_of(read_can_log(path), _end(find_log(path)))


def frames_of(log: CanLog, doubts: tuple[str, ...] = ()) -> FrameLog:
    """The columns that a replay needs; times to the microsecond that the text has."""
    kind = EXTENDED * (log.is_extended & ~log.is_error) + REMOTE * log.is_remote + ERROR * log.is_error
    micros = np.rint(log.time_s * 1e6).astype(np.int64)
    return FrameLog(
        micros * 1000,
        log.arbitration_id,
        kind.astype(np.uint8),
        log.length,
        log.data,
        log.channel,
        log.channels,
        doubts,
    )


def _end(path: Path) -> tuple[str, ...]:
    """What to say of a file that ends in the middle of a line."""
    if path.suffix in (".gz", ".zst") or path.stat().st_size == 0:
        return ()
    with path.open("rb") as stream:
        stream.seek(-1, 2)
        is_whole = stream.read(1) == b"\n"
    return () if is_whole else (f"{path.name} ends in the middle of a line, which is left out",)
