"""The record of a run, from its opening to its end, and the one rule for that end.

Whatever fails while a run ends (a full disk, a removed folder, a second Ctrl-C):

1. The pumps are off first: in real time the loop has sent 0 V, and seen it confirmed or waited for that, before
   anything here is called.
2. Each file is closed on its own; one that fails does not keep the others from being closed.
3. run.json gets the status and the reason of the run as it was. Where even that can't be written, it keeps "running",
   which `hil report` shows as unfinished.
4. What failed is one error, `IncompleteRecordError`, that names the file and the cause. No temporary file is left.

A record that can't be opened is removed as a whole: no pump has moved yet. Reasons:
docs/decisions/0020-end-of-a-run.md.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from hil.core.counted import counted
from hil.core.types import Event, Severity
from hil.edge.can.bus import BusPort
from hil.edge.host.clock import StopSignal
from hil.edge.record.manifest import Status
from hil.edge.record.process_recorder import ProcessRecorder
from hil.edge.record.record_errors import IncompleteRecordError, RunFolderError
from hil.edge.record.recorder import Recorder as FileRecorder
from hil.edge.record.run_folder import RunFolder
from hil.loop import Outcome, Recorder
from hil.review import kpi
from hil.review.kpi import Kpi


@contextmanager
def removed_if_not_opened(folder: RunFolder) -> Iterator[None]:
    """Take a new folder away again when what is done inside fails."""
    try:
        yield
    except BaseException:
        folder.remove()
        raise


class ClosableRecorder(Recorder, Protocol):
    """A recorder of the loop that is closed at the end of the run."""

    def close(self, status: Status, reason: str, *, speed_x: float | None = None) -> None:
        """Finish the record and keep how the run ended. speed_x : scenario seconds per wall second."""


class RunRecord:
    """Closes a recorder with how the run ended. Set `outcome` when the loop is over. Use as a context."""

    def __init__(self, recorder: ClosableRecorder, port: BusPort) -> None:
        self.recorder = recorder
        self.outcome: Outcome | None = None
        self._port = port
        self._started = time.perf_counter()

    def __enter__(self) -> RunRecord:
        """Nothing to do: the recorder is open."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        """Close the record. A request to stop that comes meanwhile waits for that; a second one does not."""
        wall_s = time.perf_counter() - self._started
        with StopSignal() as stop:
            if self.outcome is not None:
                self._close(self.outcome, wall_s)
            elif kind is KeyboardInterrupt:
                self.recorder.close("stopped", "interrupted")
            else:
                self.recorder.close("failed", f"{kind.__name__}: {error}" if kind else "ended without an outcome")
        if stop.received is not None and kind is None:
            raise KeyboardInterrupt

    def _close(self, outcome: Outcome, wall_s: float) -> None:
        severity = Severity.INFO if outcome.status in ("complete", "stopped") else Severity.ERROR
        counts: dict[str, object] = {
            "commands_sent": outcome.commands_sent,
            "commands_lost": outcome.commands_lost,
            "frames_lost": outcome.frames_lost,
            **{f"line_{name}": number for name, number in self._port.line_counts.items()},
        }
        if self._port.bus_errors:
            counts["bus_errors"] = dict(self._port.bus_errors)
        self.recorder.event(outcome.t_s, Event(severity, "end", f"{outcome.status}: {outcome.reason}", counts))
        self.recorder.close(outcome.status, outcome.reason, speed_x=(outcome.t_s - outcome.begun_s) / wall_s)


def figures_of(folder: RunFolder, recorder: FileRecorder | ProcessRecorder, outcome: Outcome) -> Kpi:
    """Key figures of a closed record, also written to kpi.json. Raises IncompleteRecordError when there are none.

    A record with gaps has figures; `Kpi.recorder` then says what is missing.
    """
    try:
        if folder.manifest().status == "running":
            raise RunFolderError(f"{folder.manifest_path.name} does not say how the run ended")
        return kpi.compute(folder)
    except (OSError, RunFolderError) as error:
        errors = [*recorder.health().errors, str(error)]
        raise incomplete(folder, outcome.status, outcome.reason, errors) from None


def check_complete(folder: RunFolder, figures: Kpi) -> None:
    """Raise IncompleteRecordError for a run whose record has gaps."""
    errors = list(figures.recorder.get("errors", ()))
    dropped = figures.recorder.get("dropped", 0)
    if dropped:
        errors.append(f"{counted(dropped, 'entry', 'entries')} dropped, the recorder could not keep up")
    if errors:
        raise incomplete(folder, figures.status, figures.reason, errors)


def incomplete(folder: RunFolder, status: str, reason: str, errors: list[str]) -> IncompleteRecordError:
    """The error of an ended run: one line with the folder, the first failure and how the run ended."""
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    ending = f"{status}, {reason}" if reason else status
    error = IncompleteRecordError(f"{folder.path}: the record is incomplete: {errors[0]}{more}; the run: {ending}")
    error.status, error.reason = status, reason
    return error
