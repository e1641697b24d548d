"""Reads `ticks.csv` and `events.jsonl`. If the run was killed, the last line may be incomplete; it is left out."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.edge.record.run_folder import RunFolder, RunFolderError

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Ticks:
    """The tick table as columns; each an (n,) array, read-only.

    A run records only the columns that it can have, and older records lack newer ones: `get` gives NaN for those. Empty
    cells, which records of format 1 have, are NaN.
    """

    columns: Mapping[str, Floats]

    def __len__(self) -> int:
        return len(self.columns["t_s"])

    def __getitem__(self, column: str) -> Floats:
        return self.columns[column]

    def get(self, column: str) -> Floats:
        """A column, (n,); all NaN where the record does not have it."""
        return self.columns.get(column, np.full(len(self), np.nan))

    def stack(self, *columns: str) -> Floats:
        """Several columns side by side, (n, len(columns))."""
        return np.column_stack([self.columns[column] for column in columns])

    @property
    def has_truth(self) -> bool:
        """Whether the true levels are known at every step."""
        levels_cm = [self.get(f"true_h{tank}_cm") for tank in (1, 2, 3, 4)]
        return len(self) > 0 and bool(np.isfinite(levels_cm).all())


@dataclass(frozen=True, slots=True)
class LoggedEvent:
    """One line of `events.jsonl`."""

    t_s: float
    severity: str
    code: str
    text: str
    data: Mapping[str, Any]


def read_ticks(path: Path) -> Ticks:
    """Read a tick table; raises RunFolderError when it is missing or is not one."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise RunFolderError(f"cannot read {path}: {error.strerror}") from error
    whole = raw[: raw.rfind(b"\n") + 1]  # what follows the last line end was cut off by a kill
    return parse_ticks(whole.decode("utf-8"), str(path))


def parse_ticks(text: str, where: str) -> Ticks:
    """The text of a tick table, whole lines only; raises RunFolderError, `where` first, when it is not one."""
    header, _, body = text.partition("\n")
    names = header.split(",")
    if "t_s" not in names:
        raise RunFolderError(f"{where} is not a tick table: it has no column t_s")
    try:
        values = _numbers(body) if body else np.empty((0, len(names)))
    except ValueError as error:
        raise RunFolderError(f"{where} is damaged: {error}") from error
    if values.shape[1] != len(names):
        raise RunFolderError(f"{where} is damaged: {len(names)} columns named, {values.shape[1]} there")
    values.setflags(write=False)
    return Ticks(dict(zip(names, values.T, strict=True)))


def _numbers(body: str) -> Floats:
    """The lines as an (n, m) array. Empty cells are filled first: numpy's fast reader accepts none."""
    filled = body.replace(",,", ",nan,").replace(",,", ",nan,").replace(",\n", ",nan\n")
    return np.loadtxt(io.StringIO(filled), delimiter=",", ndmin=2)


def read_events(path: Path) -> tuple[LoggedEvent, ...]:
    """Read the events; a missing file has none, raises RunFolderError for a line that is not an event."""
    if not path.is_file():
        return ()
    return parse_events(path.read_text(encoding="utf-8", errors="replace"), str(path))


def parse_events(text: str, where: str) -> tuple[LoggedEvent, ...]:
    """The lines of an event log, a half one at the end left out; raises RunFolderError, `where` first."""
    events: list[LoggedEvent] = []
    for number, line in enumerate(text.split("\n")[:-1], start=1):
        try:
            events.append(LoggedEvent(**json.loads(line)))
        except (ValueError, TypeError) as error:
            raise RunFolderError(f"{where}, line {number} is not an event: {error}") from error
    return tuple(events)


def read(folder: RunFolder) -> tuple[Ticks, tuple[LoggedEvent, ...]]:
    """A run's ticks and events."""
    return read_ticks(folder.ticks_path), read_events(folder.events_path)
