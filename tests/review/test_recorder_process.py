"""The recorder in its own process: the same files, and nothing that goes wrong there holds the loop up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import can
import numpy as np
import pytest

from hil.bench.open_record import TimelineSettings, open_record
from hil.core.types import Event, Severity
from hil.edge.record.manifest import ClockOffsets
from hil.edge.record.process_recorder import MAX_BATCH_AGE_S, ProcessRecorder
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.recorder import Recorder
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import read_events, read_ticks
from tests.review import recorder_bench as misbehaving
from tests.review import toy
from tests.waiting import wait_for

TEXT_FILES = ("can.log", "sent.log", "ticks.csv", "events.jsonl")
MS_100 = 0.1


@pytest.fixture(autouse=True)
def _recorders_know_this_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder.create(tmp_path / "run", toy.plan(mode="live"))


def play(recorder: Recorder | ProcessRecorder, until_s: float) -> None:
    recorder.event(-0.5, Event(Severity.INFO, "ready", "rig is ready"))
    recorder.message(-0.4, can.Message(is_error_frame=True))
    for index, (record, _) in enumerate(toy.steps(until_s=until_s)):
        for frame in toy.frames(record.t_s, index):
            recorder.frame(*frame)
        recorder.tick(record)


def test_it_writes_what_the_direct_one_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for the length of the queue, which is the newest column."""
    monkeypatch.setattr(ClockOffsets, "of", lambda _: ClockOffsets(1.8e9))  # two folders of the same moment
    folders = [RunFolder.create(tmp_path / name, toy.plan(mode="live")) for name in ("direct", "process")]
    direct = open_record(folders[0], None)
    play(direct, 20.0)
    direct.close("complete", "")
    with ProcessRecorder() as recorder:
        recorder.open(folders[1], partial(open_record, folders[1], None))
        play(recorder, 20.0)
        recorder.close("complete", "")
        assert recorder.health().is_ok
        assert recorder.health().waiting == 0
    for name in TEXT_FILES:
        first, second = ((one.path / name).read_text().splitlines() for one in folders)
        if name == "ticks.csv":
            first, second = ([line.rpartition(",")[0] for line in lines] for lines in (first, second))
        assert first == second
    assert folders[1].manifest().status == "complete"
    assert folders[1].manifest().recorder == {"errors": [], "dropped": 0}


def test_the_time_from_the_newest_frame_to_the_command_is_recorded(folder: RunFolder) -> None:
    record = next(toy.steps())[0]
    with ProcessRecorder() as recorder:
        recorder.open(folder, partial(open_record, folder, None))
        recorder.frame(10.000, 0x182, b"\1", True)
        recorder.frame(10.004, 0x282, b"\1", True)
        recorder.frame(10.0045, 0x201, b"\1", False)
        recorder.tick(record)
        recorder.tick(record)  # a step that sent nothing
        recorder.close("complete", "")
    latency_s = read_ticks(folder.ticks_path)["latency_s"]
    assert latency_s[0] == pytest.approx(0.0005)
    assert np.isnan(latency_s[1])


def test_before_the_first_step_frames_reach_the_file_all_the_same(folder: RunFolder) -> None:
    with ProcessRecorder() as recorder:
        recorder.open(folder, partial(open_record, folder, None))
        for number in range(100):
            recorder.frame(0.02 * number, 0x182, b"\1")
        wait_for(lambda: folder.can_log_path.read_text().count("\n") >= 100 - MAX_BATCH_AGE_S / 0.02 - 1)
        recorder.close("stopped", "")


