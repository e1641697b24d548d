"""Opening a recording: the moment, the window, the page. Programs are started in the last tests only."""

from __future__ import annotations

import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from hil.core.types import Event, Severity
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.recorder import Recorder
from hil.edge.record.run_folder import RunFolder
from hil.review import viewer
from hil.review.moment import UnknownMomentError, moment_s
from hil.review.viewer import NoViewerError, Opening
from tests.review import toy
from tests.review.test_tank_picture import alarm, record_of


@pytest.fixture(scope="module")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """10 s with two alarms, the second told twice, and a trip."""
    folder = RunFolder.create(tmp_path_factory.mktemp("runs") / "run", toy.plan())
    recorder = Recorder.open(folder)
    events = {
        3: alarm(kind="leak", target=3, size=0.2, number=1),
        5: alarm(kind="unresolved", target=0, size=0.0, number=2),
        6: alarm(kind="sensor_bias", target=2, size=0.2, number=2),
        8: Event(Severity.ERROR, "trip", "too high", {"cause": "high_level"}),
    }
    for second in range(11):
        recorder.tick(record_of(float(second), events=tuple(events[s] for s in events if s == second)))
    recorder.close("tripped", "high_level")
    return folder


@pytest.mark.parametrize(
    ("text", "at_s"),
    [("trip", 8.0), ("trip:1", 8.0), ("alarm", 3.0), ("alarm:2", 5.0), ("7.5", 7.5), ("0", 0.0), ("1e1", 10.0)],
)
def test_a_moment_is_a_time_or_an_event(short_run: RunFolder, text: str, at_s: float) -> None:
    """An alarm's number is that of its first report; other events are counted."""
    assert moment_s(short_run, text) == at_s


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("alarm:3", r"no alarm 3; it has: 1, 2$"),
        ("trip:2", r"1 of these events, not 2$"),
        ("mode", r"no mode event; it has: alarm, trip$"),
        ("10.5", r"lasts from 0 to 10 s$"),
        ("-1", r"lasts from 0 to 10 s$"),
        ("nan", r"lasts from 0 to 10 s$"),
        ("alarm:x", r"whole number from 1 on"),
        ("alarm:", r"whole number from 1 on"),
        ("alarm:0", r"whole number from 1 on"),
        ("", r"no such event"),
    ],
)
def test_a_moment_that_the_run_has_not_is_a_clear_error(short_run: RunFolder, text: str, said: str) -> None:
    with pytest.raises(UnknownMomentError, match=said):
        moment_s(short_run, text)


def test_a_run_without_trip_says_what_it_has(whole_run: RunFolder) -> None:
    with pytest.raises(UnknownMomentError, match=r"has no trip event; it has: alarm, running"):
        moment_s(whole_run, "trip")


def test_a_run_without_a_recording_says_so(short_run: RunFolder) -> None:
    with pytest.raises(NoViewerError, match=r"no run\.rrd"):
        viewer.recording_of(short_run)


def test_a_run_without_steps_has_no_moment(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    Recorder.open(folder).close("failed", "no bus")
    with pytest.raises(RunFolderError, match=r"no control step"):
        moment_s(folder, "trip")


def test_a_viewer_that_ends_at_once_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failing = [sys.executable, "-c", "raise SystemExit(3)"]
    monkeypatch.setattr(viewer, "start", lambda _, **__: subprocess.Popen(failing))
    with pytest.raises(NoViewerError, match=r"code 3.*the report is at x"):
        viewer.open_window(tmp_path, Opening(instead="the report is at x"))
    with pytest.raises(NoViewerError, match=r"code 3"):
        viewer.serve_page(tmp_path, Opening(), lambda _: None)


@pytest.mark.long
def test_a_page_is_served_on_this_machine_only(whole_run: RunFolder) -> None:
    """Without a screen: the address answers with the viewer's page, and every port of it is bound to 127.0.0.1."""
    said: list[str] = []

    def visit(address: str) -> None:
        said.append(address)
        with urllib.request.urlopen(address, timeout=10.0) as page:  # noqa: S310 - ours
            assert page.status == 200
        listening = subprocess.run(["ss", "-ltnH"], capture_output=True, text=True, check=True).stdout
        ports = re.findall(r"127\.0\.0\.1(?::|%3A)(\d+)", address)
        assert len(ports) == 2
        for port in ports:
            assert re.findall(rf"(\S+):{port}\s", listening) == ["127.0.0.1"]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        viewer.serve_page(whole_run.rrd_path, Opening(), visit)
    assert said
