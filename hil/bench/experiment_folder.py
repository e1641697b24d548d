"""The folder of an experiment: which phases it has, and which of them are recorded.

    experiment.json         what was planned
    phases/01_fill/         one run folder for each phase; 01_fill_2 for a second try after the first was aborted

A phase is recorded when one of its run folders ended with the status `complete` and has no gap. Nothing is overwritten:
aborted tries stay where they are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench import ruler
from hil.core.experiment import Phase
from hil.core.experiment_plan import RULER
from hil.edge.record.file_writing import write_atomically
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder

FORMAT = 1
PHASES = "phases"
PLAN = "experiment.json"


class ExperimentFolderError(RunFolderError):
    """A folder is not that of this experiment."""


@dataclass(frozen=True)
class ExperimentFolder:
    """The folder of an experiment. phases : names, in their order."""

    path: Path
    phases: tuple[str, ...]

    @classmethod
    def open(cls, path: Path, phases: Sequence[Phase], choices: Mapping[str, Any]) -> ExperimentFolder:
        """The folder, made if it is not there. choices : what the plan was made from.

        Raises ExperimentFolderError when the path holds something else, or an experiment with other choices.
        """
        folder = cls(path, tuple(phase.name for phase in phases))
        planned = {"format": FORMAT, "choices": dict(choices), "phases": list(folder.phases)}
        if folder.plan_path.is_file():
            folder._check(planned)
            return folder
        try:
            if path.exists() and any(path.iterdir()):
                raise ExperimentFolderError(
                    f"{path} is not the folder of an experiment: it has no {PLAN}; name a new one"
                )
            (path / PHASES).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ExperimentFolderError(f"cannot make the folder {path}: {error.strerror}") from error
        write_atomically(folder.plan_path, json.dumps(planned, indent=2) + "\n")
        return folder

    @property
    def plan_path(self) -> Path:
        """What was planned."""
        return self.path / PLAN

    def recorded(self, phase: str) -> Path | None:
        """The run folder of a phase that is recorded, or None."""
        needs_levels = phase == RULER
        tries = (path for path in self._tries(phase) if is_recorded(path))
        return next((path for path in tries if not needs_levels or (path / ruler.FILE).is_file()), None)

    def new_path(self, phase: str) -> Path:
        """Where the next try of a phase is recorded."""
        name = self._name(phase)
        used = {path.name for path in (self.path / PHASES).glob(f"{name}*")}
        number = next(number for number in range(1, len(used) + 2) if _numbered(name, number) not in used)
        return self.path / PHASES / _numbered(name, number)

    def runs(self) -> tuple[Path, ...]:
        """The run folders of all recorded phases, in the order of the phases."""
        found = (self.recorded(phase) for phase in self.phases)
        return tuple(path for path in found if path is not None)

    def _tries(self, phase: str) -> list[Path]:
        name = self._name(phase)
        folders = (self.path / PHASES).glob(f"{name}*")
        return sorted(path for path in folders if path.name == name or path.name[len(name) + 1 :].isdecimal())

    def _name(self, phase: str) -> str:
        return f"{self.phases.index(phase) + 1:02d}_{phase}"

    def _check(self, planned: Mapping[str, Any]) -> None:
        try:
            there = json.loads(self.plan_path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ExperimentFolderError(f"{self.plan_path} can't be read: {error}") from error
        if there != planned:
            raise ExperimentFolderError(
                f"{self.path} holds an experiment with other choices ({_text(there)}) than this call "
                f"({_text(planned)}): repeat that call, or name a new folder"
            )


def recorded_runs(path: Path) -> tuple[Path, ...]:
    """The run folders of an experiment's recorded phases; of any other folder itself. Raises ExperimentFolderError."""
    plan_path = path / PLAN
    if not plan_path.is_file():
        return (path,)
    try:
        names = tuple(str(name) for name in json.loads(plan_path.read_text(encoding="utf-8"))["phases"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ExperimentFolderError(f"{plan_path} can't be read: {error}") from error
    return ExperimentFolder(path, names).runs()


def make_folder(path: Path) -> None:
    """The folder for a result, if it is not there. Raises ExperimentFolderError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExperimentFolderError(f"cannot make the folder {path}: {error.strerror}") from error


def is_recorded(path: Path) -> bool:
    """Whether the run folder has a complete record of a phase that went to its end."""
    try:
        manifest = RunFolder.open(path).manifest()
    except (OSError, RunFolderError):
        return False
    has_gap = bool(manifest.recorder.get("errors")) or bool(manifest.recorder.get("dropped"))
    return manifest.status == "complete" and not has_gap


def _numbered(name: str, number: int) -> str:
    return name if number == 1 else f"{name}_{number}"


def _text(planned: Mapping[str, Any]) -> str:
    choices = planned.get("choices", {})
    return ", ".join(f"{name} {value}" for name, value in choices.items())
