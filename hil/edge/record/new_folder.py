"""A folder that is made for a record, and removed again, with the parent folders made for it, when that fails."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

PROBE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class NewFolder:
    """A folder that did not exist before. parents : the parent folders that were made for it, the nearest first."""

    path: Path
    parents: tuple[Path, ...] = ()

    @classmethod
    def make(cls, path: Path) -> NewFolder:
        """Make the folder and its missing parents.

        Raises OSError, FileExistsError when the path is taken. Nothing is left then.
        """
        missing = tuple(parent for parent in path.parents if not parent.exists())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.mkdir()
        except OSError:
            _remove_empty(*missing)
            raise
        return cls(path, missing)

    def remove(self) -> None:
        """Remove the folder with all that is in it, and those of its parents that are empty. Never raises."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.remove_if_empty()

    def remove_if_empty(self) -> None:
        """Remove the folder and those of its parents, as far as they are empty. Never raises."""
        _remove_empty(self.path, *self.parents)


def _remove_empty(*folders: Path) -> None:
    for folder in folders:
        with suppress(OSError):  # it is not there, or another program has put something into it
            folder.rmdir()


def disk_error(folder: Path) -> OSError | None:
    """The error with which the folder's disk refuses a new file of 1 MiB; None when it takes it.

    For libraries that report a full disk in words of their own. The file has no name and is removed at once.
    """
    try:
        with TemporaryFile(dir=folder) as file:
            file.write(bytes(PROBE_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return error
    return None
