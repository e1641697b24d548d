from __future__ import annotations

import re
from dataclasses import asdict, dataclass, fields, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from hil.campaigns import statistics
from hil.campaigns.campaign_report import render
from hil.campaigns.observer import Observer, rate_broken
from hil.campaigns.row import INVARIANTS, Row
from hil.campaigns.store import Store
from hil.cli import campaign_tables
from hil.core.types import Alarm, Event, Mode, Pair, Severity, TickRecord
from hil.edge.record.record_errors import RunFolderError
from tests.campaign.campaign_bench import FAULTY, REST, judged, row, seen


@dataclass
class Pump:
    applied_V: Pair = (3.0, 3.0)
    accepted: int = 0


@dataclass(frozen=True)
class Change:
    t_ns: int
    state: int
    applied_V: tuple[float, ...]
    cause: str = "command"
    node: str = "pump"


def at(step: int, value: float, otherwise: float, steps: int = 100) -> np.ndarray:
    values = np.full(steps, otherwise)
    values[step] = value
    return values


def test_a_run_says_how_much_it_asks_an_operator_to_look_at() -> None:
    def alarm(number: int, t_s: float) -> tuple[float, Event]:
        return t_s, Event(Severity.WARNING, "alarm", "", asdict(Alarm(t_s, "leak", 1, 0.3, number=number)))

    few = judged(replace(seen(), events=(alarm(1, 1.0), alarm(1, 2.0), alarm(2, 3.0))))
    assert (few.alarm_count, few.alarm_peak_10_min, few.alarm_floods, few.alarm_chattering) == (2, 2, 0, 0)
    many = judged(replace(seen(), events=tuple(alarm(number, 0.5 * number) for number in range(1, 12))))
    assert (many.alarm_count, many.alarm_floods) == (11, 1)
    text = render("some", [few, many])
    assert "6.5, 11" in text
    assert "1, 0" in text


def test_the_time_of_a_start_phase_counts_also_when_the_run_ends_in_it() -> None:
    t_s = np.arange(100) * 0.1 - 12.0
    row = judged(seen(t_s=t_s))
    assert (row.hours, row.healthy_h) == pytest.approx((10.0 / 3600, 10.0 / 3600))


def test_a_healthy_run_breaks_nothing() -> None:
    one = judged(seen())
    assert (one.breaks, one.broken, one.level_max_cm) == ((), "", 10.0)


def test_water_over_the_rim_is_an_overflow() -> None:
    assert judged(seen(), rest=replace(REST, spilled_cm3=1e-9)).breaks == ("overflow",)
    assert judged(seen(h3_cm=at(50, 20.001, 10.0))).breaks == ("overflow",)
    assert judged(seen(h3_cm=at(50, 20.0, 10.0))).breaks == ()


@pytest.mark.parametrize("jump_V", [1.9, 2.0])
def test_a_change_within_the_rate_is_fine(jump_V: float) -> None:
    assert judged(seen(v1_V=np.where(np.arange(100) >= 50, 3.0 + jump_V, 3.0))).breaks == ()


@pytest.mark.parametrize("pump", [1, 2])
@pytest.mark.parametrize("jump_V", [2.02, -2.02])
def test_a_steeper_one_is_not(pump: int, jump_V: float) -> None:
    one = judged(seen(100, **{f"v{pump}_V": np.where(np.arange(100) >= 50, 3.0 + jump_V, 3.0)}))
    assert one.breaks == ("rate_broken",)
    assert f"v{pump} from 3.000" in one.broken


def test_after_lost_commands_an_output_may_catch_up_and_going_to_zero_is_always_allowed() -> None:
    accepted = np.minimum(np.arange(100), 49) + np.maximum(np.arange(100) - 51, 0)  # two commands are lost
    assert rate_broken(seen(accepted=accepted, v1_V=np.where(np.arange(100) >= 52, 8.0, 3.0)), 20.0, 0.1) == ""
    assert rate_broken(seen(v1_V=np.where(np.arange(100) >= 50, 0.0, 9.0)), 20.0, 0.1) == ""


@pytest.mark.parametrize(("volts", "is_fine"), [(10.0, True), (10.001, False), (0.0, True), (-0.001, False)])
def test_outputs_out_of_range_are_seen_at_the_change(volts: float, is_fine: bool) -> None:
    observer = Observer((0.0, 10.0))
    observer.on_change(Change(1_000_000_000, 2, (3.0, volts)))
    assert (observer.result().range_broken == "") is is_fine


