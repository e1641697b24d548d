"""What counts as true of a drawn rig that the controller does not know: every report of an alarm, when it was made."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

from hil.bench import campaign_case
from hil.campaigns.cases import Case
from hil.campaigns.row import Row
from hil.core.types import Alarm, Event, Severity
from hil.edge.config.rig_file import load_rig
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import validated
from hil.loop import Outcome as Ending
from tests.campaign.campaign_bench import CONFIG, judged, seen
from tests.campaign.campaign_bench import RIG as BENCH

WEAK: dict[str, Any] = {"flow_ratio": [[0.75, 0.8], [1.0, 1.0]], "lag_s": [0.8, 0.2]}
CASE = Case("k", "l", "s", 1, {}, drawn=WEAK)
GAIN, ZONE_V = 0.9, 0.4


def share(pump: int, voltage_V: float) -> float:
    """Pump 1 has 0.9 of its gain and a dead zone of 0.4 V; pump 2 is as its file says."""
    return GAIN * max(voltage_V - ZONE_V, 0.0) / voltage_V if pump == 1 else 1.0


def pump(t_s: float, size: float, *, number: int = 1, target: int = 1, kind: str = "pump_effectiveness") -> Alarm:
    return Alarm(t_s, kind, target, size, isolated_s=t_s, number=number)


def nameless(t_s: float, kind: str, number: int = 1) -> Alarm:
    return Alarm(t_s, kind, 0, math.nan, candidates=("leak 1",), number=number)


def over(alarm: Alarm, t_s: float) -> Alarm:
    return replace(alarm, detected_s=t_s, size=math.nan, is_recovery=True)


def outcome(
    alarms: Sequence[Alarm],
    *,
    case: Case = CASE,
    voltage_V: float | np.ndarray = 3.0,
    assumed: float | np.ndarray = 0.78,
    ending: str = "complete",
) -> Row:
    """The row of a run of 10 s with these alarms, each made when it was detected."""
    events = tuple((one.detected_s, Event(Severity.WARNING, "alarm", "", asdict(one))) for one in alarms)
    run = replace(seen(v1_V=voltage_V, e1=assumed), events=events)
    end = Ending("stopped" if ending == "stopped" else "complete", "", 10.0, 100, 0, 0)
    return judged(run, case=case, bench=replace(BENCH, flow_share=share), ending=end)


def counts(row: Row) -> tuple[int, int]:
    return row.false_alarms, row.honest_alarms


@pytest.mark.parametrize(("size", "is_true"), [(0.78, True), (0.69, True), (0.87, True), (0.67, False), (0.89, False)])
def test_a_share_is_true_within_a_tenth_of_what_the_pump_gives_at_its_voltage(size: float, is_true: bool) -> None:
    assert counts(outcome([pump(1.0, size)])) == ((0, 1) if is_true else (1, 0))


def test_what_a_pump_gives_depends_on_its_voltage_by_dead_zone_and_curve() -> None:
    """0.69 is true at 2 V (0.72), and no longer at 9 V (0.86)."""
    low_then_high_V = np.where(np.arange(100) < 50, 2.0, 9.0)
    assert counts(outcome([pump(1.0, 0.69)], voltage_V=low_then_high_V, assumed=0.75)) == (0, 1)
    assert counts(outcome([pump(6.0, 0.69)], voltage_V=low_then_high_V, assumed=0.8)) == (1, 0)


def test_a_pump_that_stands_still_near_its_dead_zone_is_not_dead() -> None:
    """It gives nothing at 0.3 V, and a pump with 0.0 of its gain was reported; at 1 V it gives 0.54."""
    assert counts(outcome([pump(1.0, 0.0)], voltage_V=0.3, assumed=0.0)) == (1, 0)
    assert counts(outcome([pump(1.0, 0.5)], voltage_V=0.3, assumed=0.5)) == (0, 1)


def test_a_wrong_size_that_stands_for_a_moment_is_a_false_alarm() -> None:
    """0.396 for 0.4 s, then 0.78: by its last size the alarm was true."""
    assert counts(outcome([pump(1.0, 0.396), pump(1.4, 0.78)])) == (1, 0)
    assert counts(outcome([pump(1.0, 0.78), pump(1.4, 0.396)])) == (1, 0)
    assert counts(outcome([pump(1.0, 0.74), pump(1.4, 0.78)])) == (0, 1)


def test_a_wrong_name_before_the_true_one_is_a_false_alarm_and_an_open_question_is_not() -> None:
    leak = Alarm(1.0, "leak", 1, 0.2, isolated_s=1.0, number=1)
    assert counts(outcome([leak, pump(2.0, 0.78)])) == (1, 0)
    assert counts(outcome([nameless(1.0, "unresolved"), pump(2.0, 0.78)])) == (0, 1)


def test_what_the_controller_assumes_must_be_true_as_well() -> None:
    """0.78 of what had been reported as 0.78 is a pump with 0.61 of its flow."""
    assumed = np.where(np.arange(100) < 50, 0.78, 0.61)
    row = outcome([pump(1.0, 0.78), pump(6.0, 0.78, number=2)], assumed=assumed)
    assert counts(row) == (1, 1)
    reports = [one for told in json.loads(row.alarms_json) for one in told["reports"]]
    assert [one["assumed"] for one in reports] == [0.78, 0.61]
    assert [one["true"] for one in reports] == pytest.approx([0.78, 0.78])


def test_a_pump_that_is_said_to_have_recovered_must_be_as_its_file_says() -> None:
    weak, well = pump(1.0, 0.78), replace(pump(6.0, 0.97), is_recovery=True)
    assumed = np.where(np.arange(100) < 60, 0.78, 1.0)
    assert counts(outcome([weak, well], assumed=assumed)) == (1, 0)
    withdrawn = replace(well, size=math.nan)
    assert counts(outcome([weak, withdrawn], assumed=assumed)) == (0, 1), "it says no more than that it was wrong"


def test_a_lag_is_true_within_a_quarter_each_time_it_is_reported() -> None:
    """A lag of 0.8 s on a rig whose pump has just that counted as a false alarm once."""
    assert counts(outcome([pump(1.0, 0.9, kind="pump_lag")])) == (0, 1)
    assert counts(outcome([pump(1.0, 1.1, kind="pump_lag"), pump(2.0, 0.8, kind="pump_lag")])) == (1, 0)
    assert counts(outcome([pump(1.0, math.nan, kind="pump_lag")])) == (1, 0)
    assert counts(outcome([pump(1.0, 0.8, kind="pump_lag", target=2)])) == (1, 0)


def test_nothing_is_allowed_on_a_rig_that_the_controller_knows() -> None:
    known = replace(CASE, drawn={"gain_ratio": [0.8, 1.0]})
    assert counts(outcome([pump(1.0, 0.78)], case=known)) == (1, 0)
    assert counts(outcome([nameless(1.0, "unknown")], case=known)) == (1, 0)


def test_a_fault_under_the_number_of_an_honest_alarm_is_found() -> None:
    """On a drawn rig a weak pump has an open alarm when it fails; the update of that alarm used to count as nothing."""
    alarms = [pump(1.0, 0.76), replace(pump(4.5, 0.30), detected_s=1.0, isolated_s=1.0)]
    events = tuple(
        (t_s, Event(Severity.WARNING, "alarm", "", asdict(one))) for t_s, one in zip((1.0, 4.5), alarms, strict=True)
    )
    fault = {"kind": "pump_effectiveness", "target": 1, "value": 0.4, "at_s": 4.0}
    case = replace(CASE, scenario_data={"fault": [fault]})
    run, bench = replace(seen(e1=0.78), events=events), replace(BENCH, flow_share=share)
    one = judged(run, case=case, bench=bench)
    assert (one.right, one.false_alarms, one.honest_alarms) == (True, 0, 1)
    assert (one.detection_s, one.isolation_s) == (0.5, 0.5)
    known = judged(run, case=replace(case, drawn={}), bench=bench)
    assert (known.right, known.false_alarms) == (False, 1), "on a rig that is known the first alarm is false"


def test_an_open_question_that_is_withdrawn_is_false_and_counted_apart() -> None:
    """It names candidates where there is no fault."""
    leak = Alarm(4.0, "leak", 1, 0.1, isolated_s=4.0, number=3)
    asked = nameless(1.0, "unresolved")
    found = outcome([asked, over(asked, 2.0), leak, over(leak, 4.5)])
    assert (found.false_alarms, found.questions, found.honest_alarms) == (2, 1, 0)


def test_what_nothing_explains_is_neither_false_nor_honest_and_has_its_own_columns() -> None:
    unknown = nameless(3.0, "unknown", 2)
    found = outcome([unknown, over(unknown, 7.5)])
    assert (*counts(found), found.unknowns, found.unknown_s, found.unknown_long) == (0, 0, 1, 4.5, 0)
    asked = outcome([nameless(1.0, "unresolved"), nameless(4.0, "unknown")])
    assert (*counts(asked), asked.unknowns) == (0, 0, 1)
    assert asked.unknown_s == pytest.approx(6.0)
    wrong = outcome([pump(1.0, 0.3), nameless(4.0, "unknown")])
    assert (*counts(wrong), wrong.unknowns) == (1, 0, 1), "the wrong size before it was false all the same"


def test_something_unknown_that_ends_in_a_stop_or_stays_is_counted_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    alarms = [nameless(8.0, "unknown")]
    assert [outcome(alarms, ending=end).unknown_long for end in ("complete", "stopped")] == [0, 1]
    monkeypatch.setattr("hil.campaigns.told.LONG_UNKNOWN_S", 1.5)
    assert outcome(alarms).unknown_long == 1


def test_the_share_is_that_of_the_emulated_pump_over_its_file() -> None:
    """Dead zone and curve of the emulator against the straight pump of the rig file."""
    pumps = {"gain_cm3_Vs": [2.997, 3.35], "dead_zone_V": [0.4, 0.0], "curve_1_V": [0.0, -0.02]}
    case = Case("k", "l", "s", 1, {"scenario": {"name": "s", "duration_s": 1.0}, "emulator": {"pumps": pumps}})
    rig = load_rig(CONFIG / "rig.toml", validated(Scenario, case.scenario_data, "s"), CONFIG)
    flow_share = campaign_case.flow_share(rig, campaign_case.rig_numbers(case, CONFIG, "s"))
    assert flow_share(1, 3.0) == pytest.approx(0.9 * 2.6 / 3.0)
    assert flow_share(1, 0.3) == 0.0
    assert flow_share(2, 5.0) == pytest.approx(0.9)
