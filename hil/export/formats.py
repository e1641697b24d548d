"""The formats that a run is exported to, one row each; command line, help and docs follow from the table."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hil.edge.control.socket_path import running_runs
from hil.edge.record.log_file import COMPRESSIONS
from hil.edge.record.record_errors import IncompleteRecordError, RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.export import columnar_files, log_copy, matlab_file, mcap_file, measurement_file
from hil.export.export_tables import RunTables, read_run

CANDUMP = "candump"

MIN_AGE_S = 10.0
"""A recorder writes at least every 0.3 s."""


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """One format. suffix : of its file or folder. opened_by : programs that tests or we have opened it with.

    require : raises RunFolderError if the format's library is not installed.
    """

    suffix: str
    write: Callable[[RunTables, Path], None]
    content: str
    opened_by: str
    is_folder: bool = False
    require: Callable[[], None] | None = None


FORMATS: dict[str, ExportFormat] = {
    "parquet": ExportFormat(
        "_parquet",
        columnar_files.write_parquet,
        "a folder of Parquet files; units in the metadata of the fields",
        "pandas, polars, DuckDB, MATLAB `parquetread`",
        is_folder=True,
    ),
    "csv": ExportFormat(
        "_csv",
        columnar_files.write_csv,
        "a folder of CSV files and `units.csv`",
        "every spreadsheet, pandas, polars, R, MATLAB `readtable`",
        is_folder=True,
    ),
    "mf4": ExportFormat(
        ".mf4",
        measurement_file.write_mf4,
        "bus logging with the DBC embedded, decoded signals, control steps, events",
        "asammdf, python-can, CANape, CANoe, vSignalyzer",
        require=measurement_file.require,
    ),
    "mcap": ExportFormat(
        ".mcap",
        mcap_file.write_mcap,
        "a topic for each table, events also as a log, messages in Protocol Buffers",
        "Rerun, Foxglove, PlotJuggler",
        require=mcap_file.require,
    ),
    "mat": ExportFormat(
        ".mat", matlab_file.write_mat, "one struct `record` with tables and units", "MATLAB, Octave, scipy"
    ),
    CANDUMP: ExportFormat(
        ".log",
        lambda run, out: log_copy.write_candump(run.folder.can_log_path, out),
        "the frames as `candump -L` writes them",
        "Wireshark, can-utils, cantools, python-can, SavvyCAN",
    ),
}


def export_run(path: Path, to: str, out: Path | None = None, compress: str | None = None) -> Path:
    """Write the run in the folder `path` in the format `to`; returns what was written.

    out : file or folder to write; None: the run's name with the format's suffix, beside the run folder. compress : for
    candump, zst or gz. What exists is never overwritten, and nothing stays of what could not be written completely.
    Raises RunFolderError, IncompleteRecordError.
    """
    if to not in FORMATS:
        raise RunFolderError(f"--to {to} is not a format: {', '.join(FORMATS)}")
    _check_compression(to, compress)
    chosen = FORMATS[to]
    folder = RunFolder.open(path)
    if chosen.require is not None:
        chosen.require()
    target = out or _beside(folder.path, chosen.suffix + COMPRESSIONS.get(compress or "", ""))
    _check_free(target)
    if to == CANDUMP:
        return _written(target, lambda part: log_copy.write_candump(folder.can_log_path, part, compress))
    run = read_run(path)
    return _written(target, lambda part: chosen.write(run, part))


def compress_logs(path: Path, compress: str | None) -> list[Path]:
    """Replace can.log and sent.log of a run folder by compressed ones, which all readers take as well.

    Returns the new files. Raises RunFolderError; the plain logs then stay.
    """
    folder = RunFolder.open(path)
    if compress is None:
        raise RunFolderError(f"--in-place needs --compress: {', '.join(COMPRESSIONS)}")
    _check_compression(CANDUMP, compress)
    if _goes_on(folder):
        raise RunFolderError(f"{path}: the run goes on; compress its logs after its end")
    logs = [log for log in (folder.can_log_path, folder.sent_log_path) if log.exists()]
    if not logs:
        raise RunFolderError(f"{path} has no log that is not compressed")
    try:
        return log_copy.compress_in_place(logs, compress, COMPRESSIONS[compress])
    except OSError as error:
        raise IncompleteRecordError(f"{path} can't be written: {error.strerror or error}") from error


def _goes_on(folder: RunFolder) -> bool:
    """Whether something writes into the folder: its run answers, or its end is not recorded and the log is fresh."""
    here = folder.path.resolve()
    if any(Path(run.folder).resolve() == here for run in running_runs()):
        return True
    if folder.manifest().status != "running" or not folder.can_log_path.exists():
        return False
    return time.time() - folder.can_log_path.stat().st_mtime < MIN_AGE_S


def _check_compression(to: str, compress: str | None) -> None:
    if compress is not None and to != CANDUMP:
        raise RunFolderError(f"--compress is for --to {CANDUMP}; {to} has a compression of its own, or none")
    if compress is not None and compress not in COMPRESSIONS:
        raise RunFolderError(f"--compress {compress} is not a compression: {', '.join(COMPRESSIONS)}")


def _beside(folder: Path, suffix: str) -> Path:
    whole = folder.resolve()
    return whole.with_name(whole.name + suffix)


def _check_free(target: Path) -> None:
    if target.exists() or target.is_symlink():
        raise RunFolderError(f"{target} exists already; an export never overwrites, name another with --out")
    if not target.parent.is_dir():
        raise RunFolderError(f"{target} can't be written: there is no folder {target.parent}")


def _written(target: Path, write: Callable[[Path], None]) -> Path:
    """Write beside the target, then rename: there is a whole file or none."""
    part = target.with_name(f".{target.stem}.part{target.suffix}")
    _remove(part)
    try:
        write(part)
        part.rename(target)
    except OSError as error:
        raise IncompleteRecordError(f"{target} can't be written: {error.strerror or error}") from error
    finally:
        _remove(part)
    return target


def _remove(part: Path) -> None:
    if part.is_dir():
        shutil.rmtree(part, ignore_errors=True)
    else:
        with suppress(OSError):
            part.unlink(missing_ok=True)
