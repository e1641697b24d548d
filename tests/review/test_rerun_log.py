from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rerun.chunk import RrdReader

from hil.core.types import Event, Mode, Severity
from hil.edge.record.manifest import RunMode
from hil.edge.record.recorder import Recorder
from hil.edge.record.rerun_calls import compact
from hil.edge.record.rerun_log import TIMELINE, RerunLog, RunCard, series
from hil.edge.record.run_folder import RunFolder
from hil.edge.record.signals import recorded
from hil.review.blueprint import blueprint
from tests.review import toy


def rows(path: Path, entity: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path == entity and not chunk.is_static:
            found += chunk.to_record_batch().to_pylist()
    return found


def states(path: Path, entity: str) -> list[object]:
    return [row["StateChange:state"] for row in rows(path, entity)]


@pytest.mark.parametrize("mode", ["lockstep", "live"])
def test_every_signal_with_a_curve_is_drawn_once_from_its_own_place(mode: RunMode) -> None:
    columns = [signal.column for signal in recorded(mode)]
    drawn = [pair for one in series(mode) for pair in zip(one.signals, one.places, strict=True)]
    assert all(columns[place] == signal.column for signal, place in drawn)
    assert sorted(signal.column for signal, _ in drawn) == sorted(s.column for s in recorded(mode) if s.curve)


def test_recording_has_the_expected_entities_and_the_blueprint(whole_run: RunFolder) -> None:
    reader = RrdReader(whole_run.rrd_path)
    entities = {chunk.entity_path for chunk in reader.stream().to_chunks()}
    assert {f"/{one.entity}" for one in series("lockstep")} <= entities
    assert {
        "/states/mode",
        "/states/pump1",
        "/states/pump2",
        "/states/alarm",
        "/states/trip",
        "/log",
        "/card",
    } <= entities
    assert len(reader.blueprints()) == 1
    (recording,) = reader.recordings()
    assert (recording.application_id, recording.recording_id) == ("fourtank-hil", "whole")


def test_recording_has_every_step_on_run_time(whole_run: RunFolder) -> None:
    chunks = [c for c in RrdReader(whole_run.rrd_path).stream().to_chunks() if not c.is_static]
    steps = [chunk for chunk in chunks if chunk.entity_path == "/levels/tank1"]
    assert sum(chunk.num_rows for chunk in steps) == 5000
    assert {name for chunk in steps for name in chunk.timeline_names} == {TIMELINE}
    first = rows(whole_run.rrd_path, "/levels/tank1")[0]
    assert first["Scalars:scalars"][1] == pytest.approx(6.1), "true level in V"
    times = [row[TIMELINE] for row in rows(whole_run.rrd_path, "/bench/mode")]
    assert len(set(times)) == 5000


def test_recording_is_small(whole_run: RunFolder) -> None:
    assert whole_run.rrd_path.stat().st_size < 5e6


def test_states_follow_mode_pumps_and_alarms(whole_run: RunFolder) -> None:
    path = whole_run.rrd_path
    assert states(path, "/states/mode") == [["RUNNING"], ["DEGRADED"]]
    assert states(path, "/states/pump1") == [["nominal"], ["reduced"]]
    assert states(path, "/states/alarm") == [["none"], ["pump_effectiveness 1 + pump_effectiveness 2"]]
    assert states(path, "/states/trip") == [["none"]]
    assert len(rows(path, "/log")) == 3


def test_a_trip_is_a_state_until_the_mode_is_left(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    log = RerunLog(folder.rrd_path, RunCard("t", {}, ""), level_gain_V_cm=0.5, mode="lockstep", batch_ticks=3)
    recorder = Recorder.open(folder, timeline=log)
    record = next(toy.steps())[0]
    trip = Event(Severity.ERROR, "trip", "too high", {"cause": "high_level"})
    modes = [Mode.RUNNING, Mode.TRIPPED, Mode.TRIPPED, Mode.READY, Mode.RUNNING]
    for index, mode in enumerate(modes):
        events = (trip,) if index == 1 else ()
        recorder.tick(record._replace(t_s=float(index), mode=mode, events=events))
    recorder.close("complete", "")
    assert states(folder.rrd_path, "/states/trip") == [["none"], ["high_level"], ["none"]]
    assert states(folder.rrd_path, "/states/mode") == [["RUNNING"], ["TRIPPED"], ["READY"], ["RUNNING"]]


def test_compacting_keeps_every_step_and_the_blueprint(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    log = RerunLog(
        folder.rrd_path,
        RunCard("small", {}, ""),
        level_gain_V_cm=0.5,
        mode="lockstep",
        blueprint=blueprint("lockstep"),
        batch_ticks=2,
    )
    recorder = Recorder.open(folder, timeline=log)
    for record, truth in toy.steps(until_s=40.0):
        recorder.tick(record, truth)
    recorder.close("complete", "")
    before = folder.rrd_path.stat().st_size
    compact(folder.rrd_path)
    assert folder.rrd_path.stat().st_size < before / 4
    assert len(rows(folder.rrd_path, "/levels/tank1")) == 400
    assert len(RrdReader(folder.rrd_path).blueprints()) == 1
    assert not list(folder.path.glob(".*"))
