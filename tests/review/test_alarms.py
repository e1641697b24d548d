from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from hil.review.alarms import Injected, injected, judge, merged

PUMP = Injected("pump_effectiveness", 1, 0.4, 100.0)


def alarm(
    t_s: float, kind: str = "pump_effectiveness", target: int = 1, number: int = 1, **more: Any
) -> dict[str, Any]:
    return {"detected_s": t_s, "kind": kind, "target": target, "size": 0.4, "number": number, **more}


def test_changes_of_mind_after_isolation_are_counted() -> None:
    (finding,) = merged(
        [
            alarm(100.0, "unresolved", 0, candidates=("leak 1", "sensor_drift 1")),
            alarm(101.0, "leak", isolated_s=101.0),
            alarm(102.0, "sensor_drift", isolated_s=102.0),
            alarm(103.0, "leak", isolated_s=103.0),
            alarm(104.0, "leak", isolated_s=103.0, size=0.3),
        ]
    )
    assert (finding.kind, finding.flips, finding.isolated_s, finding.size) == ("leak", 2, 101.0, 0.3)


def test_an_unresolved_alarm_is_not_isolated() -> None:
    (finding,) = merged([alarm(100.0, "unresolved", 0, isolated_s=100.0)])
    assert finding.isolated_s is None


def test_a_recovery_closes_the_finding_and_the_number_is_free_again() -> None:
    first, second = merged([alarm(100.0), alarm(150.0, is_recovery=True), alarm(200.0)])
    assert (first.recovered_s, second.recovered_s, second.detected_s) == (150.0, None, 200.0)
    assert merged([alarm(5.0, is_recovery=True)]) == (), "nothing was said before that could be over"


def test_alarms_without_a_number_stand_for_themselves() -> None:
    assert len(merged([alarm(100.0, number=0), alarm(101.0, number=0)])) == 2


def test_numbers_that_are_none_are_not_known() -> None:
    (finding,) = merged([alarm(100.0, size=math.nan, onset_s=None)])
    assert (finding.size, finding.onset_s) == (None, None)


def test_the_right_name_wins_over_the_first_to_come() -> None:
    findings = merged([alarm(101.0, "leak", number=1), alarm(102.0, number=2)])
    verdict = judge((PUMP,), findings)
    assert verdict.answers == (findings[1],)
    assert (verdict.false, verdict.spurious) == ((), (findings[0],))


def test_a_fault_has_the_names_that_candidates_have() -> None:
    assert Injected("leak", 1, 0.2, 5.0).names == ("leak 1",)


def test_an_intermittent_fault_may_be_reported_each_time_it_comes_back() -> None:
    played = injected(
        [{"kind": "pump_effectiveness", "target": 1, "value": 0.4, "at_s": 100.0, "period_s": 9.0, "duty": 0.5}]
    )
    findings = merged([alarm(101.0), alarm(105.0, is_recovery=True), alarm(110.0), alarm(119.0, "leak", number=2)])
    verdict = judge(played, findings)
    assert verdict.answers == (findings[0],)
    assert (verdict.repeated, verdict.spurious) == ((findings[1],), (findings[2],))
    lasting = judge((PUMP,), findings)
    assert (lasting.repeated, lasting.spurious) == ((), findings[1:])
    growing = judge((replace(PUMP, ramp_s=50.0),), findings[:2])
    assert (growing.is_right, growing.repeated) == (True, findings[1:2])


def test_a_bias_that_grows_may_be_called_a_drift() -> None:
    grows, jumps = (Injected("sensor_bias", 2, 1.0, 100.0, ramp_s=ramp_s) for ramp_s in (50.0, 0.0))
    findings = merged([alarm(101.0, "sensor_drift", 2)])
    assert judge((grows,), findings).is_right
    assert not judge((jumps,), findings).is_right


def test_a_wrong_name_answers_where_there_is_no_right_one() -> None:
    findings = merged([alarm(101.0, "leak")])
    assert judge((PUMP,), findings).answers == findings
    assert judge((PUMP,), merged([alarm(99.9)])).answers == (None,), "too early to speak of it"


def test_two_faults_are_answered_in_their_order() -> None:
    both = (PUMP, Injected("leak", 2, 0.2, 200.0))
    findings = merged([alarm(101.0, number=1), alarm(202.0, "outlet_block", 2, number=2)])
    assert judge(both, findings).answers == findings
    late = merged([alarm(202.0, "leak", 2)])
    assert judge(both, late).answers == (None, late[0])


def test_a_fault_of_the_bus_explains_no_alarm() -> None:
    bus = Injected("frame_loss", 0, 0.05, 10.0)
    findings = merged([alarm(50.0)])
    assert judge((bus,), findings).false == findings


@pytest.mark.parametrize(
    ("alarms", "is_right"),
    [
        ([alarm(101.0)], True),
        ([], False),
        ([alarm(101.0, "leak")], False),
        ([alarm(101.0), alarm(50.0, "leak", number=2)], False),
        ([alarm(101.0), alarm(150.0, "leak", number=2)], False),
    ],
    ids=["named", "missed", "misnamed", "with a false alarm", "with a spurious alarm"],
)
def test_a_diagnosis_is_right_when_it_names_the_fault_and_nothing_else(
    alarms: list[dict[str, Any]], is_right: bool
) -> None:
    """Only the campaigns' tests noticed when false and spurious alarms no longer counted here."""
    assert judge((PUMP,), merged(alarms)).is_right == is_right


def test_a_scenarios_faults_are_taken_in_their_order() -> None:
    listed = [
        {"kind": "leak", "target": 2, "value": 0.1, "at_s": 20, "until_s": 30.0},
        {"kind": "pump_dead", "at_s": 5.0},
    ]
    assert injected(listed) == (Injected("pump_dead", 0, 0.0, 5.0), Injected("leak", 2, 0.1, 20.0, 30.0))
