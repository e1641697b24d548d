"""Whether a run goes on. Its run.json says "running", and so does that of a run that was killed."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hil.edge.control.socket_path import SOCKET_NAME, is_listening, running_runs

PROCESSES = Path("/proc")
LISTENS = "it listens on its control channel"


@dataclass(frozen=True)
class LifeSigns:
    """What this user can see of running processes at one moment.

    listening : folders of the runs that listen. open_in : folder -> number of a process that has a file in it open;
    empty where the system does not show them.
    """

    listening: frozenset[Path]
    open_in: Mapping[Path, str]

    @classmethod
    def now(cls) -> LifeSigns:
        """Look at all processes once; some ten milliseconds."""
        return cls(frozenset(Path(run.folder).resolve() for run in running_runs()), _open_files())

    def of(self, path: Path) -> str:
        """Why the run in this folder goes on; "" where there is no sign of it. Sure signs only."""
        folder = path.resolve()
        if folder in self.listening or is_listening(path / SOCKET_NAME):
            return LISTENS
        process = self.open_in.get(folder)
        return "" if process is None else f"process {process} has its files open"


def _open_files() -> dict[Path, str]:
    found: dict[Path, str] = {}
    for process in PROCESSES.glob("[0-9]*"):
        with suppress(OSError):
            for descriptor in (process / "fd").iterdir():
                with suppress(OSError):
                    found.setdefault(descriptor.readlink().parent, process.name)
    return found
