"""A run's folder: which files it has, and `run.json`, which records what was run and how it ended.

A folder is written once. `create` refuses a path that exists, so that no run ever overwrites another. `run.json` is
there from the first moment with status "running" and is replaced as a whole at the end; a run that was killed therefore
keeps "running", which readers show as "interrupted". All other files are appended to while the run goes on:

    run.json      what was run, with copies of its configuration     can.log   every frame, as `candump -L` writes them
    ticks.csv     one line for each control step                     sent.log  those that the controller sent
    events.jsonl  one line for each event                            run.rrd   the same for the Rerun viewer
    kpi.json, report.html   made afterwards
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any, Literal, get_args

from hil.core.errors import HilError
from hil.edge.record.json_text import read_json
from hil.edge.record.manifest_check import wrong_field
from hil.edge.record.new_folder import NewFolder
from hil.version import __version__

Status = Literal["running", "complete", "stopped", "tripped", "failed"]
RunMode = Literal["lockstep", "live"]

FORMAT = 2
"""Of run.json and the files beside it. 1: ticks.csv with empty cells, can.log in monotonic times with R or T."""
FORMATS_READ = (1, 2)
LIBRARIES = ("numpy", "python-can", "rerun-sdk")


class RunFolderError(HilError):
    """A run folder cannot be made, read or understood."""


class IncompleteRecordError(RunFolderError):
    """Something was done, but what came of it can't be written completely; the message names the file and the cause.

    status, reason : of the run, when one has ended.
    """

    status: str = "complete"
    reason: str = ""


class RunFolderExistsError(RunFolderError, FileExistsError):
    """The path exists already. Nothing was written."""


class NoRunFolderError(RunFolderError, FileNotFoundError):
    """There is no run folder at the path."""


@dataclass(frozen=True, slots=True)
class Window:
    """A stretch of the run over which the errors are summed up: [from_s, to_s] in run time."""

    name: str
    from_s: float
    to_s: float


@dataclass(frozen=True, slots=True)
class RunPlan:
    """What is known of a run before its first step.

    settings : the merged settings as JSON-ready values, `{"rig": {...}, "scenario": {...}, ...}`; the review reads
    `rig.sensors.gain_V_cm` from it. copies : file name -> full text of each configuration file that went in. shown :
    names of the numbers that the control law has recorded.
    """

    scenario: str
    mode: RunMode
    seed: int | None
    period_s: float
    windows: tuple[Window, ...] = ()
    reconfigure: bool = True
    settings: Mapping[str, Any] = field(default_factory=dict)
    copies: Mapping[str, str] = field(default_factory=dict)
    shown: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ClockOffsets:
    """How the times of a record belong together. All of them run alike; each has its own zero.

    monotonic_zero_epoch_s, run_zero_epoch_s : time since the epoch at which the monotonic clock, or the run time `t_s`,
    was 0. None: not known (format 1), or not yet (no step in control). In lockstep the monotonic clock is the simulated
    one, which starts at the epoch itself, so that the same seed gives the same bytes.
    """

    monotonic_zero_epoch_s: float | None = None
    run_zero_epoch_s: float | None = None

    @classmethod
    def of(cls, mode: RunMode) -> ClockOffsets:
        """The offsets of a run that is about to start. Taken once: a wall clock that is set later changes no record."""
        is_live = mode == "live"
        return cls(round((time.time_ns() - time.monotonic_ns()) * 1e-9, 6) if is_live else 0.0)

    def with_run_zero(self, monotonic_s: float) -> ClockOffsets:
        """The offsets with the run's time zero, given as monotonic time; not known where that clock's zero is not."""
        zero_s = self.monotonic_zero_epoch_s
        return replace(self, run_zero_epoch_s=None if zero_s is None else round(zero_s + monotonic_s, 6))


@dataclass(frozen=True, slots=True)
class Manifest:
    """The content of `run.json`. Times are ISO 8601 in UTC; `recorder` has the recorder's own failures, if any."""

    plan: RunPlan
    status: Status
    reason: str
    started_utc: str
    ended_utc: str | None
    versions: Mapping[str, str]
    speed_x: float | None = None
    recorder: Mapping[str, Any] = field(default_factory=dict)
    clock: ClockOffsets = ClockOffsets()

    @property
    def outcome(self) -> str:
        """The status as shown to users: a run whose end was not recorded was interrupted."""
        return "interrupted" if self.status == "running" else self.status

    def to_json(self) -> str:
        """As the text of `run.json`."""
        head = {"format": FORMAT, **asdict(self)}
        plan = head.pop("plan")
        return json.dumps({**head, **plan}, indent=2, ensure_ascii=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Manifest:
        """The manifest in a `run.json`; raises RunFolderError when it is not one."""
        try:
            raw = read_json(text)
            if not isinstance(raw, dict):
                raise RunFolderError("run.json is not a run's manifest: it is no table")
            if raw["format"] not in FORMATS_READ:
                read = " and ".join(str(number) for number in FORMATS_READ)
                raise RunFolderError(f"run.json has format {raw['format']}, this program reads {read}")
            if raw["status"] not in get_args(Status):
                raise RunFolderError(f"run.json has the unknown status {raw['status']!r}")
            if wrong := wrong_field(raw):
                raise RunFolderError(f"run.json is not a run's manifest: {wrong}")
            shown = tuple(raw.pop("shown", ()))  # a run folder of an earlier version has none
            plan = {name: raw.pop(name) for name in RunPlan.__dataclass_fields__ if name != "shown"}
            windows = tuple(Window(**window) for window in plan.pop("windows"))
            del raw["format"]
            clock = ClockOffsets(**raw.pop("clock", {}))
            return cls(plan=RunPlan(windows=windows, shown=shown, **plan), clock=clock, **raw)
        except KeyError as error:
            raise RunFolderError(f"run.json is not a run's manifest: it has no {error}") from error
        except (ValueError, TypeError, RecursionError) as error:
            raise RunFolderError(f"run.json is not a run's manifest: {error}") from error


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The paths of one run's files, and its manifest. made : what `create` made; None for a folder that is read."""

    path: Path
    made: NewFolder | None = None

    @classmethod
    def create(cls, path: Path, plan: RunPlan, started: datetime | None = None) -> RunFolder:
        """Make the folder and its `run.json`.

        Raises RunFolderExistsError (a FileExistsError) when the path is taken, RunFolderError when it cannot be made.
        """
        try:
            made = NewFolder.make(path)
        except FileExistsError as error:
            message = f"{path} exists already; a run never overwrites another, name a new folder"
            raise RunFolderExistsError(message) from error
        except OSError as error:
            raise RunFolderError(f"cannot make the run folder {path}: {error.strerror}") from error
        folder = cls(path, made)
        manifest = Manifest(plan, "running", "", _utc(started), None, versions(), clock=ClockOffsets.of(plan.mode))
        try:
            folder._write_manifest(manifest)
        except BaseException as error:
            folder.remove()
            if isinstance(error, IncompleteRecordError) and isinstance(error.__cause__, OSError):
                raise RunFolderError(f"cannot make the run folder {path}: {error.__cause__.strerror}") from None
            raise
        return folder

    def remove(self) -> None:
        """Remove a folder that was just made, and the parent folders made for it. Never raises."""
        if self.made is not None:
            self.made.remove()

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """The run folder at `path`, for reading; raises NoRunFolderError when there is no `run.json` in it."""
        folder = cls(path)
        if not folder.manifest_path.is_file():
            raise NoRunFolderError(f"{path} is not a run folder: it has no run.json")
        return folder

    @property
    def manifest_path(self) -> Path:
        """What was run and how it ended."""
        return self.path / "run.json"

    @property
    def can_log_path(self) -> Path:
        """Every frame, in candump's format."""
        return self.path / "can.log"

    @property
    def sent_log_path(self) -> Path:
        """The frames of can.log that the controller sent itself, in the same format."""
        return self.path / "sent.log"

    @property
    def ticks_path(self) -> Path:
        """One line for each control step."""
        return self.path / "ticks.csv"

    @property
    def events_path(self) -> Path:
        """One JSON object a line for each event."""
        return self.path / "events.jsonl"

    @property
    def rrd_path(self) -> Path:
        """The recording for the Rerun viewer."""
        return self.path / "run.rrd"

    @property
    def kpi_path(self) -> Path:
        """The key figures."""
        return self.path / "kpi.json"

    @property
    def report_path(self) -> Path:
        """The report."""
        return self.path / "report.html"

    def manifest(self) -> Manifest:
        """Read `run.json`; raises RunFolderError, which names the folder, when it cannot be read or understood."""
        try:
            return Manifest.from_json(self.manifest_path.read_text(encoding="utf-8"))
        except OSError as error:
            raise RunFolderError(f"{self.manifest_path} can't be read: {error.strerror or error}") from error
        except UnicodeDecodeError as error:
            raise RunFolderError(f"{self.manifest_path} is no text: {error.reason} at byte {error.start}") from error
        except RunFolderError as error:
            raise RunFolderError(f"{self.path}: {error}") from error.__cause__

    def note_run_zero(self, monotonic_s: float) -> None:
        """Record when the run's time began. Raises OSError, RunFolderError."""
        before = self.manifest()
        self._write_manifest(replace(before, clock=before.clock.with_run_zero(monotonic_s)))

    def finish(
        self,
        status: Status,
        reason: str,
        *,
        ended: datetime | None = None,
        speed_x: float | None = None,
        recorder: Mapping[str, Any] | None = None,
    ) -> None:
        """Record how the run ended. speed_x : scenario seconds per wall second."""
        before = self.manifest()
        self._write_manifest(
            replace(
                before,
                status=status,
                reason=reason,
                ended_utc=_utc(ended),
                speed_x=before.speed_x if speed_x is None else speed_x,
                recorder=dict(recorder or before.recorder),
            )
        )

    def _write_manifest(self, manifest: Manifest) -> None:
        write_atomically(self.manifest_path, manifest.to_json())


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


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on: this program, Python and the libraries; nothing of the machine."""
    return {
        "hil": __version__,
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in LIBRARIES},
    }


def _utc(moment: datetime | None) -> str:
    return (moment or datetime.now(UTC)).astimezone(UTC).isoformat(timespec="milliseconds")