def test_a_node_that_moves_after_its_trip_is_seen_unless_it_was_cleared() -> None:
    observer = Observer((0.0, 10.0))
    observer.on_change(Change(1, 3, (0.0, 0.0), "watchdog"))
    observer.on_change(Change(2, 3, (0.0, 0.0)))
    assert observer.result().latch_broken == ""
    observer.on_change(Change(3, 1, (0.0, 0.0), "cleared"))
    observer.on_change(Change(4, 2, (3.0, 3.0)))
    assert observer.result().latch_broken == ""
    observer.on_change(Change(5, 3, (0.0, 0.0), "watchdog"))
    observer.on_change(Change(6, 0, (0.0, 0.0), "booted"))
    observer.on_change(Change(7, 2, (0.0, 0.1)))
    assert "moved again" in observer.result().latch_broken


@pytest.mark.parametrize(("after_s", "is_fine"), [(0.2, True), (0.3, False)])
def test_outputs_after_the_controllers_trip_are_seen(tick: TickRecord, after_s: float, is_fine: bool) -> None:
    observer = Observer((0.0, 10.0), Pump())
    for t_s in (5.0, 5.0 + after_s):
        observer.tick(tick._replace(t_s=t_s, mode=Mode.TRIPPED), (1.0, 1.0, 1.0, 1.0))
    assert (observer.result().latch_broken == "") is is_fine


@pytest.fixture
def tick() -> TickRecord:
    blank: dict[str, Any] = dict.fromkeys(TickRecord._fields, (0.0, 0.0))
    return TickRecord(**{**blank, "t_s": 0.0, "mode": Mode.RUNNING, "events": ()})


def test_an_observer_without_the_truth_is_of_no_use(tick: TickRecord) -> None:
    with pytest.raises(ValueError, match="truth"):
        Observer((0.0, 10.0), Pump()).tick(tick, None)


def test_what_was_declared_is_named_once_and_counted_with_the_alarms() -> None:
    alarms = [
        Alarm(2.0, "leak", 1, 0.1, isolated_s=2.0, number=1),
        Alarm(4.5, "unresolved", 0, 0.0, candidates=("sensor_drift 1", "leak 1"), number=2),
        Alarm(6.0, "leak", 1, 0.2, isolated_s=6.0, number=2),
        *(Alarm(7.0 + number, "sensor_bias", 1, 0.1, isolated_s=7.0, number=number) for number in (3, 4)),
    ]
    events = tuple((one.detected_s, Event(Severity.WARNING, "alarm", "", asdict(one))) for one in alarms)
    one = judged(replace(seen(), events=events))
    assert one.declared == "leak 1 + sensor_bias 1"
    assert (one.false_alarms, one.spurious_alarms, one.right, one.candidates_hold) == (1, 2, False, True)
    assert (one.detection_s, one.isolation_s) == (0.5, 2.0)


def test_voltage_after_the_end_and_pumps_without_water_are_seen() -> None:
    assert judged(seen(), rest=replace(REST, applied_V=(0.0, 1.0))).breaks == ("not_at_rest",)
    dry = replace(FAULTY, scenario_data={"fault": [{"kind": "reservoir_low", "at_s": 4.0}]})
    assert judged(seen(), case=dry).breaks == ("dry_run",)
    off = np.where(np.arange(100) * 0.1 > 5.9, 0.0, 3.0)
    assert judged(seen(v1_V=off, v2_V=off), case=dry).breaks == ()


def test_two_pumps_without_water_run_dry_whatever_the_reason() -> None:
    """Only an empty reservoir counted: two pumps that had faded to nothing broke no invariant."""
    t_s = np.arange(100) * 0.1
    gone = np.where(t_s >= 4.0, 0.04, 1.0)
    assert judged(seen(true_e1=gone, true_e2=gone)).breaks == ("dry_run",)
    assert judged(seen(true_e1=gone, true_e2=0.06)).breaks == ()  # one of them still gives water
    assert judged(seen(true_e1=gone, true_e2=gone, v1_V=0.5, v2_V=0.5)).breaks == ()
    pauses = np.where(t_s % 2.0 < 0.15, 0.0, 3.0)
    assert "dry_run" not in judged(seen(true_e1=gone, true_e2=gone, v1_V=pauses, v2_V=pauses)).breaks
    assert judged(seen(true_e1=np.nan, true_e2=np.nan)).breaks == ()  # nobody knows


def test_poisson_limits_are_the_exact_ones() -> None:
    """Garwood's table for 0 and 3 events, 95 %."""
    none = statistics.poisson_rate(0, 100.0)
    assert (none.per_h, none.low_h, none.high_h) == pytest.approx((0.0, 0.0, 0.03689), abs=1e-5)
    three = statistics.poisson_rate(3, 1.0)
    assert (three.low_h, three.high_h) == pytest.approx((0.6187, 8.7673), abs=1e-4)
    assert statistics.poisson_rate(0, 0.0).per_h is None


