"""How a run is written down: the columns of ticks.csv, the lines of can.log and events.jsonl.

What a run can't know is an empty cell: true levels live, and in lockstep how the loop kept time.

    latency_s        from the arrival of the newest frame that a step could use to the moment its command was sent
    recorder_queue   entries of the record that were on their way to the files when the step ended
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from hil.core.types import Event, Quad, TickRecord

if TYPE_CHECKING:  # it takes longer to import than all the rest of the recorder's process
    import can

_NO_LEVELS: Quad = (math.nan, math.nan, math.nan, math.nan)


def _numbered(name: str, count: int) -> tuple[str, ...]:
    return tuple(name.format(i + 1) for i in range(count))


TRUTH_COLUMNS = _numbered("true_h{}_cm", 4)
TIMING_COLUMNS = ("latency_s", "recorder_queue")
COLUMNS = (
    "t_s", "mode",
    *_numbered("h{}_V", 4), *_numbered("h{}_est_V", 4),
    *_numbered("r{}_V", 2), *_numbered("target{}_V", 2),
    *_numbered("v{}_operating_V", 2), *_numbered("v{}_raw_V", 2),
    *_numbered("v{}_V", 2), *_numbered("v{}_applied_V", 2),
    *_numbered("theta{}", 2), *_numbered("q{}_Vs", 2),
    *_numbered("K1{}", 6), *_numbered("K2{}", 6), *_numbered("iae{}_Vs", 2),
    "levels_age_s", "status_age_s", "lateness_s", "skipped", "accepted", "rejected",
    *TRUTH_COLUMNS, *TIMING_COLUMNS,
)  # fmt: skip
_N_TRUTH, _N_TIMING = len(TRUTH_COLUMNS), len(TIMING_COLUMNS)
_N_STEP = len(COLUMNS) - _N_TRUTH - _N_TIMING
_INTEGERS = frozenset({"mode", "skipped", "accepted", "rejected", "recorder_queue"})
_NINE_DIGITS = frozenset({"t_s", *_numbered("h{}_V", 4), *_numbered("h{}_est_V", 4), *TRUTH_COLUMNS})


def _number_format(column: str) -> str:
    return "%d" if column in _INTEGERS else "%.9g" if column in _NINE_DIGITS else "%.6g"


def _formats(columns: tuple[str, ...]) -> str:
    return ",".join(_number_format(column) for column in columns)


_LOCKSTEP_LINE = _formats(COLUMNS[:-_N_TIMING]) + "," * _N_TIMING + "\n"
_LIVE_LINE = _formats(COLUMNS[:_N_STEP]) + "," * _N_TRUTH + "," + _formats(TIMING_COLUMNS) + "\n"

Row = tuple[float, ...]


def tick_row(
    record: TickRecord, true_level_cm: Quad | None = None, latency_s: float = math.nan, queue: float = math.nan
) -> Row:
    """The step as a flat row in the order of COLUMNS."""
    return (
        record.t_s, record.mode,
        *record.measured_V, *record.estimated_V, *record.reference_V, *record.target_V,
        *record.operating_V, *record.raw_V, *record.command_V, *record.applied_V,
        *record.effectiveness, *record.integral_Vs, *record.gain, *record.iae_Vs,
        record.levels_age_s, record.status_age_s, record.lateness_s, record.skipped, record.accepted, record.rejected,
        *(true_level_cm or _NO_LEVELS), latency_s, queue,
    )  # fmt: skip


def tick_line(row: Row, is_live: bool) -> str:
    """The row as a line of ticks.csv, without what this kind of run can't know."""
    if is_live:
        return _LIVE_LINE % (*row[:_N_STEP], *row[-_N_TIMING:])
    return _LOCKSTEP_LINE % row[:-_N_TIMING]


def frame_line(timestamp_s: float, channel: str, message: can.Message) -> str:
    """Any message in candump's format, the odd kinds too: extended, remote, error."""
    direction = "R" if message.is_rx else "T"
    if message.is_error_frame:
        return f"({timestamp_s:.6f}) {channel} 20000080#\n"  # candump's mark of an error frame has no direction
    frame_id = f"{message.arbitration_id:08X}" if message.is_extended_id else f"{message.arbitration_id:03X}"
    content = f"R{message.dlc}" if message.is_remote_frame else message.data.hex().upper()
    return f"({timestamp_s:.6f}) {channel} {frame_id}#{content} {direction}\n"


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
