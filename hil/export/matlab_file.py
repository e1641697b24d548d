"""One .mat file for MATLAB and Octave: a struct with the tables, and one of the same shape with the units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hil.core.counted import counted
from hil.edge.record.record_errors import RunFolderError
from hil.export.export_tables import ExportColumn, ExportTable, RunTables, identifier
from hil.export.frame_data import hex_texts

VARIABLE = "record"
"""Name of the struct; `run` is a command of MATLAB."""

MAX_FRAMES = 2_000_000
"""Of four hours. Each text of a frame is a cell of its own, and the format takes no variable above 4 GB."""


def write_mat(run: RunTables, out: Path) -> None:
    """`record.ticks.t_s`, `record.units.ticks.t_s` and so on, columns as (n, 1) arrays; text as cells.

    Numbers that stand for states have their names in `record.choices.MESSAGE.SIGNAL`, a cell array (number, name).
    """
    from scipy.io import savemat

    if len(run.frames) > MAX_FRAMES:
        raise RunFolderError(
            f"{run.folder.path}: --to mat takes at most {counted(MAX_FRAMES, 'frame')}, and the run has "
            f"{len(run.frames)}: use --to parquet, which MATLAB reads with parquetread"
        )
    frames = run.frame_columns()
    data = (
        ExportColumn("data", run.frames.data, "", "bytes of the frame, zeros after its length"),
        ExportColumn("data_hex", hex_texts(run.frames).astype(object), "", "bytes of the frame as text"),
    )
    tables = [run.control_steps(), run.events(), ExportTable("frames", frames.time_s, (*frames.columns, *data))]
    messages = list(run.messages())
    content = {
        "info": run.description,
        **{table.name: _columns(table) for table in tables},
        "signals": {table.name: _columns(table) for table in messages},
        "units": {**_of(tables, "unit"), "signals": _of(messages, "unit")},
        "meanings": {**_of(tables, "meaning"), "signals": _of(messages, "meaning")},
        "choices": {table.name: names for table in messages if (names := _choices(table))},
    }
    with out.open("wb") as file:
        savemat(file, {VARIABLE: content}, long_field_names=True, do_compression=True, oned_as="column")


def _columns(table: ExportTable) -> dict[str, Any]:
    """Numbers as they are, whole numbers as float64: MATLAB's integers saturate in a difference."""
    return {identifier(column.name): _plain(column.values) for column in table.columns}


def _plain(values: Any) -> Any:
    return values.astype(np.float64) if values.dtype.kind in "iu" and values.ndim == 1 else values


def _of(tables: list[ExportTable], what: str) -> dict[str, dict[str, str]]:
    return {
        table.name: {identifier(column.name): getattr(column, what) for column in table.columns} for table in tables
    }


def _choices(table: ExportTable) -> dict[str, Any]:
    return {
        identifier(c.name): np.array([(float(n), text) for n, text in sorted(c.choices.items())], dtype=object)
        for c in table.columns
        if c.choices
    }
