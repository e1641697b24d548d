"""The frames of a log as columns, in the order of the file, and single ones as messages for the decoder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import can
import numpy as np
import numpy.typing as npt

from hil.core.errors import HilError

EXTENDED, REMOTE, ERROR, FD = 1, 2, 4, 8
"""Flags of `FrameLog.kind`; 0 is a classic data frame with an 11-bit identifier, as all frames of the bench are."""

MAX_CHANNELS = 256
PAYLOAD = 8
"""Bytes that are kept of a frame."""


class ReplayError(HilError, ValueError):
    """A record that can't be replayed; the message names the file, the place and what is wrong."""


@dataclass(frozen=True, eq=False)
class FrameLog:
    """Frames as columns, (n,) each; data is (n, 8).

    time_ns : since the epoch. kind : flags, see above. length : bytes of payload. channel : index in `channels`, the
    names of the buses. doubts : what was wrong with the file.
    """

    time_ns: npt.NDArray[np.int64]
    arbitration_id: npt.NDArray[np.uint32]
    kind: npt.NDArray[np.uint8]
    length: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]
    channel: npt.NDArray[np.uint8]
    channels: tuple[str, ...] = ("can0",)
    doubts: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time_ns)

    def payload(self, row: int) -> bytes:
        """The data of one frame."""
        return self.data[row, : self.length[row]].tobytes()

    def message(self, row: int) -> can.Message:
        """One frame as the decoder takes it."""
        kind = int(self.kind[row])
        data = None if kind & REMOTE else bytearray(self.payload(row))
        return can.Message(
            arbitration_id=int(self.arbitration_id[row]),
            is_extended_id=bool(kind & EXTENDED),
            is_remote_frame=bool(kind & REMOTE),
            is_error_frame=bool(kind & ERROR),
            is_fd=bool(kind & FD),
            dlc=int(self.length[row]),
            data=data,
        )

    def rows_of(self, frame_id: int) -> npt.NDArray[np.int64]:
        """Rows of the plain frames with this identifier."""
        return np.flatnonzero((self.arbitration_id == frame_id) & (self.kind == 0))

    def rows_without(self, rows: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """All rows but these."""
        is_other = np.ones(len(self), np.bool_)
        is_other[rows] = False
        return np.flatnonzero(is_other)

    def has_same_frames(self, other: FrameLog) -> bool:
        """Whether both have the same frames, with the same times, in the same order."""
        names = ("time_ns", "arbitration_id", "kind", "length", "data")
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)

    def taken(self, rows: npt.NDArray[np.int64], *doubts: str) -> FrameLog:
        """These rows, with further doubts."""
        return FrameLog(
            self.time_ns[rows],
            self.arbitration_id[rows],
            self.kind[rows],
            self.length[rows],
            self.data[rows],
            self.channel[rows],
            self.channels,
            (*self.doubts, *doubts),
        )


Entry = tuple[int, int, int, bytes, str]
"""Time in ns, identifier, flags, payload, channel."""


def frame_log(entries: Iterable[Entry], doubts: tuple[str, ...] = ()) -> FrameLog:
    """Columns of frames that come one by one."""
    times, ids, kinds, lengths, payload = [], [], bytearray(), bytearray(), bytearray()
    names: dict[str, int] = {}
    channels = bytearray()
    for time_ns, frame_id, kind, data, channel in entries:
        channels.append(min(names.setdefault(channel, len(names)), MAX_CHANNELS - 1))
        times.append(time_ns)
        ids.append(frame_id)
        kinds.append(kind)
        kept = data[:PAYLOAD]
        lengths.append(len(kept))
        payload += kept.ljust(PAYLOAD, b"\0")
    return FrameLog(
        np.array(times, dtype=np.int64),
        np.array(ids, dtype=np.uint32),
        np.frombuffer(kinds, dtype=np.uint8),
        np.frombuffer(lengths, dtype=np.uint8),
        np.frombuffer(payload, dtype=np.uint8).reshape(-1, PAYLOAD),
        np.frombuffer(channels, dtype=np.uint8),
        tuple(names),
        doubts,
    )
