"""Open a recording in the Rerun viewer, bound to this machine only."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from hil.edge.record.run_folder import RunFolder, RunFolderError

START_S = 3.0  # a viewer that cannot start (no screen, no graphics) ends within this time


class NoViewerError(RunFolderError):
    """The viewer cannot be used here; the message says what there is instead."""


def view(folder: RunFolder, *, start_s: float = START_S) -> None:
    """Start the viewer on `run.rrd`; it goes on running afterwards.

    Raises NoViewerError, with a message for the user, when there is no recording or no viewer can start.
    """
    if not folder.rrd_path.is_file():
        raise NoViewerError(f"{folder.path} has no run.rrd (recorded without Rerun?); {_instead(folder)}")
    view_recording(folder.rrd_path, _instead(folder), start_s=start_s)


def view_recording(path: Path, instead: str, *, start_s: float = START_S) -> None:
    """Start the viewer on a recording. instead : what a user without a viewer can do.

    Raises NoViewerError, with a message for the user, when no viewer can start.
    """
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise NoViewerError(f"there is no screen here for the Rerun viewer; {instead}")
    command = [sys.executable, "-m", "rerun_cli", str(path), "--bind", "127.0.0.1", "--port", "auto"]
    viewer = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)  # noqa: S603 - our own path
    try:
        code = viewer.wait(timeout=start_s)
    except subprocess.TimeoutExpired:
        return  # it runs, and is not stopped with this program
    if code != 0:
        raise NoViewerError(f"the Rerun viewer ended at once (code {code}); {instead}")


def _instead(folder: RunFolder) -> str:
    if folder.report_path.is_file():
        return f"the report is at {folder.report_path}"
    return f"`hil report {folder.path}` makes a report without it"
