"""The picture of the tanks, read back from the recording."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from hil.core.tanks import TankModel, outflows
from hil.core.types import Alarm, Event, Mode, Severity, TickRecord
from hil.edge.record.picture_faults import PresentFaults
from hil.edge.record.picture_layout import CORNERS, FLOWS, RADIUS_PER_FLOW, TALLEST
from hil.edge.record.picture_model import PictureModel
from hil.edge.record.recorder import Recorder
from hil.edge.record.rerun_log import TIMELINE, RerunLog, RunCard
from hil.edge.record.run_folder import RunFolder
from tests.review import toy

MODEL = TankModel(level_gain_V_cm=toy.GAIN_V_CM)
LEVEL_V = (6.0, 6.5, 0.8, 0.7)


def alarm(**fields: Any) -> Event:
    data = asdict(Alarm(**{"detected_s": 1.0, "number": 1, **fields}))
    return Event(Severity.WARNING, "alarm", "an alarm", data)


def record_of(t_s: float, **fields: Any) -> TickRecord:
    base = next(toy.steps())[0]
    still = {"estimated_V": LEVEL_V, "measured_V": LEVEL_V, "applied_V": (3.0, 4.0), "command_V": (3.0, 4.0)}
    return base._replace(t_s=t_s, **{"events": (), **still, **fields})


def recorded(path: Path, records: list[TickRecord]) -> Path:
    """The recording of these steps."""
    folder = RunFolder.create(path, toy.plan())
    card = RunCard("picture", {}, "")
    log = RerunLog(folder.rrd_path, card, level_gain_V_cm=0.5, mode="lockstep", picture=PictureModel(MODEL))
    recorder = Recorder.open(folder, timeline=log)
    for record in records:
        recorder.tick(record)
    recorder.close("complete", "")
    assert recorder.health().is_ok, recorder.health()
    return folder.rrd_path


def changes(path: Path, entity: str) -> list[dict[str, Any]]:
    """The rows of an entity, as (component -> value), in the order of time."""
    found: list[dict[str, Any]] = []
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path == f"/picture/{entity}" and not chunk.is_static:
            found += chunk.to_record_batch().to_pylist()
    return sorted(found, key=lambda row: row[TIMELINE])


def texts(path: Path, entity: str) -> list[list[str]]:
    return [row["Points2D:labels"] for row in changes(path, entity)]


def test_water_stands_as_high_as_the_estimated_level(tmp_path: Path) -> None:
    higher = (8.0, *LEVEL_V[1:])
    path = recorded(tmp_path / "run", [record_of(0.0), record_of(0.2), record_of(0.4, estimated_V=higher)])
    rows = changes(path, "water/tank1")
    assert [row[TIMELINE].total_seconds() for row in rows] == [0.0, 0.4], "what does not change is not recorded again"
    for row, level_cm in zip(rows, (12.0, 16.0), strict=True):
        assert row["Transform3D:scale"][0][1] == pytest.approx(level_cm / 20.0, rel=1e-5)
        assert row["Transform3D:translation"][0][1] == pytest.approx(
            CORNERS[0][1] - level_cm * TALLEST / 20.0, rel=1e-5
        )
    assert texts(path, "text/tanks")[-1] == ["tank 1: 16.0 cm", "tank 2: 13.0 cm", "tank 3: 1.6 cm", "tank 4: 1.4 cm"]


def test_widths_of_the_flows_balance_as_the_model_says(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", [record_of(0.0, effectiveness=(0.5, 1.0))])
    (row,) = changes(path, "flows")
    flow = dict(zip((name for name, _, _ in FLOWS), np.array(row["LineStrips2D:radii"]) / RADIUS_PER_FLOW, strict=True))
    out = outflows(MODEL, (12.0, 13.0, 1.6, 1.4), (1.5, 4.0))
    assert flow["pump 1"] == pytest.approx(0.5 * 3.33 * 3.0, rel=1e-5)
    assert flow["pump 1 to tank 1"] == pytest.approx(0.7 * flow["pump 1"], rel=1e-5)
    assert flow["pump 1 to tank 4"] == pytest.approx(0.3 * flow["pump 1"], rel=1e-5)
    assert flow["pump 2 to tank 2"] + flow["pump 2 to tank 3"] == pytest.approx(3.35 * 4.0, rel=1e-5)
    names = ("out of tank 1", "out of tank 2", "tank 3 to tank 1", "tank 4 to tank 2")
    assert [flow[name] for name in names] == pytest.approx(list(out), rel=1e-5)


def test_a_diagnosed_fault_has_a_mark_and_a_text_until_it_is_over(tmp_path: Path) -> None:
    open_question = alarm(kind="unresolved", target=0, size=float("nan"), candidates=("leak 3", "sensor_drift 3"))
    named = alarm(kind="leak", target=3, size=0.2)
    over = alarm(kind="leak", target=3, size=0.0, is_recovery=True)
    steps = [record_of(0.0), record_of(1.0, events=(open_question,)), record_of(2.0, events=(named,))]
    path = recorded(tmp_path / "run", [*steps, record_of(3.0, events=(over,))])
    shown = texts(path, "faults/text")
    assert shown[0] == ["?", "?", "not isolated yet: leak 3 or sensor drift 3"]
    assert shown[1] == ["leak, tank 3: 20 % of its outlet"]
    assert not shown[2]
    assert [len(row["LineStrips2D:strips"] or []) for row in changes(path, "faults/marks")] == [0, 1, 0]


def test_a_blocked_outlet_lets_less_out_and_a_shifted_valve_splits_otherwise(tmp_path: Path) -> None:
    blocked = alarm(kind="outlet_block", target=1, size=0.6, number=1)
    shifted = alarm(kind="valve_split", target=2, size=0.3, number=2)
    path = recorded(tmp_path / "run", [record_of(0.0), record_of(1.0, events=(blocked, shifted)), record_of(1.2)])
    before, after = (np.array(row["LineStrips2D:radii"]) for row in changes(path, "flows"))
    place = {name: number for number, (name, _, _) in enumerate(FLOWS)}
    assert after[place["out of tank 1"]] == pytest.approx(0.4 * before[place["out of tank 1"]], rel=1e-5)
    assert after[place["pump 2 to tank 2"]] == pytest.approx(0.5 * before[place["pump 2 to tank 2"]], rel=1e-5)
    assert texts(path, "text/valves")[-1][3:] == ["valve 2", "30 % to tank 2", "70 % to tank 3"]


def test_pumps_and_mode_are_in_words(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", [record_of(0.0), record_of(0.2, mode=Mode.TRIPPED, applied_V=(0.0, 0.0))])
    assert texts(path, "text/mode") == [["RUNNING"], ["TRIPPED"]]
    assert texts(path, "text/pumps")[-1][:4] == ["pump 1", "command 3.00 V", "applied 0.00 V", "gain 100 %"]


def test_no_more_than_five_pictures_a_second(tmp_path: Path) -> None:
    records = [record_of(0.01 * k, command_V=(0.1 * k, 0.0)) for k in range(100)]
    path = recorded(tmp_path / "run", records)
    times = [row[TIMELINE].total_seconds() for row in changes(path, "text/pumps")]
    assert times == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])


def test_alarms_without_a_number_are_kept_apart() -> None:
    faults = PresentFaults()
    for kind, target in (("leak", 1), ("sensor_stuck", 2)):
        faults = faults.with_alarm({"kind": kind, "target": target, "number": 0})
    assert len(faults.marks()) == 2
