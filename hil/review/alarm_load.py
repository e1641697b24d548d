"""How many alarms a run asks its operator to look at: the measures of ISA-18.2 and IEC 62682, from the run's events."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from hil.core.alarm_catalogue import Priority
from hil.core.alarm_list import AlarmList, AlarmState

WINDOW_S = 600.0
"""Alarms are counted over 10 min."""

FLOOD_ABOVE, FLOOD_BELOW = 10, 5
"""A flood begins with more alarms than the one within the window, and ends with fewer than the other."""

CHATTER_COUNT, CHATTER_S = 3, 60.0
"""An alarm that becomes active so often within this time chatters."""

STALE_S = 86_400.0
"""An alarm that has been there for so long is stale."""


class Happened(Protocol):
    """What is needed of an event of a record."""

    @property
    def t_s(self) -> float:
        """Run time."""
        ...

    @property
    def code(self) -> str:
        """For programs."""
        ...

    @property
    def text(self) -> str:
        """For people."""
        ...

    @property
    def data(self) -> Mapping[str, Any]:
        """The numbers."""
        ...


@dataclass(frozen=True, slots=True)
class AlarmLoad:
    """The measures of one run.

    count : how often an alarm became active. by_priority : the same for each priority. per_10_min : mean over the run.
    peak_10_min : most within 10 min. floods : (from, to) in run time. chattering, stale : keys of alarms.
    left : alarms that nobody had acknowledged at the end.
    """

    count: int
    by_priority: dict[str, int]
    per_10_min: float
    peak_10_min: int
    floods: tuple[tuple[float, float], ...]
    chattering: tuple[str, ...]
    stale: tuple[str, ...]
    left: int


def alarm_load(events: Iterable[Happened], from_s: float, to_s: float) -> AlarmLoad:
    """The measures over [from_s, to_s] of run time."""
    alarms, begun, stale = AlarmList(), list[tuple[float, str, Priority]](), set[str]()
    for event in events:
        before, alarms = alarms, after(alarms, event)
        if alarms is before:
            continue
        for alarm in alarms.alarms:
            old = before.find(alarm.key)
            if old is None or alarm.count > old.count:
                begun.append((event.t_s, alarm.key, alarm.explanation.priority))
        stale |= {old.key for old in before.alarms if not old.is_over and event.t_s - old.since_s > STALE_S}
    stale |= {alarm.key for alarm in alarms.alarms if not alarm.is_over and to_s - alarm.since_s > STALE_S}
    times_s = [t_s for t_s, _, _ in begun]
    counts = Counter(priority.value for _, _, priority in begun)
    unseen = (AlarmState.ACTIVE, AlarmState.RETURNED)
    return AlarmLoad(
        count=len(begun),
        by_priority={priority.value: counts[priority.value] for priority in Priority},
        per_10_min=len(begun) * WINDOW_S / max(to_s - from_s, WINDOW_S),
        peak_10_min=max((_within(times_s, t_s, WINDOW_S) for t_s in times_s), default=0),
        floods=_floods(times_s, to_s),
        chattering=tuple(sorted(_chattering(begun))),
        stale=tuple(sorted(stale)),
        left=sum(alarm.state(to_s) in unseen for alarm in alarms.alarms),
    )


def after(alarms: AlarmList, event: Happened) -> AlarmList:
    """The list after an event of a record, requests of the operator included."""
    request = event.data.get("request") if event.code == "operator" else None
    if not isinstance(request, Mapping):
        return alarms.take(event.code, event.text, event.data, event.t_s)
    key = str(request.get("alarm"))
    if request.get("do") == "ack":
        return alarms.acknowledge(key)[0]
    if request.get("do") == "shelve":
        return alarms.shelve(key, float(request.get("for_s") or 0.0), event.t_s)[0]
    return alarms


def _within(times_s: Sequence[float], until_s: float, window_s: float) -> int:
    return sum(until_s - window_s < t_s <= until_s for t_s in times_s)


def _floods(times_s: Sequence[float], end_s: float) -> tuple[tuple[float, float], ...]:
    floods: list[tuple[float, float]] = []
    begun_s: float | None = None
    for t_s in sorted({*times_s, *(t_s + WINDOW_S for t_s in times_s)}):
        count = _within(times_s, t_s, WINDOW_S)
        if begun_s is None and count > FLOOD_ABOVE:
            begun_s = t_s
        elif begun_s is not None and count < FLOOD_BELOW:
            floods.append((begun_s, t_s))
            begun_s = None
    if begun_s is not None:
        floods.append((begun_s, max(end_s, begun_s)))
    return tuple((a_s, min(b_s, max(end_s, a_s))) for a_s, b_s in floods)


def _chattering(begun: Sequence[tuple[float, str, Priority]]) -> set[str]:
    found = set()
    for key in {key for _, key, _ in begun}:
        times_s = [t_s for t_s, one, _ in begun if one == key]
        if any(_within(times_s, t_s, CHATTER_S) >= CHATTER_COUNT for t_s in times_s):
            found.add(key)
    return found
