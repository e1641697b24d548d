"""How many alarms a run asks an operator to look at: counts, floods, chattering and stale alarms."""

from __future__ import annotations

from typing import Any

import pytest

from hil.review.alarm_attention import attention, load_in_words
from hil.review.alarm_load import AlarmLoad, alarm_load
from hil.review.ticks import LoggedEvent


def leak(t_s: float, number: int, *, is_over: bool = False) -> LoggedEvent:
    data = {"number": number, "kind": "leak", "target": 1, "is_recovery": is_over}
    return LoggedEvent(t_s, "WARN", "alarm", f"leak 1, number {number}", data)


def asked(t_s: float, **request: Any) -> LoggedEvent:
    return LoggedEvent(t_s, "INFO", "operator", "", {"request": request, "user": "ada", "pid": 1})


def load(*events: LoggedEvent, to_s: float = 1200.0) -> AlarmLoad:
    return alarm_load(events, 0.0, to_s)


def test_a_quiet_run_asks_for_nothing() -> None:
    quiet = load(LoggedEvent(1.0, "INFO", "reference", "", {}))
    assert (quiet.count, quiet.per_10_min, quiet.peak_10_min, quiet.floods, quiet.left) == (0, 0.0, 0, (), 0)
    assert attention("", quiet, ()) == ""


def test_alarms_are_counted_when_they_begin_and_not_when_they_are_updated() -> None:
    some = load(leak(10.0, 1), leak(11.0, 1), leak(20.0, 2), leak(30.0, 1, is_over=True), leak(700.0, 1))
    assert (some.count, some.by_priority, some.peak_10_min) == (3, {"high": 3, "medium": 0, "low": 0}, 2)
    assert some.per_10_min == pytest.approx(1.5)
    assert some.left == 2


def test_a_short_run_is_not_blown_up_to_ten_minutes() -> None:
    assert load(leak(1.0, 1), to_s=60.0).per_10_min == 1.0


def test_what_the_operator_acknowledged_is_not_left() -> None:
    events = (leak(10.0, 1), asked(12.0, do="ack", alarm="alarm:1"), leak(20.0, 2), asked(22.0, do="note", text="ack"))
    assert load(*events).left == 1
    assert "alarm:2" not in load_in_words(load(*events))


def test_a_flood_lasts_until_few_alarms_come() -> None:
    eleven = [leak(10.0 * number, number) for number in range(1, 12)]
    assert load(*eleven[:10]).floods == ()
    ((begun_s, ended_s),) = load(*eleven).floods
    assert begun_s == 110.0
    assert ended_s == 670.0  # the 7th of 11 is then older than 10 min, and 4 are left
    assert load(*eleven, to_s=300.0).floods == ((110.0, 300.0),)


def test_an_alarm_that_comes_and_goes_chatters() -> None:
    def times(*at_s: float) -> list[LoggedEvent]:
        return [event for t_s in at_s for event in (leak(t_s, 1), leak(t_s + 1.0, 1, is_over=True))]

    assert load(*times(10.0, 40.0, 69.0)).chattering == ("alarm:1",)
    assert load(*times(10.0, 40.0, 71.0)).chattering == ()


def test_an_alarm_of_yesterday_is_stale() -> None:
    day_s = 86_400.0
    assert load(leak(10.0, 1), to_s=day_s + 11.0).stale == ("alarm:1",)
    assert load(leak(10.0, 1), leak(20.0, 1, is_over=True), to_s=day_s + 11.0).stale == ()
    gone = leak(day_s + 100.0, 1, is_over=True)
    assert load(leak(10.0, 1), gone, to_s=day_s + 200.0).stale == ("alarm:1",)


def test_the_report_shows_the_list_and_what_to_do() -> None:
    events = (leak(10.0, 1), leak(20.0, 2), asked(22.0, do="shelve", alarm="alarm:1", for_s=60.0))
    html = attention("first", load(*events), events)
    assert "first: 2 alarms (2 high)" in html
    assert html.index("leak 1, number 2") < html.index("leak 1, number 1")  # the shelved one comes last
    assert "look under the tank" in html
