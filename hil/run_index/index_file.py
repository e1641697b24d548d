"""The index: a SQLite file `.run_index.sqlite3` in the folder of runs. It only saves the time to read every run again.

The run folders are the truth. A row holds while the names, sizes and times of change of its folder's files are those
that it was made from; otherwise it is read again. An index that is damaged, of another version, or in a folder that
can't be written is replaced, or done without: no result depends on it.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from hil.edge.record.record_errors import NoRunFolderError
from hil.run_index.folders import MAX_DEPTH, FoundRun, find_runs
from hil.run_index.indexed_run import INTERRUPTED, RUNNING, IndexedRun
from hil.run_index.life_signs import LifeSigns

INDEX_NAME = ".run_index.sqlite3"
VERSION = 1
"""Of the rows; a change of `IndexedRun` or of what it is read from raises it."""
TIMEOUT_S = 2.0


def index_of(folder: Path, max_depth: int = MAX_DEPTH) -> tuple[IndexedRun, ...]:
    """The runs below `folder` as rows, the oldest first; the index in it is used and brought up to date.

    Each row is an `IndexedRun`: flat fields (name, started_utc, scenario, status, mode, duration_s, rig, law, design,
    detector, seed, alarms, trips, size_bytes, problem ...) and `figures`, the whole kpi.json; `as_dict()` gives it as
    JSON-ready values. `folder / row.name` is the run folder. Runs in folders within (experiments, tests, campaigns)
    are found down to `max_depth` levels. A run folder that can't be read is a row with its `problem`. A run that
    surely goes on has the status "running"; one that was killed, or of which no sign is seen, "interrupted".

    Raises NoRunFolderError when `folder` is no folder.
    """
    if not folder.is_dir():
        raise NoRunFolderError(f"{folder}: there is no such folder of runs")
    found = list(find_runs(folder, max_depth))
    path = folder / INDEX_NAME
    kept = _kept_rows(path)
    rows = {one.name: _row(one, kept) for one in found}
    if kept.keys() != rows.keys() or any(kept[one.name][0] != one.signature for one in found):
        _keep(path, [(one, rows[one.name]) for one in found])
    return tuple(sorted(_alive(folder, rows.values()), key=lambda row: (row.started_utc, row.name)))


def _alive(folder: Path, rows: Iterable[IndexedRun]) -> Iterator[IndexedRun]:
    """The rows, those of runs that go on with that status: it is no property of the files, and not in the index."""
    signs: LifeSigns | None = None
    for row in rows:
        if row.status == INTERRUPTED:
            signs = signs or LifeSigns.now()
            yield replace(row, status=RUNNING) if signs.of(folder / row.name) else row
        else:
            yield row


def _row(found: FoundRun, kept: Mapping[str, tuple[str, IndexedRun]]) -> IndexedRun:
    signature, row = kept.get(found.name, ("", None))
    if row is not None and signature == found.signature and row.size_bytes == found.size_bytes:
        return row
    return IndexedRun.of(found.path, found.name, found.size_bytes)


def _kept_rows(path: Path) -> dict[str, tuple[str, IndexedRun]]:
    """Name -> signature and row, as the index has them; {} for one that is not there or can't be used."""
    if not path.is_file():
        return {}
    try:
        with closing(
            sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro", uri=True, timeout=TIMEOUT_S)
        ) as index:
            if index.execute("PRAGMA user_version").fetchone() != (VERSION,):
                return {}
            lines = index.execute("SELECT name, signature, fields FROM runs").fetchall()
        return {name: (signature, IndexedRun(**json.loads(fields))) for name, signature, fields in lines}
    except (sqlite3.Error, OSError, ValueError, TypeError):
        return {}


def _keep(path: Path, rows: Iterable[tuple[FoundRun, IndexedRun]]) -> None:
    """Write a new index beside the old one and replace that; does nothing where that is not possible."""
    fresh = path.with_name(f"{INDEX_NAME}.{os.getpid()}.tmp")
    with suppress(sqlite3.Error, OSError, UnicodeEncodeError):  # the last: a folder whose name is no text
        try:
            fresh.unlink(missing_ok=True)
            with closing(sqlite3.connect(fresh, timeout=TIMEOUT_S)) as index, index:
                index.execute("PRAGMA journal_mode = MEMORY")
                index.execute(f"PRAGMA user_version = {VERSION}")
                index.execute("CREATE TABLE runs (name TEXT PRIMARY KEY, signature TEXT, fields TEXT)")
                lines = [(one.name, one.signature, json.dumps(row.as_dict())) for one, row in rows]
                index.executemany("INSERT INTO runs VALUES (?, ?, ?)", lines)
            fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)
