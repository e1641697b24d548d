"""A folder with a file for each table: Parquet with units in the fields' metadata, or CSV with a list of the units."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.export.export_tables import ExportColumn, ExportTable, RunTables
from hil.export.frame_data import binary_values, hex_texts

if TYPE_CHECKING:
    import pyarrow as pa

SIGNALS = "signals"
"""The folder of the messages' tables."""
DATA = ExportColumn("data", np.empty(0), "", "bytes of the frame")
DATA_AS_TEXT = ExportColumn("data", np.empty(0), "", "bytes of the frame, two hexadecimal digits each")


def write_parquet(run: RunTables, out: Path) -> None:
    """ticks, events, frames and signals/MESSAGE, each .parquet.

    A field's metadata has `unit`, `meaning` and, for states, `choices` (JSON, number -> name); the file's has what the
    run was, and `PANDAS_ATTRS`, from which pandas fills `attrs`: `attrs["units"]` there.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    for name, table, columns in _tables(run, DATA, binary_values(run.frames)):
        fields = [pa.field(c.name, values.type, metadata=_metadata(c)) for c, values in columns]
        attributes = {"units": {c.name: c.unit for c, _ in columns}, **run.description}
        schema = pa.schema(fields, {**run.description, "PANDAS_ATTRS": json.dumps(attributes)})
        path = _path(out, name, table, ".parquet")
        pq.write_table(pa.Table.from_arrays([values for _, values in columns], schema=schema), path, compression="zstd")


def write_csv(run: RunTables, out: Path) -> None:
    """The same tables as .csv, and units.csv with the unit and the meaning of each column. NaN is an empty cell.

    A second head line with units would make text of all numbers for pandas, polars, R and MATLAB.
    """
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    units: list[dict[str, str]] = []
    for name, table, columns in _tables(run, DATA_AS_TEXT, pa.array(hex_texts(run.frames))):
        path = _path(out, name, table, ".csv")
        pa_csv.write_csv(pa.Table.from_arrays([v for _, v in columns], names=[c.name for c, _ in columns]), path)
        units += [
            {
                "file": path.relative_to(out).as_posix(),
                "column": c.name,
                "unit": c.unit,
                "meaning": c.meaning,
                "choices": _choices(c),
            }
            for c, _ in columns
        ]
    pa_csv.write_csv(pa.Table.from_pylist(units), out / "units.csv")


Columns = list[tuple[ExportColumn, Any]]


def _tables(run: RunTables, data: ExportColumn, values: pa.Array) -> Iterator[tuple[str, ExportTable, Columns]]:
    """Folder, table and its columns as pyarrow arrays. values : the frames' data."""
    yield "", (ticks := run.control_steps()), _arrays(ticks)
    yield "", (events := run.events()), _arrays(events)
    yield "", (frames := run.frame_columns()), [*_arrays(frames), (data, values)]
    for table in run.messages():
        yield SIGNALS, table, _arrays(table)


def _arrays(table: ExportTable) -> Columns:
    import pyarrow as pa

    kinds = {"O": pa.string()}
    return [(c, pa.array(c.values, kinds.get(c.values.dtype.kind), from_pandas=True)) for c in table.columns]


def _path(out: Path, folder: str, table: ExportTable, suffix: str) -> Path:
    (out / folder).mkdir(parents=True, exist_ok=True)
    return out / folder / f"{table.name}{suffix}"


def _metadata(column: ExportColumn) -> dict[str, str]:
    choices = {"choices": _choices(column)} if column.choices else {}
    return {"unit": column.unit, "meaning": column.meaning, **choices}


def _choices(column: ExportColumn) -> str:
    return json.dumps({str(number): text for number, text in column.choices.items()}) if column.choices else ""