def test_case_53_record_sink_stalls(tmp_path: Path, folder: RunFolder) -> None:
    """The queue stays within its limit, the oldest entries are dropped and counted, and no call waits.

    The recorder takes nothing until `go_on` exists, which is after the last step: a call that waited for it would never
    return. What a step costs is its processor time, whatever else the machine does.
    """
    go_on, took_s, steps = tmp_path / "go_on", [], list(toy.steps(until_s=300.0))
    with ProcessRecorder(capacity=2000) as recorder:
        recorder.open(folder, partial(misbehaving.open_stalling, folder, go_on))
        for index, (record, _) in enumerate(steps):
            began_s = time.thread_time()
            for frame in toy.frames(record.t_s, index):
                recorder.frame(*frame)
            recorder.tick(record)
            took_s.append(time.thread_time() - began_s)
        health = recorder.health()
        assert health.dropped > 10_000
        assert not health.is_ok
        assert sorted(took_s)[int(0.99 * len(took_s))] < 0.1 * MS_100, "a step costs far less than a tenth of a period"
        go_on.touch()
        recorder.close("complete", "")
    ticks = read_ticks(folder.ticks_path)
    assert ticks["t_s"][-1] == pytest.approx(steps[-1][0].t_s), "the newest are kept"
    assert folder.manifest().recorder["dropped"] == health.dropped
    assert ticks["recorder_queue"].max() > 1000
    (note,) = [event for event in read_events(folder.events_path) if event.code == "record_dropped"]
    assert note.data["dropped"] == health.dropped


def test_the_end_of_a_run_reaches_a_recorder_whose_line_is_full(folder: RunFolder, tmp_path: Path) -> None:
    """The last batch is taken and fills the line: the request to close the record was never sent again, and the record
    of a whole run was given up after 90 s."""
    go_on = tmp_path / "go_on"
    with ProcessRecorder() as recorder:
        recorder.open(folder, partial(misbehaving.open_stalling, folder, go_on))
        recorder.frame(0.0, 0x100, b"")  # the recorder takes this one, and waits
        recorder.event(0.0, Event(Severity.INFO, "ready", "rig is ready"))
        while not recorder._queue:
            recorder.event(0.0, Event(Severity.INFO, "", ""))
        recorder._drop()
        timer = threading.Timer(0.5, go_on.touch)
        timer.start()
        recorder.close("complete", "duration over", timeout_s=30.0)
        timer.join()
        assert recorder.health().errors == ()
    assert folder.manifest().outcome == "complete"


def test_a_full_disk_shows_in_health_and_never_raises_into_the_loop(folder: RunFolder) -> None:
    with ProcessRecorder() as recorder:
        recorder.open(folder, partial(misbehaving.open_on_a_full_disk, folder))
        play(recorder, 5.0)

        def is_reported() -> bool:
            recorder.tick(next(toy.steps())[0])
            return not recorder.health().is_ok

        assert recorder.troubles() == ()
        wait_for(is_reported)
        (trouble,) = recorder.troubles()
        assert (trouble.code, trouble.text[:17]) == ("recorder_failed", "ticks.csv is lost")
        assert recorder.troubles() == (), "once"
        recorder.close("complete", "")
    assert "ticks.csv is lost" in recorder.health().errors[0]
    assert folder.can_log_path.read_text().count("\n") == 15 * 50 + 1, "the other files go on"
    assert "recorder_failed" in [event.code for event in read_events(folder.events_path)]
    assert "ticks.csv is lost" in folder.manifest().recorder["errors"][0]


@pytest.mark.parametrize("way", ["killed", "crashed"])
def test_a_lost_recorder_does_not_hurt_the_loop_and_the_folder_says_so(folder: RunFolder, way: str) -> None:
    opener = partial(open_record, folder, None) if way == "killed" else partial(misbehaving.open_dying, folder)
    with ProcessRecorder(capacity=500) as recorder:
        recorder.open(folder, opener)
        play(recorder, 5.0)
        if way == "killed":
            recorder._process.send_signal(signal.SIGKILL)
        recorder._process.wait(20.0)
        for record, _ in toy.steps(until_s=60.0):
            recorder.tick(record)
        assert "the recorder is lost" in recorder.health().errors[0]
        assert recorder.health().dropped >= 600
        assert {trouble.code for trouble in recorder.troubles()} == {"recorder_lost", "record_dropped"}
        assert recorder.troubles() == ()
        recorder.close("complete", "duration over")
    manifest = folder.manifest()
    assert (manifest.status, manifest.reason) == ("complete", "duration over")
    assert "the recorder is lost" in manifest.recorder["errors"][0]
    events = read_events(folder.events_path)
    assert (events[-1].code, events[-1].severity) == ("recorder_lost", "ERROR")
    assert len(read_ticks(folder.ticks_path)) < 650


