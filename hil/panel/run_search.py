"""Which run a panel belongs to."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hil.edge.control.client import find_run, listing
from hil.edge.control.socket_path import ControlError, RunningRun, running_runs


def run_finder(folder: Path | None, socket: Path | None) -> Callable[[], Path]:
    """What finds the socket of the run in `folder`, at `socket`, or of the only run that goes on.

    It raises ControlError when there is none, or several and none was named.
    """

    def find() -> Path:
        if folder is not None or socket is not None:
            return find_run(folder, socket)
        runs = running_runs()
        _check_one(runs)
        if not runs:
            raise ControlError("no run goes on")
        return Path(runs[0].socket)

    return find


def check_choice(folder: Path | None, socket: Path | None) -> None:
    """Raise ControlError when several runs go on and none was named; the panel's line is too short for their list."""
    if folder is None and socket is None:
        _check_one(running_runs())


def _check_one(runs: list[RunningRun]) -> None:
    if len(runs) > 1:
        raise ControlError(f"more than one run goes on, name one: {listing(runs)}")
