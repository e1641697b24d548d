"""The campaign's folder: rows as they come, and the table made of them.

`outcomes.jsonl` gets a line for each run that ends, flushed at once, and is all that a restart needs: what is in it is
not run again. If the program is killed, only unfinished runs are lost; half a line at the end is left out.
`outcomes.parquet` is made of it.
"""

from __future__ import annotations

import json
import os
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from io import BytesIO
from pathlib import Path
from typing import Any, get_type_hints

from hil.campaigns.cases import Case
from hil.campaigns.row import Row
from hil.campaigns.toml_text import toml_text
from hil.edge.record.file_writing import write_atomically, writing
from hil.edge.record.new_folder import NewFolder
from hil.edge.record.record_errors import IncompleteRecordError, RunFolderError

ARROW_TYPES = {str: "string", int: "int64", float: "float64", bool: "bool_"}


@dataclass(frozen=True, slots=True)
class Store:
    """Paths of a campaign's folder, and how rows go in and out."""

    path: Path

    @classmethod
    def open(cls, path: Path, about: Mapping[str, Any]) -> Store:
        """Make the folder, or go on in one that belongs to a campaign of the same name.

        about : what campaign.json keeps, its `name` among it. Raises RunFolderError.
        """
        store = cls(path)
        made: NewFolder | None = None
        try:
            if store.manifest_path.is_file():
                name = json.loads(store.manifest_path.read_text(encoding="utf-8")).get("name")
                if name != about["name"]:
                    raise RunFolderError(f"{path} belongs to the campaign {name!r}, this is {about['name']!r}")
            elif path.exists() and any(path.iterdir()):
                raise RunFolderError(f"{path} exists and is no campaign's folder; name a new one")
            if not path.exists():
                made = NewFolder.make(path)
            write_atomically(store.manifest_path, json.dumps(dict(about), indent=2, ensure_ascii=False) + "\n")
        except (OSError, ValueError, AttributeError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise RunFolderError(f"{path} can't be a campaign's folder: {reason}") from None
        except IncompleteRecordError as error:
            if made is not None:
                made.remove()
            raise RunFolderError(str(error)) from None  # no run has been started
        return store

    @property
    def manifest_path(self) -> Path:
        """What the campaign is."""
        return self.path / "campaign.json"

    @property
    def rows_path(self) -> Path:
        """A line for each run that ended."""
        return self.path / "outcomes.jsonl"

    @property
    def table_path(self) -> Path:
        """The table of outcomes."""
        return self.path / "outcomes.parquet"

    @property
    def report_path(self) -> Path:
        """The report."""
        return self.path / "report.html"

    def add(self, row: Row) -> None:
        """Append a row and hand it to the system, so that a kill can't take it back.

        Raises IncompleteRecordError; the rows before it stay, and a restart goes on behind them.
        """
        line = json.dumps(asdict(row), ensure_ascii=False) + "\n"
        with writing(self.rows_path), self.rows_path.open("a+b") as file:
            if file.tell() and not self._ends_with_newline():
                file.write(b"\n")  # ends the line that a kill or a full disk left unfinished
            file.write(line.encode("utf-8"))

    def rows(self) -> dict[str, Row]:
        """Rows by key, those of crashed runs left out; lines that are not rows are passed over."""
        if not self.rows_path.is_file():
            return {}
        found: dict[str, Row] = {}
        for line in self.rows_path.read_text(encoding="utf-8", errors="replace").split("\n"):
            try:
                row = Row(**json.loads(line))
            except (ValueError, TypeError):
                continue
            if not row.crashed:
                found[row.key] = row
        return found

    def write_table(self, rows: Sequence[Row]) -> Path:
        """Write the Parquet table as a whole."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pa.Table.from_pylist([asdict(row) for row in rows], schema=schema())
        content = BytesIO()
        pq.write_table(table, content, compression="zstd")
        write_atomically(self.table_path, content.getvalue())
        return self.table_path

    def keep_scenarios(self, cases: Iterable[Case], keys: frozenset[str]) -> Path:
        """Write the scenarios of the named cases, so that each can be run and recorded on its own."""
        folder = self.path / "cases"
        for case in cases:
            if case.key in keys:
                with writing(folder):
                    folder.mkdir(exist_ok=True)
                write_atomically(folder / f"{case.key}.toml", toml_text(case.scenario_data))
        return folder

    def _ends_with_newline(self) -> bool:
        with self.rows_path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"


def schema() -> Any:
    """The table's columns as pyarrow has them, from the row's own types."""
    import pyarrow as pa

    hints = get_type_hints(Row)
    columns = []
    for column in fields(Row):
        options = typing.get_args(hints[column.name]) or (hints[column.name],)
        kind = next(option for option in options if option is not type(None))
        columns.append(pa.field(column.name, getattr(pa, ARROW_TYPES[kind])(), nullable=type(None) in options))
    return pa.schema(columns)
