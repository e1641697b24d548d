"""Files written as a whole, so that no reader and no crash finds half of one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hil.edge.record.record_errors import IncompleteRecordError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name the file in what goes wrong inside: an OSError becomes an IncompleteRecordError."""
    try:
        yield
    except OSError as error:
        raise IncompleteRecordError(f"{path} can't be written: {error.strerror or error}") from error


def write_atomically(path: Path, content: str | bytes) -> None:
    """Replace the file as a whole: a reader, or a crash at any moment, sees the old content or the new one.

    Raises IncompleteRecordError; the file is then as it was.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    with writing(path):
        try:
            with temporary.open("wb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def write_to(path: Path, content: str) -> None:
    """Replace a file as a whole; a pipe or device, as /dev/stdout, is written to. Raises IncompleteRecordError."""
    if path.exists() and not path.is_file():
        with writing(path):
            path.write_text(content, encoding="utf-8")
    else:
        write_atomically(path, content)
