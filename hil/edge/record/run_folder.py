"""A run's folder: which files it has. `run.json` records what was run and how it ended, see `manifest`.

A folder is written once. `create` refuses a path that exists, so that no run ever overwrites another. `run.json` is
there from the first moment with status "running" and is replaced as a whole at the end; a run that was killed therefore
keeps "running", which readers show as "interrupted". All other files are appended to while the run goes on:

    run.json      what was run, with copies of its configuration     can.log   every frame, as `candump -L` writes them
    ticks.csv     one line for each control step                     sent.log  those that the controller sent
    events.jsonl  one line for each event                            run.rrd   the same for the Rerun viewer
    kpi.json, report.html   made afterwards
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil.edge.record.file_writing import write_atomically
from hil.edge.record.manifest import ClockOffsets, Manifest, RunPlan, Status, versions
from hil.edge.record.new_folder import NewFolder
from hil.edge.record.record_errors import IncompleteRecordError, NoRunFolderError, RunFolderError, RunFolderExistsError


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


def _utc(moment: datetime | None) -> str:
    return (moment or datetime.now(UTC)).astimezone(UTC).isoformat(timespec="milliseconds")
