"""Tables of a run as pandas data frames: run time as the index, units in `attrs["units"]` (column -> unit).

Units are those of the record: of the signal table for control steps, of the DBC for decoded frames; "" for counts,
numbers of states, names and what has none. Nothing is rounded, resampled or left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.data.can_log import CanLog
from hil.edge.record.run_folder import RunMode
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


def frames_table(log: CanLog, zero_s: float, names: Mapping[int, str]) -> DataFrame:
    """One row for each frame: identifier, message (by the DBC), length, data as bytes, kind.

    zero_s : time since the epoch at run time 0. names : identifier of 11 bits -> message. Data bytes are one Arrow
    array, so that a million frames take 30 MB.
    """
    import pandas as pd

    known = sorted(names)
    places = np.searchsorted(known, log.arbitration_id) if known else np.zeros(len(log), dtype=np.int64)
    places = np.minimum(places, max(len(known) - 1, 0))
    is_known = np.array(known, dtype=np.uint32)[places] == log.arbitration_id if known else np.zeros(len(log), bool)
    codes = np.where(is_known & ~log.is_extended & ~log.is_error, places, -1).astype(np.int16)
    kinds = np.where(log.is_error, 3, np.where(log.is_remote, 2, log.is_extended.astype(np.int8))).astype(np.int8)
    columns: dict[str, Any] = {
        TIME: log.time_s - zero_s,
        "channel": pd.Categorical.from_codes(log.channel.astype(np.int16), categories=list(log.channels)),
        "arbitration_id": log.arbitration_id,
        "message": pd.Categorical.from_codes(codes, categories=[names[one] for one in known]),
        "kind": pd.Categorical.from_codes(kinds, categories=["data", "extended", "remote", "error"]),
        "length": log.length,
        "data": _payloads(log),
    }
    return indexed(columns, {TIME: "s", "length": "byte"})


def message_table(table: MessageTable, zero_s: float) -> DataFrame:
    """The signals of one message, a row for each of its frames."""
    return indexed({TIME: table.time_s - zero_s, **table.columns}, {TIME: "s", **table.units})


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


def _payloads(log: CanLog) -> Any:
    """The data of the frames, each as long as its frame says; remote and error frames have none of their own."""
    import pandas as pd
    import pyarrow as pa

    length = np.where(log.is_remote, 0, log.length).astype(np.int32)
    offsets = np.zeros(len(log) + 1, dtype=np.int32)
    np.cumsum(length, out=offsets[1:])
    if len(log) and bool((length == log.data.shape[1]).all()):
        data = np.ascontiguousarray(log.data)
    else:
        data = log.data[np.arange(log.data.shape[1]) < length[:, None]]
    array = pa.Array.from_buffers(pa.binary(), len(log), [None, pa.py_buffer(offsets), pa.py_buffer(data)])
    return pd.arrays.ArrowExtensionArray(array)


def _objects(values: Iterable[Any]) -> Any:
    """Python objects as a column, each as it is: tuples and dicts too."""
    listed = list(values)
    column = np.empty(len(listed), dtype=object)
    for place, value in enumerate(listed):
        column[place] = value
    return column
