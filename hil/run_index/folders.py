"""Finds run folders below a folder, and says what identifies their state: names, sizes and times of their files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

MAX_DEPTH = 5
"""Levels below the folder of runs: an experiment has its runs at EXPERIMENT/phases/RUN, a test or campaign may have
them one or two levels deeper."""

MANIFEST = "run.json"


@dataclass(frozen=True, slots=True)
class FoundRun:
    """A run folder: name below the folder of runs, with `/`; size of its files; and the state of its files."""

    path: Path
    name: str
    size_bytes: int
    signature: str


def find_runs(folder: Path, max_depth: int = MAX_DEPTH) -> Iterator[FoundRun]:
    """The run folders below `folder`, by name, and `folder` itself, named ".", if it is one.

    Hidden folders (the trash is one) and links to folders are left out. What is inside of a run folder is its own,
    and not searched. Folders that can't be read are left out.
    """
    yield from _found(folder, "", max_depth)


def run_at(path: Path, name: str) -> FoundRun:
    """The state of one run folder. Raises OSError."""
    with os.scandir(path) as entries:
        return _run(path, name, list(entries))


def _found(folder: Path, name: str, depth: int) -> Iterator[FoundRun]:
    try:
        with os.scandir(folder) as listed:
            entries = sorted(listed, key=lambda entry: entry.name)
    except OSError:
        return
    if any(entry.name == MANIFEST and entry.is_file() for entry in entries):
        yield _run(folder, name or ".", entries)
        return
    if depth <= 0:
        return
    for entry in entries:
        if not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False):
            yield from _found(folder / entry.name, f"{name}/{entry.name}" if name else entry.name, depth - 1)


def _run(path: Path, name: str, entries: list[os.DirEntry[str]]) -> FoundRun:
    files = sorted(_files(entries))
    signature = ";".join(f"{file}:{size}:{changed_ns}" for file, size, changed_ns in files if "/" not in file)
    return FoundRun(path, name, sum(size for _, size, _ in files), signature)


def _files(entries: list[os.DirEntry[str]], below: str = "") -> Iterator[tuple[str, int, int]]:
    """Name, size and time of change of every file, those of folders within, too."""
    for entry in entries:
        with suppress(OSError):  # taken away in this moment
            if entry.is_dir(follow_symlinks=False):
                with os.scandir(entry.path) as inside:
                    yield from _files(list(inside), f"{below}{entry.name}/")
            else:
                state = entry.stat(follow_symlinks=False)
                yield f"{below}{entry.name}", state.st_size, state.st_mtime_ns
