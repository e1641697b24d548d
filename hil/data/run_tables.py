"""Tables of a run as pandas data frames: run time as the index, units in `attrs["units"]` (column -> unit).

Units are those of the record: of the signal table for control steps, of the DBC for decoded frames; "" for counts,
numbers of states, names and what has none. Nothing is rounded, resampled or left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.data.can_log import CanLog, joined
from hil.edge.record.manifest import RunMode, Window
from hil.edge.record.signals import Signal, recorded
from hil.review.alarms import Finding
from hil.review.ticks import LoggedEvent, Ticks

if TYPE_CHECKING:
    from pandas import DataFrame, Series

    from hil.data.decode import MessageTable

TIME = "t_s"


def signals_of(mode: RunMode, shown: Sequence[str]) -> Mapping[str, Signal]:
    """Column of ticks.csv -> the signal in it."""
    return {signal.column: signal for signal in recorded(mode, shown)}


def indexed(columns: Mapping[str, Any], units: Mapping[str, str]) -> DataFrame:
    """A data frame whose index is the column `t_s`, without a copy of the columns; units : of any of them."""
    import pandas as pd

    index = pd.Index(columns[TIME], name=TIME)
    table = pd.DataFrame({name: values for name, values in columns.items() if name != TIME}, index=index, copy=False)
    return with_units(table, units)


def with_units(table: DataFrame, units: Mapping[str, str]) -> DataFrame:
    """The same table, which says the unit of each column and of its index."""
    names = [*filter(None, [table.index.name]), *table.columns]
    table.attrs["units"] = {str(name): units.get(str(name), "") for name in names}
    return table


def ticks_table(ticks: Ticks, signals: Mapping[str, Signal]) -> DataFrame:
    """One row for each control step. Counts and numbers of states are whole numbers where all of them are known."""
    columns: dict[str, Any] = {}
    for name, values in ticks.columns.items():
        is_whole = name in signals and signals[name].digits is None and bool(np.isfinite(values).all())
        columns[name] = values.astype(np.int64) if is_whole else values
    return indexed(columns, {name: signal.unit for name, signal in signals.items()})


def events_table(events: Iterable[LoggedEvent]) -> DataFrame:
    """One row for each event: severity, code, text, and its data as a dict."""
    listed = list(events)
    names = ("severity", "code", "text", "data")
    columns: dict[str, Any] = {name: _objects(getattr(event, name) for event in listed) for name in names}
    return indexed({TIME: np.array([event.t_s for event in listed], dtype=float), **columns}, {TIME: "s"})


def alarms_table(findings: Sequence[Finding]) -> DataFrame:
    """One row for each reported fault, the columns of `hil.Finding`; NaN for a time or size that is not known."""
    import pandas as pd

    rows = [asdict(finding) for finding in findings]
    columns: dict[str, Any] = {}
    for field in fields(Finding):
        values = [row[field.name] for row in rows]
        is_number = field.name.endswith("_s") or field.name in ("size", "size_std")
        columns[field.name] = np.array(values, dtype=float) if is_number else _objects(values)
    return with_units(pd.DataFrame(columns), {name: "s" for name in columns if name.endswith("_s")})


def columns_table(names: Sequence[str], signals: Mapping[str, Signal]) -> DataFrame:
    """One row for each column of ticks.csv, by its name: unit and meaning, "" where neither is known."""
    import pandas as pd

    rows = [(signals[name].unit, signals[name].meaning) if name in signals else ("", "") for name in names]
    return pd.DataFrame(rows, columns=["unit", "meaning"], index=pd.Index(names, name="column"))


def windows_table(windows: Sequence[Window], figures: Mapping[str, Any]) -> DataFrame:
    """One row for each window, by its name: from_s, to_s, covered_s, the IAE of outputs 1 and 2; NaN if not reached.

    figures : as in kpi.json.
    """
    import pandas as pd

    rows: dict[str, list[Any]] = {key: [] for key in ("from_s", "to_s", "covered_s", "iae1_Vs", "iae2_Vs")}
    for window in windows:
        covered_s = float(figures.get("iae_covered_s", {}).get(window.name, 0.0))
        pair = figures.get("iae_Vs", {}).get(window.name) if covered_s > 0.0 else None
        values = (window.from_s, window.to_s, covered_s, *(pair or (nan, nan)))
        for column, value in zip(rows.values(), values, strict=True):
            column.append(value)
    index = pd.Index([window.name for window in windows], name="window", dtype=object)
    units = {name: "s" if name.endswith("_s") else "V s" for name in rows}
    return with_units(pd.DataFrame(rows, index=index, dtype=float), units)


def frames_table(blocks: Iterable[CanLog], zero_s: float, names: Mapping[int, str]) -> DataFrame:
    """One row for each frame: identifier, message (by the DBC), length, data as bytes, kind.

    blocks : of one log, in its order. zero_s : time since the epoch at run time 0. names : identifier of 11 bits ->
    message. A frame takes 30 bytes.
    """
    import pandas as pd

    known = sorted(names)
    channels: tuple[str, ...] = ()
    pieces: list[dict[str, Any]] = []
    for block in blocks:
        channels = block.channels
        pieces.append(_frame_columns(block, zero_s, np.array(known, dtype=np.uint32)))
    columns = _joined(pieces or [_frame_columns(joined(()), zero_s, np.array(known, dtype=np.uint32))])
    categories = {
        "channel": list(channels),
        "message": [names[one] for one in known],
        "kind": ["data", "extended", "remote", "error"],
    }
    for name, of in categories.items():
        columns[name] = pd.Categorical.from_codes(columns[name], categories=of)
    columns["data"] = _payloads(columns.pop("carried"), columns["data"])
    return indexed(columns, {TIME: "s", "length": "byte"})


def _frame_columns(log: CanLog, zero_s: float, known: Any) -> dict[str, Any]:
    """Columns of some frames as numbers. data : of all, one after the other; carried : how many bytes of each."""
    places = np.minimum(np.searchsorted(known, log.arbitration_id), max(len(known) - 1, 0))
    is_known = known[places] == log.arbitration_id if len(known) else np.zeros(len(log), dtype=bool)
    carried = np.where(log.is_remote, 0, log.length).astype(np.uint8)
    return {
        TIME: log.time_s - zero_s,
        "channel": log.channel.astype(np.int16),
        "arbitration_id": log.arbitration_id,
        "message": np.where(is_known & ~log.is_extended & ~log.is_error, places, -1).astype(np.int16),
        "kind": np.where(log.is_error, 3, np.where(log.is_remote, 2, log.is_extended)).astype(np.int8),
        "length": log.length,
        "carried": carried,
        "data": log.data[np.arange(log.data.shape[1]) < carried[:, None]],
    }


def _joined(pieces: list[dict[str, Any]]) -> dict[str, Any]:
    """The pieces one after the other, column by column, so that there is never a second copy of all of them."""
    return {name: np.concatenate([piece.pop(name) for piece in pieces]) for name in list(pieces[0])}


def message_table(tables: Iterable[MessageTable], zero_s: float) -> DataFrame:
    """The signals of one message, a row for each of its frames. tables : of the blocks of one log, at least one."""
    pieces: list[dict[str, Any]] = []
    units: Mapping[str, str] = {}
    for table in tables:
        units = table.units
        pieces.append({TIME: table.time_s - zero_s, **table.columns})
    return indexed(_joined(pieces), {TIME: "s", **units})


def flat(values: Mapping[str, Any], name: str) -> Series:
    """Nested values as a series whose index are their paths, such as `iae_Vs.gain_fall[0]`."""
    import pandas as pd

    paths = dict(_paths(values, ""))
    return pd.Series(_objects(paths.values()), index=pd.Index(list(paths), dtype=object), name=name, dtype=object)


def _paths(value: Any, path: str) -> Iterable[tuple[str, Any]]:
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _paths(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple) and value:
        for place, item in enumerate(value):
            yield from _paths(item, f"{path}[{place}]")
    elif path:
        yield path, value


def _payloads(length: Any, data: Any) -> Any:
    """Bytes of each frame as a column. length : (n,), of each. data : (sum of length,), one after the other."""
    import pandas as pd
    import pyarrow as pa

    offsets = np.zeros(len(length) + 1, dtype=np.int32)
    np.cumsum(length, out=offsets[1:])
    array = pa.Array.from_buffers(pa.binary(), len(length), [None, pa.py_buffer(offsets), pa.py_buffer(data)])
    return pd.arrays.ArrowExtensionArray(array)


def _objects(values: Iterable[Any]) -> Any:
    """Python objects as a column, each as it is: tuples and dicts too."""
    listed = list(values)
    column = np.empty(len(listed), dtype=object)
    for place, value in enumerate(listed):
        column[place] = value
    return column