def rows() -> list[Row]:
    leak = {"label": "leak 1 = 0.2", "kind": "leak", "target": "1", "value": 0.2, "onset_s": 4.0, "healthy_h": 0.1}
    told = {**leak, "detected": True, "detection_s": 0.5, "isolation_s": 8.0, "right": True, "candidates_hold": True}
    return [
        row(key="a"),
        row(key="b", seed=2, false_alarms=1, declared="sensor_bias 1"),
        row(key="c", **told, bound_s=0.4, declared="leak 1"),
        row(key="d", **told, bound_s=0.6, declared="leak 1"),
        row(key="e", **{**told, "right": False}, declared="unresolved"),
        row(key="f", seed=77, **leak, detected=False, right=False),
        row(key="g", seed=3, label="pairs", overflow=True, broken="1 cm3 over the rim <", declared="x"),
    ]


def test_classes_confusion_and_false_alarms() -> None:
    (leak,) = statistics.fault_classes(rows())
    assert (leak.runs, leak.detected, leak.right, leak.candidates_hold) == (4, 0.75, 0.5, 0.75)
    assert (leak.detection.n, leak.detection.median, leak.bound_s) == (3, 0.5, 0.5)
    table = statistics.confusion(rows())
    assert table["leak 1 = 0.2"] == {"leak 1": 2, "unresolved": 1, "nothing": 1}
    assert table["no fault"] == {"nothing": 1, "sensor_bias 1": 1}
    assert "pairs" not in table
    rate = statistics.false_alarms(rows())
    assert rate.events == 1
    assert rate.hours == pytest.approx(1.5 + 0.4)
    broken = statistics.broken(rows())
    assert [one.seed for one in broken["overflow"]] == [3]
    assert set(broken) == set(INVARIANTS)


def test_the_report_stands_alone_and_names_the_seeds_of_what_broke() -> None:
    page = render("mine & yours", rows())
    assert "http" not in page
    assert "script" not in page
    assert "mine &amp; yours" in page
    assert "pairs: 3" in page
    assert "1 cm3 over the rim &lt;" in page
    assert page.count("<svg") == 1
    assert "bound 0.5 s" in page
    assert "1 in 1.9 h" in page
    assert render("empty", []).startswith("<!DOCTYPE html>")


def test_the_table_has_every_column_and_reads_back(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "out", {"name": "mine"})
    table = pq.read_table(store.write_table(rows()))
    assert table.column_names == [field.name for field in fields(Row)]
    assert {str(kind) for kind in table.schema.types} == {"string", "int64", "double", "bool"}
    assert [Row(**line) for line in table.to_pylist()] == rows()
    assert pq.read_table(store.write_table([])).num_rows == 0


def test_rows_come_back_but_for_those_that_crashed_and_those_that_are_none(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "out", {"name": "mine"})
    assert store.rows() == {}
    for one in (*rows(), row(key="bad", crashed=True)):
        store.add(one)
    with store.rows_path.open("a") as file:
        file.write("{}\n[]\nnonsense\n")
    assert list(store.rows().values()) == rows()
    store.manifest_path.write_text("nonsense")
    with pytest.raises(RunFolderError, match="can't be a campaign's folder"):
        Store.open(tmp_path / "out", {"name": "mine"})


def test_faults_that_were_not_played_are_told_apart_from_those_not_found() -> None:
    played = row(label="leak 1", detected=False, right=False)
    late = row(label="leak 1", not_played=1)
    (leaks,) = statistics.fault_classes([played, late])
    assert (leaks.runs, leaks.detected) == (1, 0.0)
    assert statistics.not_played([played, late]) == {"leak 1": 1}
    assert statistics.confusion([played, late]) == {"leak 1": {"nothing": 1}}
    assert "the run ended before the fault began: leak 1 (1)" in render("late", [played, late])


@pytest.mark.parametrize("width", [60, 100, 120])
def test_the_outcomes_are_readable_at_any_width(width: int) -> None:
    """At 60 columns the table used to be nothing but dots."""
    page = StringIO()
    console = Console(file=page, width=width, force_terminal=True, no_color=True)
    found = row(label="pump_effectiveness 1+2 = 0.4", detected=True, right=True, detection_s=0.3, isolation_s=0.5)
    campaign_tables.show(console, [replace(found, bound_s=0.2, size_error_5s=0.01)])
    text = re.sub(r"\x1b\[[0-9;]*m", "", page.getvalue())
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    for shown in ("pump_effectiveness 1+2 = 0.4", "100.0%", "0.3 / 0.3", "0.5 / 0.5", "0.01 / 0.01"):
        assert shown in text
