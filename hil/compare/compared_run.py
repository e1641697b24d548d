"""The runs of a comparison, read, named, and aligned in time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hil.edge.record.manifest import Manifest
from hil.edge.record.record_errors import NoRunFolderError, RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.kpi import COLUMNS as KPI_COLUMNS
from hil.review.kpi import Kpi, evaluate
from hil.review.moment import moment_of
from hil.review.ticks import Floats, LoggedEvent, Ticks, read
from hil.run_index.folders import find_runs

START = "start"
"""Alignment at time 0 of each run: its first step in control."""

COLUMNS = (
    *KPI_COLUMNS,
    *(f"{name}{pump}{unit}" for name, unit in (("v", "_V"), ("theta", ""), ("iae", "_Vs")) for pump in "12"),
    *(f"h{tank}_est_V" for tank in "1234"),
)
"""What key figures and report need."""


class CompareError(RunFolderError):
    """These runs can't be compared so; the message says why."""


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """One run. name : shown, different for each run. zero_s : run time that is time 0 of the comparison."""

    name: str
    folder: RunFolder
    manifest: Manifest
    ticks: Ticks
    events: Sequence[LoggedEvent]
    kpi: Kpi
    zero_s: float = 0.0

    @property
    def times_s(self) -> Floats:
        """Times of the steps on the common axis, (n,), s."""
        return self.ticks["t_s"] - self.zero_s

    @property
    def figures(self) -> dict[str, Any]:
        """The key figures as kpi.json has them."""
        return asdict(self.kpi)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader has to know of the record, a line each."""
        notes = []
        if self.manifest.status == "running":
            notes.append(f"{self.name}: unfinished: what was recorded until its end is compared")
        if not len(self.ticks):
            notes.append(f"{self.name}: no control step was recorded: it is in the tables only")
        elif missing := [column for column in ("theta1", "v1_V", "h1_est_V") if column not in self.ticks.columns]:
            notes.append(f"{self.name}: an older record without {', '.join(missing)}: it is left out of those figures")
        return tuple(notes)


def run_paths(paths: Sequence[Path]) -> tuple[Path, ...]:
    """The run folders that a user means: each path, or those within a folder that is none. Raises CompareError."""
    found: list[Path] = []
    for path in paths:
        if (path / "run.json").is_file():
            found.append(path)
            continue
        inside = [one.path for one in find_runs(path)] if path.is_dir() else []
        if not inside:
            raise NoRunFolderError(f"{path} is not a run folder: it has no run.json, and no folder within has one")
        found += inside
    first: dict[Path, Path] = {}
    for path in found:
        first.setdefault(path.resolve(), path)
    different = list(first.values())
    if len(different) < 2:
        raise CompareError(f"{different[0]} is one run: a comparison needs two or more")
    return tuple(different)


def compared_runs(paths: Sequence[Path], align: str = START, *, whole: bool = True) -> tuple[ComparedRun, ...]:
    """Read the runs, and align them at `align`: start, a time in s, or an event as `hil view --at` names it.

    whole : with all columns; otherwise those of key figures and report alone, which is quicker for long runs.
    Raises RunFolderError, also when a run has no such moment; the message names the run.
    """
    columns = None if whole else COLUMNS
    named = zip(paths, names_of(paths), strict=True)
    return tuple(_read(RunFolder.open(path), name, align, columns) for path, name in named)


def names_of(paths: Sequence[Path]) -> tuple[str, ...]:
    """The last parts of the paths, as many as tell them apart."""
    whole = [path.resolve().parts for path in paths]
    for count in range(1, max(map(len, whole)) + 1):
        names = ["/".join(parts[-count:]) for parts in whole]
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(os.fspath(path) for path in paths)


def _read(folder: RunFolder, name: str, align: str, columns: Sequence[str] | None) -> ComparedRun:
    try:
        manifest = folder.manifest()
        ticks, events = read(folder, columns)
        figures = evaluate(manifest, ticks, events)
    except RunFolderError as error:
        raise CompareError(f"{folder.path} can't be compared: {error}") from None
    except (OSError, UnicodeDecodeError, KeyError, ValueError) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise CompareError(f"{folder.path} can't be compared: {what}") from None
    zero_s = 0.0 if align == START or not len(ticks) else moment_of(folder.path, ticks, events, align, "--align")
    return ComparedRun(name, folder, manifest, ticks, events, figures, zero_s)
