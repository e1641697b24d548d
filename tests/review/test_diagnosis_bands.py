"""What the recording says of the diagnosis: values with their deviations, and open candidates."""

from __future__ import annotations

from math import nan
from pathlib import Path
from typing import Any

import pytest
from rerun.chunk import RrdReader

from hil.edge.record.rerun_log import TIMELINE
from tests.review.test_rerun_log import states
from tests.review.test_tank_picture import alarm, record_of, recorded

STD_V = (0.002, 0.003, 0.004, 0.005)


def bands(path: Path, entity: str) -> list[tuple[float, float, float]]:
    """(time, value, variance) of each row."""
    found: list[Any] = []
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path == f"/diagnosis/{entity}" and not chunk.is_static:
            found += chunk.to_record_batch().to_pylist()
    rows = [(row[TIMELINE].total_seconds(), row["Measurements:values"], row["Measurements:variances"]) for row in found]
    return sorted((t_s, value[0], variance[0]) for t_s, value, variance in rows)


def test_levels_have_the_deviation_of_the_filter_once_a_second(tmp_path: Path) -> None:
    steps = [record_of(0.5 * k)._replace(level_std_V=STD_V) for k in range(5)]
    path = recorded(tmp_path / "run", steps)
    found = bands(path, "levels/tank2")
    assert [t_s for t_s, _, _ in found] == [0.0, 1.0, 2.0]
    assert {(value, round(variance, 9)) for _, value, variance in found} == {(6.5, 9e-6)}


def test_a_detector_without_a_filter_has_no_bands(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", [record_of(0.0)._replace(level_std_V=(nan, nan, nan, nan))])
    assert not bands(path, "levels/tank1")


def test_effectiveness_has_the_deviation_of_its_last_report(tmp_path: Path) -> None:
    report = alarm(kind="pump_effectiveness", target=1, size=0.4, size_std=0.1)
    over = alarm(kind="pump_effectiveness", target=1, size=1.0, size_std=0.1, is_recovery=True)
    faulty = {"effectiveness": (0.4, 1.0)}
    steps = [record_of(0.0, effectiveness=(1.0, 1.0)), record_of(1.0, events=(report,), **faulty)]
    steps += [record_of(2.0, **faulty), record_of(3.0, events=(over,), effectiveness=(1.0, 1.0))]
    path = recorded(tmp_path / "run", steps)
    expected = [(0.0, 1.0, 0.0), (1.0, 0.4, 0.01), (2.0, 0.4, 0.01), (3.0, 1.0, 0.0)]
    for found, wanted in zip(bands(path, "effectiveness/pump1"), expected, strict=True):
        assert found == pytest.approx(wanted)
    assert {variance for _, _, variance in bands(path, "effectiveness/pump2")} == {0.0}
    assert bands(path, "sizes/pump_effectiveness_1")[0] == pytest.approx((1.0, 0.4, 0.01))


def test_candidates_are_a_state_until_the_fault_is_isolated(tmp_path: Path) -> None:
    open_alarm = alarm(kind="unresolved", target=0, size=nan, candidates=("leak 3", "sensor_drift 3"))
    named = alarm(kind="leak", target=3, size=0.2, size_std=0.04)
    steps = [record_of(0.0), record_of(1.0, events=(open_alarm,)), record_of(2.0, events=(named,)), record_of(4.0)]
    path = recorded(tmp_path / "run", steps)
    assert states(path, "/diagnosis/candidates") == [["none"], ["leak 3 or sensor_drift 3"], ["none"]]
    sizes = bands(path, "sizes/leak_3")
    assert [t_s for t_s, _, _ in sizes] == [2.0, 4.0], "its report, and the newest step: a line"
