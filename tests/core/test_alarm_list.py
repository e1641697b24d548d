"""The alarm list of a run: states by ISA-18.2, what can be hidden, and what a run without an operator does."""

from __future__ import annotations

from typing import Any

import pytest

from hil.core.alarm_catalogue import EVENT_BY_CODE, FAULT_BY_KIND, TRIP_BY_CAUSE, Priority
from hil.core.alarm_list import ALL, AlarmList
from hil.core.fault_kinds import FaultKind
from hil.core.types import NAMELESS, TripCause


def alarm(number: int, kind: str = "leak", *, is_recovery: bool = False) -> dict[str, Any]:
    return {"number": number, "kind": kind, "target": 1, "is_recovery": is_recovery}


def after(*events: tuple[float, str, dict[str, Any]]) -> AlarmList:
    alarms = AlarmList()
    for t_s, code, data in events:
        alarms = alarms.take(code, f"{code} at {t_s:g}", data, t_s)
    return alarms


def states(alarms: AlarmList, t_s: float) -> dict[str, str]:
    return {row["key"]: row["state"] for row in alarms.rows(t_s)}


def test_an_alarm_goes_through_its_states() -> None:
    alarms = after((10.0, "alarm", alarm(1)))
    assert states(alarms, 11.0) == {"alarm:1": "active"}
    seen, problem = alarms.acknowledge("alarm:1")
    assert problem == ""
    assert states(seen, 12.0) == {"alarm:1": "acknowledged"}
    assert states(seen.take("alarm", "over", alarm(1, is_recovery=True), 13.0), 13.0) == {}
    returned = alarms.take("alarm", "over", alarm(1, is_recovery=True), 13.0)
    assert states(returned, 13.0) == {"alarm:1": "returned"}
    assert states(returned.acknowledge(ALL)[0], 14.0) == {}


def test_an_alarm_that_comes_again_is_counted_and_not_acknowledged() -> None:
    alarms, _ = after((1.0, "alarm", alarm(1)), (2.0, "alarm", alarm(1, is_recovery=True))).acknowledge("alarm:9")
    again = alarms.take("alarm", "again", alarm(1), 3.0)
    (row,) = again.rows(3.0)
    assert (row["state"], row["count"], row["since_s"], row["title"]) == ("active", 2, 3.0, "again")


def test_an_update_keeps_the_acknowledgement_unless_it_is_more_urgent() -> None:
    seen, _ = after((1.0, "alarm", alarm(1, "unresolved"))).acknowledge(ALL)
    named = seen.take("alarm", "sensor_bias 1", alarm(1, "sensor_bias"), 2.0)
    assert states(named, 2.0) == {"alarm:1": "acknowledged"}
    worse = seen.take("alarm", "leak 1", alarm(1, "leak"), 2.0)
    (row,) = worse.rows(2.0)
    assert (row["state"], row["priority"], row["since_s"], row["count"]) == ("active", "high", 2.0, 1)


def test_a_hidden_alarm_that_becomes_more_urgent_is_shown() -> None:
    """A leak was hidden for an hour because somebody had shelved the noise that it was taken for at first."""
    hidden, _ = after((1.0, "alarm", alarm(1, "sensor_noise"))).shelve("alarm:1", 3600.0, 2.0)
    same = hidden.take("alarm", "sensor_noise 1", alarm(1, "sensor_noise"), 3.0)
    assert states(same, 3.0) == {"alarm:1": "shelved"}
    worse = hidden.take("alarm", "leak 1", alarm(1, "leak"), 3.0)
    assert states(worse, 3.0) == {"alarm:1": "active"}
    assert worse.unattended(10.0, 13.0) == "leak 1"


def test_the_most_urgent_comes_first_and_what_is_hidden_last() -> None:
    alarms = after(
        (1.0, "bypass", {"interlock": "dry_run"}),
        (2.0, "alarm", alarm(1, "sensor_bias")),
        (3.0, "alarm", alarm(2, "leak")),
        (4.0, "alarm", alarm(3, "sensor_drift")),
    )
    assert list(states(alarms, 5.0)) == ["alarm:2", "alarm:3", "alarm:1", "bypass:dry_run"]
    hidden, _ = alarms.shelve("alarm:2", 10.0, 5.0)
    assert list(states(hidden, 6.0)) == ["alarm:3", "alarm:1", "bypass:dry_run", "alarm:2"]
    assert states(hidden, 6.0)["alarm:2"] == "shelved"
    assert states(hidden, 15.0)["alarm:2"] == "active"
    assert states(hidden.shelve("alarm:2", 0.0, 7.0)[0], 7.0)["alarm:2"] == "active"


@pytest.mark.parametrize(
    ("key", "for_s", "says"),
    [
        ("trip", 10.0, "trip can't be shelved"),
        ("alarm:1", 3601.0, "outside 0..3600"),
        ("alarm:7", 1.0, "alarm:1, trip"),
    ],
)
def test_what_can_not_be_hidden_says_why(key: str, for_s: float, says: str) -> None:
    alarms = after((1.0, "alarm", alarm(1)), (2.0, "trip", {"cause": "high_level"}))
    same, problem = alarms.shelve(key, for_s, 3.0)
    assert says in problem
    assert same is alarms


def test_a_trip_stays_until_it_is_cleared_and_seen() -> None:
    seen, _ = after((1.0, "trip", {"cause": "pump_stuck_on"}), (1.0, "relay_cut", {})).acknowledge(ALL)
    assert set(states(seen, 2.0)) == {"trip", "relay_cut"}
    assert states(seen.take("mode", "cleared", {"mode": "DISARMED"}, 3.0), 3.0) == {}


def test_events_without_an_end_leave_when_they_are_seen() -> None:
    alarms = after(
        (1.0, "recorder_failed", {}), (2.0, "target", {}), (3.0, "note", {}), (4.0, "mode", {"mode": "MANUAL"})
    )
    assert set(states(alarms, 5.0)) == {"recorder_failed", "target"}
    assert states(alarms.take("reference", "", {}, 6.0).acknowledge(ALL)[0], 7.0) == {}


def test_an_alarm_of_high_priority_must_be_seen_in_time() -> None:
    alarms = after((1.0, "alarm", alarm(1, "leak")), (1.0, "alarm", alarm(2, "sensor_bias")))
    assert alarms.unattended(60.0, 60.9) == ""
    assert alarms.unattended(60.0, 61.0) == "alarm at 1"
    assert alarms.acknowledge("alarm:1")[0].unattended(60.0, 900.0) == ""
    assert alarms.shelve("alarm:1", 100.0, 2.0)[0].unattended(60.0, 101.0) == ""
    assert alarms.shelve("alarm:1", 100.0, 2.0)[0].unattended(60.0, 102.0) == "alarm at 1"


def test_everything_that_can_happen_is_explained() -> None:
    assert list(TRIP_BY_CAUSE) == [cause.value for cause in TripCause]
    of_process = {kind.value for kind in FaultKind if kind.is_of_the_process}
    assert set(FAULT_BY_KIND) == of_process | set(NAMELESS)
    rows = [*TRIP_BY_CAUSE.values(), *FAULT_BY_KIND.values(), *EVENT_BY_CODE.values()]
    for row in rows:
        assert row.cause
        assert row.action
        assert row.respond_s <= 120.0 if row.priority is Priority.HIGH else row.respond_s >= 60.0
