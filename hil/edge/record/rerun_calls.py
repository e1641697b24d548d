"""Calls of Rerun that may never return, and Rerun's tool that compacts a file."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import rerun as rr

COMPACT_TIMEOUT_S = 60.0


def call_within(timeout_s: float, call: Callable[[], None]) -> None:
    """Make the call in a thread of its own. Raises TimeoutError when it takes too long; the thread is then abandoned.

    Rerun hands what it gets to a thread that writes; where that one has ended by a full disk, its caller may never
    return.
    """
    errors: list[BaseException] = []

    def work() -> None:
        try:
            call()
        except BaseException as error:  # noqa: BLE001 - raised again by the caller's thread
            errors.append(error)

    thread = threading.Thread(target=work, name="rerun", daemon=True)
    thread.start()
    thread.join(timeout_s)
    if thread.is_alive():
        raise TimeoutError(f"Rerun has not answered for {timeout_s:g} s")
    if errors:
        raise errors[0]


def abandon(recording: rr.RecordingStream) -> None:
    """Never touch the recording again: what Rerun does when it is released, or at the exit, may wait for the writer."""
    rr.unregister_shutdown()
    threading.Thread(target=lambda: (recording, threading.Event().wait()), name="abandoned", daemon=True).start()


def compact(path: Path, timeout_s: float = COMPACT_TIMEOUT_S) -> None:
    """Merge the file's small chunks with Rerun's own tool; a killed run's file becomes a whole one by it, too.

    Raises OSError or subprocess.SubprocessError; the file is then as it was.
    """
    merged = path.with_name(f".{path.name}.tmp")
    command = [sys.executable, "-m", "rerun_cli", "rrd", "optimize", str(path), "-o", str(merged)]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=timeout_s)  # noqa: S603 - our own paths
        merged.replace(path)
    finally:
        merged.unlink(missing_ok=True)