def test_a_record_that_cannot_be_opened_is_one_error_before_anything_moves(folder: RunFolder) -> None:
    with ProcessRecorder() as recorder, pytest.raises(RunFolderError, match="no room for run"):
        recorder.open(folder, partial(misbehaving.open_nothing, folder))


def test_an_entry_that_cannot_be_written_shows_and_the_rest_goes_on(folder: RunFolder) -> None:
    with ProcessRecorder() as recorder:
        recorder.open(folder, partial(open_record, folder, None))
        recorder.frame(0.0, 0x100, None)  # type: ignore[arg-type]  # no bytes, so that it cannot be written
        recorder.frame(0.0, 0x101, b"")
        recorder.close("complete", "")
    assert "AttributeError" in recorder.health().errors[0]
    assert "AttributeError" in folder.manifest().recorder["errors"][0]
    assert "101#" in folder.can_log_path.read_text(), "the entries after it are written"


def test_left_without_being_opened_it_ends_its_process() -> None:
    with ProcessRecorder() as recorder:
        pass
    assert recorder._process.returncode is not None


KILLED = """
import os, sys, time
from functools import partial
from pathlib import Path
import toy
from hil.bench.open_record import TimelineSettings, open_record
from hil.edge.record.process_recorder import ProcessRecorder
from hil.edge.record.run_folder import RunFolder
folder = RunFolder.create(Path(sys.argv[1]), toy.plan(mode="live"))
recorder = ProcessRecorder()
recorder.open(folder, partial(open_record, folder, TimelineSettings(0.5, 30.0)))
for index, (record, truth) in enumerate(toy.steps(until_s=30.0)):
    for frame in toy.frames(record.t_s, index):
        recorder.frame(*frame)
    recorder.tick(record)
    recorder.frame(record.t_s, 0x182, b"")  # of a step that never came
    time.sleep(0.002)
print(recorder._process.pid, flush=True)
if sys.argv[2] == "exit":
    os._exit(3)
sys.stdin.read()
"""


@pytest.mark.parametrize("way", ["exit", "kill"])
def test_a_killed_controller_loses_nothing_that_it_had_handed_over(tmp_path: Path, way: str) -> None:
    """The recorder takes what is in the line, finishes every file, and leaves the manifest as it was."""
    from rerun.chunk import RrdReader

    command = [sys.executable, "-c", KILLED, str(tmp_path / "run"), way]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        recorder = int(process.stdout.readline())
        if way == "kill":
            os.kill(process.pid, signal.SIGKILL)
        process.wait()
    wait_for(lambda: not Path(f"/proc/{recorder}").exists())
    folder = RunFolder.open(tmp_path / "run")
    assert folder.manifest().outcome == "interrupted"
    assert len(read_ticks(folder.ticks_path)) == 300
    with can.LogReader(folder.can_log_path) as reader:
        assert len(list(reader)) >= 300 * 15
    chunks = RrdReader(folder.rrd_path).stream().to_chunks()
    rows = sum(chunk.num_rows for chunk in chunks if chunk.entity_path == "/levels/tank1" and not chunk.is_static)
    assert rows == 300


def test_the_timeline_is_written_there_too(folder: RunFolder) -> None:
    with ProcessRecorder() as recorder:
        recorder.open(folder, partial(open_record, folder, TimelineSettings(0.5, 5.0)))
        play(recorder, 5.0)
        recorder.close("complete", "")
    assert folder.rrd_path.stat().st_size > 10_000
    assert folder.manifest().recorder == {"errors": [], "dropped": 0}
