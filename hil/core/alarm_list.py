"""The alarm list of a run, by the habits of process plants (ISA-18.2, IEC 62682): what to look at, and how soon.

active -> acknowledged         somebody acknowledges it
active -> returned             its cause is over, and nobody has acknowledged it
acknowledged, and over         it leaves the list; so does a returned alarm when it is acknowledged
returned -> active             its cause is there again: its count goes up
any but a trip -> shelved      hidden for a time that somebody chooses; then it is what it would be without
shelved -> active              it becomes more urgent: what was hidden was the lesser one

Fed with the events of a run: `alarm` of the diagnosis, `trip` and `stop`, and those of `alarm_catalogue.EVENTS`. An
event without an end, such as a trip, is over when it is acknowledged, a trip not before it is cleared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from hil.core.alarm_catalogue import EVENT_BY_CODE, FAULT_BY_KIND, TRIP_BY_CAUSE, Explanation, Priority
from hil.core.types import Event, Mode

SHELVED_MAX_S = 3600.0
"""Longest time for which an alarm can be hidden."""

ALL = "all"
"""Instead of a key: every alarm of the list."""

NOT_SHELVED = ("trip", "relay_cut")
"""Alarms that can't be hidden."""

NEVER_S = float("-inf")

ONCE = ("bus_error", "recorder_failed", "recorder_lost", "record_dropped")
"""Events without an end: they leave the list when somebody acknowledges them."""


class AlarmState(StrEnum):
    """See the rules above."""

    ACTIVE = "active"
    ACKNOWLEDGED = "acknowledged"
    RETURNED = "returned"
    SHELVED = "shelved"


@dataclass(frozen=True, slots=True)
class ListedAlarm:
    """One alarm of the list.

    key : by which it is acknowledged, such as `alarm:2`, `trip`, `bypass:dry_run`. since_s : run time at which it last
    became active. count : how often it has become active. shelved_until_s : hidden until this run time.
    """

    key: str
    title: str
    explanation: Explanation
    since_s: float
    count: int = 1
    is_over: bool = False
    is_acknowledged: bool = False
    shelved_until_s: float = NEVER_S

    def state(self, t_s: float) -> AlarmState:
        """At run time t_s."""
        if t_s < self.shelved_until_s:
            return AlarmState.SHELVED
        if self.is_acknowledged:
            return AlarmState.ACKNOWLEDGED
        return AlarmState.RETURNED if self.is_over else AlarmState.ACTIVE

    def as_row(self, t_s: float) -> dict[str, Any]:
        """As the control channel sends it, at run time t_s."""
        return {
            "key": self.key,
            "title": self.title,
            "priority": self.explanation.priority.value,
            "state": self.state(t_s).value,
            "since_s": self.since_s,
            "count": self.count,
            "respond_s": self.explanation.respond_s,
            "cause": self.explanation.cause,
            "action": self.explanation.action,
            "shelved_s": max(self.shelved_until_s - t_s, 0.0),
        }


@dataclass(frozen=True, slots=True)
class Change:
    """What an event does to the list: an alarm begins or goes on under another title, or is over."""

    key: str
    title: str = ""
    explanation: Explanation | None = None
    is_over: bool = False


