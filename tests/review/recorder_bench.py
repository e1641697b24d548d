"""Recorders that misbehave, to be opened in the recorder's own process."""

from __future__ import annotations

import io
import os
import time
from pathlib import Path
from typing import Any

from hil.edge.record.recorder import Recorder
from hil.edge.record.run_folder import RunFolder


class FullDisk(io.StringIO):
    """Takes so many characters and then none."""

    def __init__(self, room: int) -> None:
        super().__init__()
        self._room = room

    def write(self, text: str) -> int:
        self._room -= len(text)
        if self._room < 0:
            raise OSError(28, "No space left on device")
        return super().write(text)


def open_on_a_full_disk(folder: RunFolder) -> Recorder:
    frames, sent, events = (path.open("w") for path in (folder.can_log_path, folder.sent_log_path, folder.events_path))
    return Recorder(folder, ticks=FullDisk(room=3000), frames=frames, sent=sent, events=events)


class Stalling(Recorder):
    """The first frame waits for a file to appear, as for a disk that answers no more."""

    go_on: Path

    def frame(self, *arguments: Any, **options: Any) -> None:
        while not self.go_on.exists():
            time.sleep(0.01)
        super().frame(*arguments, **options)


def open_stalling(folder: RunFolder, go_on: Path) -> Recorder:
    recorder = Stalling.open(folder)
    assert isinstance(recorder, Stalling)
    recorder.go_on = go_on
    return recorder


class Dying(Recorder):
    """An event takes the whole process down."""

    def event(self, *_: object) -> None:
        os._exit(9)


def open_dying(folder: RunFolder) -> Recorder:
    return Dying.open(folder)


def open_nothing(folder: RunFolder) -> Recorder:
    raise OSError(f"no room for {folder.path.name}")
