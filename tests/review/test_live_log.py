"""The live picture beside the file: what goes wrong with it never touches the record."""

from __future__ import annotations

import re
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
from rerun.chunk import RrdReader

from hil.bench.open_record import TimelineSettings, open_record
from hil.core.types import Event, Severity
from hil.edge.record import live_log
from hil.edge.record.live_log import SEND_S, LiveLog
from hil.edge.record.picture_model import PictureModel
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.recorder import Timeline
from hil.edge.record.rerun_log import RerunLog
from hil.edge.record.run_folder import RunFolder
from hil.review.viewer import free_port
from tests.review import toy
from tests.review.test_tank_picture import MODEL, record_of


class Calls:
    """A timeline that notes what it is asked for, and raises where it is told to."""

    def __init__(self, fails_at: str = "") -> None:
        self.calls: list[str] = []
        self._fails_at = fails_at

    def __getattr__(self, name: str) -> Callable[..., None]:
        def call(*_: Any) -> None:
            self.calls.append(name)
            if name == self._fails_at:
                raise TimeoutError("Rerun has not answered")

        return call


def log_of(file: Calls, live: Calls, times_s: list[float]) -> LiveLog:
    return LiveLog(cast(Timeline, file), lambda: cast(RerunLog, live), clock_s=lambda: times_s.pop(0))


def test_what_was_gathered_is_sent_twice_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_log, "LINGER_S", 0.0)
    file, live = Calls(), Calls()
    log = log_of(file, live, [0.0, 0.1, 0.2, 0.1 + SEND_S, 0.2 + SEND_S])
    for t_s in (0.0, 0.1, 0.2, 0.3):
        log.tick((t_s,))
    log.close()
    assert live.calls == ["tick", "send", "tick", "tick", "send", "tick", "send", "close"]
    assert file.calls == ["tick"] * 4 + ["close"]


@pytest.mark.parametrize("fails_at", ["tick", "send", "event"])
def test_a_live_picture_that_fails_ends_and_the_file_goes_on(fails_at: str, capfd: pytest.CaptureFixture[str]) -> None:
    file, live = Calls(), Calls(fails_at)
    log = log_of(file, live, [0.0, 0.1, 5.0, 10.0])
    log.tick((0.0,))
    log.event(0.0, Event(Severity.INFO, "mode", "RUNNING"))
    log.tick((0.1,))
    log.close()
    assert file.calls == ["tick", "event", "tick", "close"]
    assert live.calls[-1] == fails_at, "it is not touched again"
    assert capfd.readouterr().err == "hil: the live picture has ended, the record goes on: Rerun has not answered\n"


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder.create(tmp_path / "run", toy.plan(mode="live"))


def test_a_run_is_served_on_this_machine_only_while_it_is_recorded(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recording has all it has without; nobody listens afterwards."""
    monkeypatch.setattr(live_log, "LINGER_S", 0.0)
    port = free_port()
    recorder = open_record(folder, TimelineSettings(0.5, 10.0, PictureModel(MODEL), port))
    recorder.tick(record_of(0.0))
    listening = subprocess.run(["ss", "-ltnH"], capture_output=True, text=True, check=True).stdout
    assert re.findall(rf"(\S+):{port}\s", listening) == ["127.0.0.1"]
    recorder.close("complete", "")
    assert recorder.health().is_ok
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0
    entities = {chunk.entity_path for chunk in RrdReader(folder.rrd_path).stream().to_chunks()}
    assert {"/levels/tank1", "/picture/flows"} <= entities


def test_a_port_that_is_taken_is_a_clear_error(folder: RunFolder) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(RunFolderError, match=rf"can't be served on port {port}"):
            open_record(folder, TimelineSettings(0.5, 10.0, PictureModel(MODEL), port))
