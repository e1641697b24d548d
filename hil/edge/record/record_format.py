"""How a run is written: the lines of ticks.csv, can.log and events.jsonl.

ticks.csv has the columns of `hil.edge.record.signals` that this kind of run has. Every column is a number from its
first line to its last: `3.00000`, not `3`, where it is a float, and `NaN` where a step has no value.

can.log and sent.log have the lines that `candump -L` writes, with times in s since the epoch. They have no mark of the
direction, since Wireshark 4.0 reads no line that has one: all frames are in can.log, those that the controller sent are
in sent.log, too.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hil.core.types import Event
from hil.edge.record.signals import Signal, Step

if TYPE_CHECKING:  # it takes longer to import than all the rest of the recorder's process
    import can

Row = tuple[float, ...]

ERROR_FRAME = "20000080#" + 8 * "00"
"""As candump writes a bus error that it knows no more of."""


class TickFormat:
    """The table of the given signals: its header, and its rows as numbers and as lines."""

    def __init__(self, signals: Sequence[Signal]) -> None:
        self.columns = tuple(signal.column for signal in signals)
        self.header = ",".join(self.columns) + "\n"
        self._sources = tuple(signal.source for signal in signals)
        self._line = ",".join(signal.number_format for signal in signals) + "\n"

    def row(self, step: Step) -> Row:
        """The step's values in the order of the columns."""
        return tuple([source(step) for source in self._sources])

    def line(self, row: Row) -> str:
        """The row as a line of ticks.csv. `NaN` is the spelling that polars, R, MATLAB and numpy all read."""
        return (self._line % row).replace("nan", "NaN")


def frame_line(timestamp_s: float, channel: str, message: can.Message) -> str:
    """Any message as `candump -L` writes it: data, extended, remote or error frame. timestamp_s : since the epoch."""
    if message.is_error_frame:
        return f"({timestamp_s:.6f}) {channel} {ERROR_FRAME}\n"
    frame_id = f"{message.arbitration_id:08X}" if message.is_extended_id else f"{message.arbitration_id:03X}"
    content = f"R{message.dlc}" if message.is_remote_frame else message.data.hex().upper()
    return f"({timestamp_s:.6f}) {channel} {frame_id}#{content}\n"


def event_line(t_s: float, event: Event) -> str:
    """The event as one line of JSON; numbers that JSON does not know (NaN, inf) become null."""
    entry = {
        "t_s": round(t_s, 9),
        "severity": str(event.severity),
        "code": event.code,
        "text": event.text,
        "data": event.data,
    }
    try:
        return json.dumps(entry, ensure_ascii=False, allow_nan=False) + "\n"
    except (TypeError, ValueError):
        return json.dumps(_plain(entry), ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy
        return _plain(value.tolist())
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
