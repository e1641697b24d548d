"""can.log is what `candump -L` writes: times since the epoch, no more than three words a line, read by Wireshark."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import time
from pathlib import Path

import can
import pytest

from hil.edge.record.recorder import Recorder
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import read_ticks
from tests.review import toy

CANDUMP = re.compile(r"\(\d+\.\d{6}\) can0 ([0-9A-F]{3}|[0-9A-F]{8})#(R\d?|([0-9A-F]{2}){0,8})")
ODD = [
    can.Message(arbitration_id=0x1ABCDEF, is_extended_id=True, data=b"\x01\x02"),
    can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=4),
    can.Message(is_error_frame=True),
    can.Message(arbitration_id=0x123, is_extended_id=False, data=bytes(8), is_rx=False),
]


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    """With one frame of every kind, and 75 ordinary ones."""
    folder = RunFolder.create(tmp_path / "run", toy.plan(mode="live"))
    recorder = Recorder.open(folder)
    for message in ODD:
        recorder.message(1.25, message)
    for index in range(5):
        for frame in toy.frames(2.0 + 0.1 * index, index):
            recorder.frame(*frame)
    recorder.close("complete", "")
    return folder


def test_every_line_is_one_that_candump_writes(folder: RunFolder) -> None:
    """A line ended in R or T, and Wireshark 4.0 read not one frame of it."""
    for path in (folder.can_log_path, folder.sent_log_path):
        lines = path.read_text().splitlines()
        assert lines
        assert [line for line in lines if not CANDUMP.fullmatch(line)] == []


@pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark (Wireshark)")
def test_wireshark_reads_every_frame(folder: RunFolder) -> None:
    command = ["tshark", "-r", str(folder.can_log_path), "-T", "fields", "-e", "frame.time_epoch", "-e", "can.id"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60.0)
    lines = done.stdout.splitlines()
    assert len(lines) == len(ODD) + 75
    assert float(lines[-1].split()[0]) == pytest.approx(time.time(), abs=1e9), "of our days"


def test_times_of_a_live_run_are_since_the_epoch_and_run_json_has_the_offsets(tmp_path: Path) -> None:
    """They were seconds since the computer had started, and nothing said when that was."""
    folder = RunFolder.create(tmp_path / "run", toy.plan(mode="live"))
    recorder = Recorder.open(folder)
    began_ns = time.monotonic_ns()
    for index, (record, _) in enumerate(toy.steps(until_s=1.0)):
        at_ns = began_ns + round(record.t_s * 1e9)
        recorder.frame(at_ns * 1e-9, 0x201, bytes(8), False)
        recorder.tick(toy.at(record, at_ns))
        if index == 0:  # a killed run has them, too
            clock = json.loads(folder.manifest_path.read_text())["clock"]
    recorder.close("complete", "")
    assert json.loads(folder.manifest_path.read_text())["clock"] == clock
    assert clock["monotonic_zero_epoch_s"] == pytest.approx(time.time() - time.monotonic(), abs=1.0)
    assert clock["run_zero_epoch_s"] == pytest.approx(clock["monotonic_zero_epoch_s"] + began_ns * 1e-9, abs=1e-5)
    with can.CanutilsLogReader(folder.can_log_path) as reader:
        stamps_s = [message.timestamp for message in reader]
    run_s = [stamp_s - clock["run_zero_epoch_s"] for stamp_s in stamps_s]
    assert run_s == pytest.approx(read_ticks(folder.ticks_path)["t_s"], abs=1e-5)


def test_in_lockstep_the_simulated_clock_starts_at_the_epoch(tmp_path: Path) -> None:
    """The same seed gives the same bytes on any day."""
    folder = toy.record_run(tmp_path / "run", until_s=1.0)
    assert folder.manifest().clock.monotonic_zero_epoch_s == 0.0
    assert folder.can_log_path.read_text().startswith("(0.000000) can0 100#")


def test_a_wall_clock_set_during_the_run_does_not_change_the_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan(mode="live"))
    recorder = Recorder.open(folder)
    recorder.frame(1.0, 0x201, b"")
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    monkeypatch.setattr(time, "time", lambda: 0.0)
    recorder.frame(2.0, 0x201, b"")
    recorder.close("complete", "")
    with can.CanutilsLogReader(folder.can_log_path) as reader:
        first, second = (message.timestamp for message in reader)
    assert second - first == pytest.approx(1.0, abs=1e-5)
