"""The trash of a folder of runs: `.trash/<time>/<run>` within it, on the same disk, so that a run can be moved back.

A run that goes on is never moved. Its run.json says "running", and so does that of a run that was killed; it goes on
when it listens on its control channel, when a process has one of its files open, or when a file has changed in the last
`QUIET_S`. The last rule alone is left where another user's processes, or another system's, can't be seen.
"""

from __future__ import annotations

import difflib
import shutil
import time
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.run_index.folders import MANIFEST, find_runs, run_at
from hil.run_index.life_signs import LifeSigns

TRASH_NAME = ".trash"
QUIET_S = 60.0


class TrashError(RunFolderError):
    """A run can't be moved to the trash, or the trash not emptied; the message says why."""


@dataclass(frozen=True, slots=True)
class TrashContent:
    """What is in a trash: how many runs, and the size of all files in it."""

    runs: int
    size_bytes: int


def run_named(folder: Path, text: str) -> str:
    """The name of the run in `folder` that a user means by its name or its path. Raises TrashError."""
    root = folder.resolve()
    for path in (root / text, Path(text).absolute()):
        inside = path.parent.resolve() / path.name
        if (path / MANIFEST).is_file() and inside.is_relative_to(root) and inside != root and not path.is_symlink():
            name = inside.relative_to(root)
            if not any(part.startswith(".") for part in name.parts):
                return name.as_posix()
    known = [found.name for found in find_runs(folder)]
    near = difflib.get_close_matches(text, known, n=3, cutoff=0.4)
    hint = f"; did you mean {' or '.join(near)}?" if near else ""
    raise TrashError(f"{text}: no run of this name is in {folder}{hint}")


def move_to_trash(folder: Path, name: str, now: datetime) -> Path:
    """Move the run `name` of `folder` to the trash; where it is now. Raises TrashError, also for a run that goes on."""
    path = folder / name
    if why := why_running(path, time.time()):
        raise TrashError(f"{path} still runs ({why}); a run that goes on is not moved to the trash")
    target = _free(folder / TRASH_NAME / f"{now:%Y%m%d-%H%M%S}", name)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        path.rename(target)
    except OSError as error:
        with suppress(OSError):
            target.parent.rmdir()
        raise TrashError(f"{path} can't be moved to {target}: {error.strerror}") from None
    return target


def why_running(path: Path, now_s: float) -> str:
    """Why a run folder is that of a run that goes on; "" when it is not. now_s : time since the epoch."""
    with suppress(RunFolderError, OSError, ValueError):
        if RunFolder(path).manifest().status != "running":
            return ""
    if sign := LifeSigns.now().of(path):
        return sign
    changed_s = max((entry.stat().st_mtime for entry in path.iterdir() if entry.is_file()), default=0.0)
    if now_s - changed_s < QUIET_S:
        return f"a file of it changed less than {QUIET_S:g} s ago"
    return ""


def trash_content(folder: Path) -> TrashContent:
    """What is in the trash of a folder of runs."""
    trash = folder / TRASH_NAME
    if not trash.is_dir():
        return TrashContent(0, 0)
    return TrashContent(sum(1 for _ in find_runs(trash, 10)), run_at(trash, TRASH_NAME).size_bytes)


def empty_trash(folder: Path) -> None:
    """Delete what is in the trash of a folder of runs. Raises TrashError."""
    trash = folder / TRASH_NAME
    if trash.is_symlink():
        raise TrashError(f"{trash} is a link, not a folder: it is left as it is")
    try:
        shutil.rmtree(trash)
    except FileNotFoundError:
        return
    except OSError as error:
        raise TrashError(f"{trash} can't be emptied: {error.filename}: {error.strerror}") from None


def _free(folder: Path, name: str) -> Path:
    number = 1
    target = folder / name
    while target.exists():
        number += 1
        target = folder.with_name(f"{folder.name}_{number}") / name
    return target
