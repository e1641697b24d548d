"""The data of frames in the forms that files have: text, binary values."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hil.data.can_log import MAX_DATA, CanLog

DIGITS = np.frombuffer(b"0123456789ABCDEF", np.uint8)


def data_lengths(log: CanLog) -> npt.NDArray[np.intp]:
    """(n,) numbers of data bytes: 0 for a remote frame, whatever length it asks for."""
    return np.where(log.is_remote, 0, log.length).astype(np.intp)


def hex_texts(log: CanLog) -> npt.NDArray[np.str_]:
    """(n,) hexadecimal digits, two for each byte."""
    digits = np.empty((len(log), 2 * MAX_DATA), np.uint8)
    digits[:, ::2], digits[:, 1::2] = DIGITS[log.data >> 4], DIGITS[log.data & 15]
    digits[np.arange(2 * MAX_DATA) >= 2 * data_lengths(log)[:, None]] = 0
    return digits.view(f"S{2 * MAX_DATA}")[:, 0].astype(np.str_)


def binary_values(log: CanLog) -> Any:
    """A pyarrow array of binary values, each as long as the frame's data."""
    import pyarrow as pa

    lengths = data_lengths(log)
    content = log.data[np.arange(MAX_DATA) < lengths[:, None]]
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    buffers = [None, pa.py_buffer(offsets.tobytes()), pa.py_buffer(content.tobytes())]
    return pa.Array.from_buffers(pa.binary(), len(log), buffers)
