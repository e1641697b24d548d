"""The report's section on what alarms ask of an operator: the list at the end, and how many there were."""

from __future__ import annotations

from collections.abc import Iterable

from hil.core.alarm_list import AlarmList
from hil.core.counted import counted
from hil.review import page
from hil.review.alarm_load import FLOOD_ABOVE, AlarmLoad, after
from hil.review.ticks import LoggedEvent


def attention(name: str, load: AlarmLoad, events: Iterable[LoggedEvent]) -> str:
    """As HTML, under the run's name; "" for a run without alarms."""
    if not load.count:
        return ""
    rest, end_s = AlarmList(), 0.0
    for event in events:
        rest, end_s = after(rest, event), event.t_s
    rows = [
        [row["priority"], row["state"], page.number(row["since_s"], 5), f"{row['count']}", row["title"], row["action"]]
        for row in rest.rows(end_s)
    ]
    heads = ["priority", "state at the end", "since [s]", "times", "alarm", "what to do"]
    table = page.table(heads, rows, numeric=frozenset()) if rows else ""
    return page.paragraphs([f"{name}: {load_in_words(load)}" if name else load_in_words(load)]) + table


def load_in_words(load: AlarmLoad) -> str:
    """The measures as sentences."""
    by_priority = ", ".join(f"{number} {priority}" for priority, number in load.by_priority.items() if number)
    texts = [
        f"{counted(load.count, 'alarm')} ({by_priority}), {load.per_10_min:.1f} in 10 min, at most {load.peak_10_min}.",
        f"{counted(load.left, 'alarm')} never acknowledged." if load.left else "",
        "".join(
            f" Flood from {a_s:.0f} to {b_s:.0f} s: more than {FLOOD_ABOVE} in 10 min." for a_s, b_s in load.floods
        ),
        f"Chattering: {', '.join(load.chattering)}." if load.chattering else "",
        f"Stale: {', '.join(load.stale)}." if load.stale else "",
    ]
    return " ".join(text.strip() for text in texts if text)
