"""The frames as `candump -L` writes them, plain or compressed."""

from __future__ import annotations

import gzip
import re
from contextlib import closing
from pathlib import Path
from typing import Any

from hil.data.can_log import can_log_blocks
from hil.edge.record.log_file import find_log, open_log
from hil.edge.record.record_errors import RunFolderError

BLOCK_BYTES = 1 << 20
MARK = re.compile(rb" [RT]\r?\n")


def write_candump(log: Path, out: Path, compress: str | None = None, *, removes_marks: bool = True) -> None:
    """Copy the whole lines of a log, which may be compressed; a half line at its end is left out.

    compress : zst, gz, or None. removes_marks : those of the direction at the ends of lines, which logs of format 1
    have and Wireshark does not read. Raises RunFolderError when the log can't be read or is damaged.
    """
    for _ in can_log_blocks(log):  # a damaged line is refused here, not by the tool that reads the file
        pass
    with open_log(find_log(log)) as source, closing(_sink(out, compress)) as sink:
        rest = b""
        while block := source.read(BLOCK_BYTES):
            whole, line_end, half = (rest + block).rpartition(b"\n")
            text = whole + line_end
            sink.write(text if not removes_marks or MARK.search(text) is None else MARK.sub(b"\n", text))
            rest = half


def compress_in_place(logs: list[Path], compress: str, suffix: str) -> list[Path]:
    """Replace logs by compressed ones: each is written beside, read again and compared before the plain one goes.

    Returns the new files. Raises RunFolderError; the plain log then stays.
    """
    made = []
    for log in logs:
        found = find_log(log)
        if found != log:
            raise RunFolderError(f"{found} is compressed already")
        new = log.with_name(log.name + suffix)
        temporary = new.with_name(f".{new.name}.tmp{suffix}")
        try:
            write_candump(log, temporary, compress, removes_marks=False)
            if not _is_equal(log, temporary):
                raise RunFolderError(f"{temporary} is not what {log} has, which stays as it is")
            temporary.replace(new)
        finally:
            temporary.unlink(missing_ok=True)
        log.unlink()
        made.append(new)
    return made


def _is_equal(plain: Path, compressed: Path) -> bool:
    """Whether both have the same whole lines."""
    with open_log(plain) as before, open_log(compressed) as after:
        while block := after.read(BLOCK_BYTES):
            if before.read(len(block)) != block:
                return False
        return b"\n" not in before.read()


def _sink(out: Path, compress: str | None) -> Any:
    if compress == "gz":
        return gzip.open(out, "wb")
    if compress == "zst":
        import pyarrow as pa

        return pa.output_stream(str(out), compression="zstd")
    return out.open("wb")
