from __future__ import annotations

import json
from pathlib import Path

import can
import numpy as np
import pytest

from hil.core.types import Event, Mode, Severity
from hil.edge.record.manifest import RunMode
from hil.edge.record.record_format import event_line
from hil.edge.record.recorder import Recorder
from hil.edge.record.run_folder import RunFolder
from hil.edge.record.signals import SIGNALS, Step, recorded
from hil.review.ticks import read_events, read_ticks
from tests.review import toy
from tests.review.recorder_bench import open_on_a_full_disk


class BrokenTimeline:
    def tick(self, row: tuple[float, ...]) -> None:
        raise RuntimeError(f"viewer library is broken, {len(row)} values lost")

    def event(self, t_s: float, event: Event) -> None: ...

    def flush(self) -> None: ...

    def close(self) -> None: ...


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder.create(tmp_path / "run", toy.plan())


def test_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = (toy.record_run(tmp_path / name, until_s=230.0) for name in ("a", "b"))
    other = toy.record_run(tmp_path / "c", until_s=230.0, seed=2)
    for name in ("can.log", "sent.log", "ticks.csv", "events.jsonl"):
        assert (first.path / name).read_bytes() == (second.path / name).read_bytes()
    assert first.ticks_path.read_bytes() != other.ticks_path.read_bytes()


def test_can_log_reads_back_as_it_was_sent(folder: RunFolder) -> None:
    recorder = Recorder.open(folder, channel="vcan0")
    sent = [frame for index in range(50) for frame in toy.frames(0.1 * index, index)]
    for frame in sent:
        recorder.frame(*frame)
    recorder.frame(6.0, 0x7FF, b"", True)
    recorder.close("complete", "")
    with can.LogReader(folder.can_log_path) as reader:
        read = list(reader)
    assert len(read) == len(sent) + 1
    for message, (timestamp_s, frame_id, data, _) in zip(read[:-1], sent, strict=True):
        assert message.timestamp == pytest.approx(timestamp_s, abs=1e-6)
        assert (message.arbitration_id, bytes(message.data)) == (frame_id, data)
        assert (message.is_extended_id, message.channel) == (False, "vcan0")
    assert (read[-1].arbitration_id, read[-1].dlc) == (0x7FF, 0)
    with can.CanutilsLogReader(folder.sent_log_path) as reader:
        ours = [(message.timestamp, message.arbitration_id, bytes(message.data)) for message in reader]
    told = [(t_s, frame_id, data) for t_s, frame_id, data, is_rx in sent if not is_rx]
    assert [t_s for t_s, _, _ in ours] == pytest.approx([t_s for t_s, _, _ in told], abs=1e-6)
    assert [frame[1:] for frame in ours] == [frame[1:] for frame in told]


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x1ABCDEF, is_extended_id=True, data=b"\x01\x02"),
        can.Message(arbitration_id=0x12, is_extended_id=True, data=b"\x01"),
        can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(is_error_frame=True),
    ],
    ids=["extended", "extended, small id", "remote", "error"],
)
def test_odd_frames_read_back_as_they_came(folder: RunFolder, message: can.Message) -> None:
    recorder = Recorder.open(folder)
    recorder.message(1.25, message)
    recorder.close("complete", "")
    with can.LogReader(folder.can_log_path) as reader:
        (read,) = list(reader)
    assert read.timestamp == 1.25
    assert read.is_error_frame == message.is_error_frame
    if not message.is_error_frame:
        assert read.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)


def test_ticks_read_back_to_the_digits_kept(whole_run: RunFolder) -> None:
    ticks = read_ticks(whole_run.ticks_path)
    steps = list(toy.steps())
    assert len(ticks) == len(steps)
    for index in (0, 2010, 4999):
        record, truth = steps[index]
        signals = recorded("lockstep")
        expected = [signal.source(Step(record, truth)) for signal in signals]
        read = [ticks[signal.column][index] for signal in signals]
        np.testing.assert_allclose(read, expected, rtol=1e-5)
        np.testing.assert_allclose(read[2:10], expected[2:10], rtol=2e-9)
    assert ticks.has_truth


@pytest.mark.parametrize(
    ("mode", "missing"),
    [("lockstep", {"latency_s", "recorder_queue", "t_ns"}), ("live", {f"true_h{tank}_cm" for tank in (1, 2, 3, 4)})],
)
def test_columns_that_a_run_cannot_have_are_left_out(tmp_path: Path, mode: RunMode, missing: set[str]) -> None:
    """They used to be there, empty, and readers made text of them."""
    folder = toy.record_run(tmp_path / "run", live=mode == "live", until_s=1.0)
    header = folder.ticks_path.read_text().splitlines()[0].split(",")
    assert {signal.column for signal in SIGNALS} - set(header) == missing
    ticks = read_ticks(folder.ticks_path)
    assert ticks.has_truth == (mode == "lockstep")
    assert all(np.isnan(ticks.get(column)).all() for column in missing)


