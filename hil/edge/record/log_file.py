"""Opens a log of frames for reading: as it was written, or compressed afterwards (`can.log.gz`, `can.log.zst`)."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, cast

from hil.edge.record.record_errors import RunFolderError

COMPRESSIONS = {"zst": ".zst", "gz": ".gz"}
"""Name of a compression -> what it adds to the name of a file."""


def find_log(path: Path) -> Path:
    """`path`, or its compressed form if there is only that one; raises RunFolderError when there is neither."""
    candidates = (path, *(path.with_name(path.name + suffix) for suffix in COMPRESSIONS.values()))
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    names = ", ".join(candidate.name for candidate in candidates[1:])
    raise RunFolderError(f"cannot read {path}: there is no such file, nor {names}")


@contextmanager
def open_log(path: Path) -> Iterator[BinaryIO]:
    """The bytes of a log, decompressed if the name ends in .gz or .zst. `path` is one that `find_log` found.

    Raises RunFolderError, which names the file, for whatever prevents reading it, at opening or later.
    """
    try:
        if path.suffix == COMPRESSIONS["gz"]:
            with gzip.open(path) as stream:
                yield cast(BinaryIO, stream)
        elif path.suffix == COMPRESSIONS["zst"]:
            import pyarrow as pa

            with pa.input_stream(str(path), compression="zstd") as stream:
                yield stream
        else:
            with path.open("rb") as stream:
                yield stream
    except (OSError, EOFError, zlib.error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error).splitlines()[0]
        raise RunFolderError(f"cannot read {path}: {reason}") from error


def read_log_text(path: Path) -> str:
    """All of a log as text; see `find_log` and `open_log` for `path` and what is raised."""
    with open_log(find_log(path)) as stream:
        return stream.read().decode("ascii", errors="replace")
