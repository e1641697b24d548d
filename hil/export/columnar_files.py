"""A folder with a file for each table: Parquet with units in the fields' metadata, or CSV with a list of the units.

Tables are written a stretch of rows at a time, so that a long run needs little memory.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.export.export_tables import ExportColumn, ExportTable, FramePiece, RunTables
from hil.export.frame_data import binary_values, hex_texts

if TYPE_CHECKING:
    import pyarrow as pa

SIGNALS = "signals"
"""The folder of the messages' tables."""
DATA = ExportColumn("data", np.empty(0), "", "bytes of the frame")
DATA_AS_TEXT = ExportColumn("data", np.empty(0), "", "bytes of the frame, two hexadecimal digits each")

Columns = list[tuple[ExportColumn, Any]]
Pieces = Iterator[tuple[str, Columns]]
"""Path of a table without its suffix, and a stretch of its columns as pyarrow arrays."""


def write_parquet(run: RunTables, out: Path) -> None:
    """ticks, events, frames and signals/MESSAGE, each .parquet.

    A field's metadata has `unit`, `meaning` and, for states, `choices` (JSON, number -> name); the file's has what the
    run was, and `PANDAS_ATTRS`, from which pandas fills `attrs`: `attrs["units"]` there.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    writers: dict[str, pq.ParquetWriter] = {}
    with ExitStack() as stack:
        for name, columns in _pieces(run, DATA, lambda piece: binary_values(piece.log)):
            if name not in writers:
                schema = _schema(run, columns)
                writer = pq.ParquetWriter(_path(out, name, ".parquet"), schema, compression="zstd")
                writers[name] = stack.enter_context(writer)
            table = pa.Table.from_arrays([values for _, values in columns], schema=writers[name].schema)
            writers[name].write_table(table)


def write_csv(run: RunTables, out: Path) -> None:
    """The same tables as .csv, and units.csv with the unit and the meaning of each column. NaN is an empty cell.

    A second head line with units would make text of all numbers for pandas, polars, R and MATLAB.
    """
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    writers: dict[str, pa_csv.CSVWriter] = {}
    units: list[dict[str, str]] = []
    with ExitStack() as stack:
        for name, columns in _pieces(run, DATA_AS_TEXT, lambda piece: pa.array(hex_texts(piece.log))):
            table = pa.Table.from_arrays([values for _, values in columns], names=[c.name for c, _ in columns])
            if name not in writers:
                path = _path(out, name, ".csv")
                writers[name] = stack.enter_context(pa_csv.CSVWriter(path, table.schema))
                units += _units(path.relative_to(out).as_posix(), columns)
            writers[name].write_table(table)
    pa_csv.write_csv(pa.Table.from_pylist(units), out / "units.csv")


def _pieces(run: RunTables, data: ExportColumn, data_of: Callable[[FramePiece], pa.Array]) -> Pieces:
    """All tables; each has at least one piece, those of messages without a frame none."""
    for table in run.step_pieces():
        yield table.name, _arrays(table)
    events = run.events()
    yield events.name, _arrays(events)
    has_frames = False
    for piece in run.frame_pieces():
        has_frames = True
        yield _frames(run, piece, data, data_of)
        for table in run.messages(piece.log):
            yield f"{SIGNALS}/{table.name}", _arrays(table)
    if not has_frames:
        yield _frames(run, FramePiece(run.frames, run.is_sent), data, data_of)


def _frames(
    run: RunTables, piece: FramePiece, data: ExportColumn, data_of: Callable[[FramePiece], pa.Array]
) -> tuple[str, Columns]:
    table = run.frame_columns(piece)
    return table.name, [*_arrays(table), (data, data_of(piece))]


def _arrays(table: ExportTable) -> Columns:
    import pyarrow as pa

    kinds = {"O": pa.string()}
    return [(c, pa.array(c.values, kinds.get(c.values.dtype.kind), from_pandas=True)) for c in table.columns]


def _path(out: Path, name: str, suffix: str) -> Path:
    path = out / f"{name}{suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _schema(run: RunTables, columns: Columns) -> pa.Schema:
    import pyarrow as pa

    fields = [pa.field(c.name, values.type, metadata=_metadata(c)) for c, values in columns]
    attributes = {"units": {c.name: c.unit for c, _ in columns}, **run.description}
    return pa.schema(fields, {**run.description, "PANDAS_ATTRS": json.dumps(attributes)})


def _units(file: str, columns: Columns) -> list[dict[str, str]]:
    return [
        {"file": file, "column": c.name, "unit": c.unit, "meaning": c.meaning, "choices": _choices(c)}
        for c, _ in columns
    ]


def _metadata(column: ExportColumn) -> dict[str, str]:
    choices = {"choices": _choices(column)} if column.choices else {}
    return {"unit": column.unit, "meaning": column.meaning, **choices}


def _choices(column: ExportColumn) -> str:
    return json.dumps({str(number): text for number, text in column.choices.items()}) if column.choices else ""