@pytest.mark.parametrize("mode", ["lockstep", "live"])
def test_every_number_column_is_one_type_from_its_first_line_on(tmp_path: Path, mode: RunMode) -> None:
    """A column that began with `3` and went on with `3.15988` was an integer to polars, which then failed.

    A float has a point, or is NaN; a counter never has. Steps without a value are NaN, not empty.
    """
    folder = RunFolder.create(tmp_path / "run", toy.plan(mode=mode))
    recorder = Recorder.open(folder)
    for record, truth in toy.steps(until_s=1.0):
        whole = record._replace(applied_V=(3.0, 0.0), measured_V=(float("nan"), 1e-7, 1e6, -0.0), t_s=round(record.t_s))
        recorder.tick(whole, None if mode == "live" else truth)
    recorder.close("complete", "")
    signals = {signal.column: signal for signal in recorded(mode)}
    header, *lines = folder.ticks_path.read_text().splitlines()
    for line in lines:
        for column, cell in zip(header.split(","), line.split(","), strict=True):
            is_float = "." in cell or cell == "NaN"
            assert is_float == (signals[column].digits is not None), (column, cell)
    assert read_ticks(folder.ticks_path)["h3_V"][0] == 1e6


def test_odd_numbers_before_the_first_measurement_are_recorded(folder: RunFolder) -> None:
    record = next(toy.steps())[0]
    nothing = (float("nan"),) * 4
    recorder = Recorder.open(folder)
    recorder.tick(record._replace(mode=Mode.DISARMED, measured_V=nothing, levels_age_s=float("inf")))
    recorder.close("complete", "")
    ticks = read_ticks(folder.ticks_path)
    assert np.isnan(ticks["h1_V"][0])
    assert np.isinf(ticks["levels_age_s"][0])


@pytest.mark.parametrize("cut", [1, 40, 300])
def test_a_line_cut_off_at_the_end_is_left_out(tmp_path: Path, whole_run: RunFolder, cut: int) -> None:
    path = tmp_path / "ticks.csv"
    path.write_bytes(whole_run.ticks_path.read_bytes()[:-cut])
    ticks = read_ticks(path)
    assert len(ticks) == 4999
    assert ticks["t_s"][-1] == pytest.approx(499.8)


def test_a_table_without_a_line_is_empty(tmp_path: Path) -> None:
    path = tmp_path / "ticks.csv"
    path.write_text("t_s,mode,h1_V\n0.1,2")
    assert len(read_ticks(path)) == 0


def test_events_keep_their_data_and_survive_odd_values() -> None:
    data = {"cause": "high_level", "size": np.float64(0.25), "gone": float("nan"), "many": (1, np.int64(2))}
    read = json.loads(event_line(1.5, Event(Severity.ERROR, "trip", "höher als 19 cm\n", data)))
    assert read["data"] == {"cause": "high_level", "size": 0.25, "gone": None, "many": [1, 2]}
    assert (read["t_s"], read["severity"], read["text"]) == (1.5, "ERROR", "höher als 19 cm\n")


def test_events_are_on_the_disk_as_they_happen(folder: RunFolder) -> None:
    recorder = Recorder.open(folder)
    recorder.event(-1.0, Event(Severity.INFO, "ready", "rig is ready"))
    assert [event.code for event in read_events(folder.events_path)] == ["ready"]
    recorder.close("complete", "")


def test_full_disk_shows_in_health_and_never_raises_into_the_loop(folder: RunFolder) -> None:
    user = open_on_a_full_disk(folder)
    for index, (record, _) in enumerate(toy.steps(until_s=5.0)):
        for frame in toy.frames(record.t_s, index):
            user.frame(*frame)
        user.tick(record)
    assert not user.health().is_ok
    assert "ticks.csv is lost" in user.health().errors[0]
    assert "No space left" in user.health().errors[0]
    user.close("complete", "")
    with can.LogReader(folder.can_log_path) as reader:
        assert len(list(reader)) == 15 * 50, "the other files go on"
    assert "recorder_failed" in [event.code for event in read_events(folder.events_path)]
    assert "ticks.csv is lost" in folder.manifest().recorder["errors"][0]


def test_folder_removed_mid_run_does_not_raise(folder: RunFolder) -> None:
    recorder = Recorder.open(folder)
    for path in folder.path.iterdir():
        path.unlink()
    folder.path.rmdir()
    for record, _ in toy.steps(until_s=1.0):
        recorder.tick(record)
    recorder.close("complete", "")
    assert "run.json" in recorder.health().errors[-1]


@pytest.mark.parametrize("name", ["can.log", "sent.log", "ticks.csv", "events.jsonl"])
@pytest.mark.parametrize("is_flushed", [True, False])
def test_a_file_that_somebody_removes_is_missed(folder: RunFolder, name: str, *, is_flushed: bool) -> None:
    """A run went on into a file without a name; the record was called complete, its report without any event."""
    recorder = Recorder.open(folder)
    (folder.path / name).unlink()
    if is_flushed:
        recorder.event(0.0, Event(Severity.INFO, "any", "any"))
        recorder.flush_files()
        assert recorder.health().errors == (f"{name} is lost from here on: somebody has removed it",)
    recorder.close("complete", "")
    assert folder.manifest().recorder["errors"] == [f"{name} is lost from here on: somebody has removed it"]


def test_a_broken_timeline_is_given_up_and_the_files_go_on(folder: RunFolder) -> None:
    recorder = Recorder.open(folder, timeline=BrokenTimeline())
    for record, _ in toy.steps(until_s=1.0):
        recorder.tick(record)
    recorder.close("complete", "")
    assert recorder.health().errors == (
        f"run.rrd is lost from here on: viewer library is broken, {len(recorded('lockstep'))} values lost",
    )
    assert len(read_ticks(folder.ticks_path)) == 10


def test_closing_twice_is_harmless(folder: RunFolder) -> None:
    recorder = Recorder.open(folder)
    recorder.close("stopped", "first")
    recorder.close("failed", "second")
    assert folder.manifest().reason == "first"