@dataclass(frozen=True, slots=True)
class AlarmList:
    """The alarms in the order in which they first came."""

    alarms: tuple[ListedAlarm, ...] = ()

    def find(self, key: str) -> ListedAlarm | None:
        """The alarm of that key."""
        return next((alarm for alarm in self.alarms if alarm.key == key), None)

    def take(self, code: str, text: str, data: Mapping[str, Any], t_s: float) -> AlarmList:
        """The list after an event of the run; the same object if it changes nothing."""
        changed = self
        for change in changes_of(code, text, data):
            changed = changed._with(change, t_s)
        return changed

    def take_all(self, events: Iterable[Event], t_s: float) -> AlarmList:
        """The list after the events of a step."""
        changed = self
        for event in events:
            changed = changed.take(event.code, event.text, event.data, t_s)
        return changed

    def acknowledge(self, key: str) -> tuple[AlarmList, str]:
        """Acknowledge one alarm, or `ALL`; and why that is refused, or ""."""
        if key != ALL and self.find(key) is None:
            return self, self._unknown(key)
        seen = [replace(alarm, is_acknowledged=True) if key in (ALL, alarm.key) else alarm for alarm in self.alarms]
        return AlarmList(tuple(alarm for alarm in seen if not _leaves(alarm))), ""

    def shelve(self, key: str, for_s: float, t_s: float) -> tuple[AlarmList, str]:
        """Hide an alarm for for_s from run time t_s on, 0 to end that; and why that is refused, or ""."""
        alarm = self.find(key)
        if alarm is None:
            return self, self._unknown(key)
        if not 0.0 <= for_s <= SHELVED_MAX_S:
            return self, f"for_s {for_s:g} is outside 0..{SHELVED_MAX_S:g} s"
        if key in NOT_SHELVED:
            return self, f"{key} can't be shelved"
        return self._replaced(replace(alarm, shelved_until_s=t_s + for_s)), ""

    def rows(self, t_s: float, at_most: int | None = None) -> list[dict[str, Any]]:
        """For an operator, at run time t_s: the most urgent first, of those the newest; shelved ones last."""

        def urgency(alarm: ListedAlarm) -> tuple[bool, bool, int, float]:
            state = alarm.state(t_s)
            is_seen = state is AlarmState.ACKNOWLEDGED
            return state is AlarmState.SHELVED, is_seen, alarm.explanation.priority.rank, -alarm.since_s

        return [alarm.as_row(t_s) for alarm in sorted(self.alarms, key=urgency)[:at_most]]

    def unattended(self, for_s: float, t_s: float) -> str:
        """Title of an alarm of high priority that nobody has acknowledged or shelved for for_s; "" if there is none."""
        for alarm in self.alarms:
            waits = alarm.state(t_s) in (AlarmState.ACTIVE, AlarmState.RETURNED) and t_s - alarm.since_s >= for_s
            if waits and alarm.explanation.priority is Priority.HIGH:
                return alarm.title
        return ""

    def _with(self, change: Change, t_s: float) -> AlarmList:
        alarm = self.find(change.key)
        if change.is_over:
            if alarm is None or alarm.is_over:
                return self
            return self._replaced(replace(alarm, is_over=True))
        if change.explanation is None:
            return self
        if alarm is None:
            added = ListedAlarm(change.key, change.title, change.explanation, t_s)
            return AlarmList((*self.alarms, added))
        was_over = alarm.is_over
        is_worse = change.explanation.priority.rank < alarm.explanation.priority.rank
        alarm = replace(alarm, title=change.title, explanation=change.explanation, is_over=False)
        if was_over:
            alarm = replace(alarm, is_acknowledged=False, since_s=t_s, count=alarm.count + 1)
        elif is_worse:
            alarm = replace(alarm, is_acknowledged=False, since_s=t_s)
        if is_worse:
            alarm = replace(alarm, shelved_until_s=NEVER_S)
        return self._replaced(alarm)

    def _replaced(self, new: ListedAlarm) -> AlarmList:
        changed = [new if alarm.key == new.key else alarm for alarm in self.alarms]
        return AlarmList(tuple(alarm for alarm in changed if not _leaves(alarm)))

    def _unknown(self, key: str) -> str:
        listed = ", ".join(alarm.key for alarm in self.alarms) or "it is empty"
        return f"no alarm {key!r} in the list: {listed}"


def changes_of(code: str, text: str, data: Mapping[str, Any]) -> tuple[Change, ...]:
    """What an event of this code, text and data does to the list; nothing for most."""
    if code == "alarm":
        key = f"alarm:{data.get('number') or '{} {}'.format(data.get('kind'), data.get('target'))}"
        if data.get("is_recovery"):
            return (Change(key, is_over=True),)
        return (Change(key, text, FAULT_BY_KIND.get(str(data.get("kind")), FAULT_BY_KIND["unknown"])),)
    if code in ("trip", "stop"):
        return (Change(code, text, TRIP_BY_CAUSE.get(str(data.get("cause")), TRIP_BY_CAUSE["controller_failed"])),)
    if code == "mode" and data.get("mode") == Mode.DISARMED.name:
        return Change("trip", is_over=True), Change("relay_cut", is_over=True)
    if code in ("bypass", "bypass_end"):
        return (Change(f"bypass:{data.get('interlock')}", text, EVENT_BY_CODE["bypass"], code == "bypass_end"),)
    if code == "reference":
        return (Change("target", is_over=True),)
    if code in EVENT_BY_CODE:
        return (Change(code, text, EVENT_BY_CODE[code], bool(data.get("is_over"))),)
    return ()


def _leaves(alarm: ListedAlarm) -> bool:
    is_over = alarm.is_over or alarm.key in ONCE
    return is_over and alarm.is_acknowledged
