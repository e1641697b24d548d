"""How a run is written down: the columns of ticks.csv, the lines of can.log and events.jsonl."""

from __future__ import annotations

import json
import math
from typing import Any

import can

from hil.core.types import Event, Quad, TickRecord

_NO_LEVELS: Quad = (math.nan, math.nan, math.nan, math.nan)


def _numbered(name: str, count: int) -> tuple[str, ...]:
    return tuple(name.format(i + 1) for i in range(count))


TRUTH_COLUMNS = _numbered("true_h{}_cm", 4)
COLUMNS = (
    "t_s", "mode",
    *_numbered("h{}_V", 4), *_numbered("h{}_est_V", 4),
    *_numbered("r{}_V", 2), *_numbered("target{}_V", 2),
    *_numbered("v{}_operating_V", 2), *_numbered("v{}_raw_V", 2),
    *_numbered("v{}_V", 2), *_numbered("v{}_applied_V", 2),
    *_numbered("theta{}", 2), *_numbered("q{}_Vs", 2),
    *_numbered("K1{}", 6), *_numbered("K2{}", 6), *_numbered("iae{}_Vs", 2),
    "levels_age_s", "status_age_s", "lateness_s", "skipped", "accepted", "rejected",
    *TRUTH_COLUMNS,
)  # fmt: skip
N_TRUTH = len(TRUTH_COLUMNS)
_INTEGERS = frozenset({"mode", "skipped", "accepted", "rejected"})
_NINE_DIGITS = frozenset({"t_s", *_numbered("h{}_V", 4), *_numbered("h{}_est_V", 4), *TRUTH_COLUMNS})


def _number_format(column: str) -> str:
    return "%d" if column in _INTEGERS else "%.9g" if column in _NINE_DIGITS else "%.6g"


KNOWN_LINE = ",".join(_number_format(column) for column in COLUMNS) + "\n"
UNKNOWN_LINE = ",".join(_number_format(column) for column in COLUMNS[:-N_TRUTH]) + "," * N_TRUTH + "\n"

Row = tuple[float, ...]


def tick_row(record: TickRecord, true_level_cm: Quad | None = None) -> Row:
    """The step as a flat row in the order of COLUMNS."""
    return (
        record.t_s, record.mode,
        *record.measured_V, *record.estimated_V, *record.reference_V, *record.target_V,
        *record.operating_V, *record.raw_V, *record.command_V, *record.applied_V,
        *record.effectiveness, *record.integral_Vs, *record.gain, *record.iae_Vs,
        record.levels_age_s, record.status_age_s, record.lateness_s, record.skipped, record.accepted, record.rejected,
        *(true_level_cm or _NO_LEVELS),
    )  # fmt: skip


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
