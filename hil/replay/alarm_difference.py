"""Recorded alarms beside those of today."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isclose

from hil.core.types import NAMELESS
from hil.review import alarms
from hil.review.alarms import Finding
from hil.review.ticks import LoggedEvent

SIZE_TOLERANCE = 0.01
"""Share of the size. The step in which an alarm is raised may differ by one: another processor rounds differently."""


def findings_until(events: Iterable[LoggedEvent], end_s: float) -> tuple[Finding, ...]:
    """The alarms among events up to a run time, one for each reported fault."""
    return alarms.merged(event.data for event in events if event.code == "alarm" and event.t_s <= end_s)


def in_words(finding: Finding) -> str:
    """One alarm, as a table shows it."""
    at = "" if finding.detected_s is None else f"{finding.detected_s:.1f} s: "
    size = "" if finding.size is None else f" {finding.size:.3f}"
    named = f"{finding.kind} {finding.target}{size}"
    if finding.kind in NAMELESS and finding.candidates:
        named = f"{finding.kind}: {' or '.join(finding.candidates)}"
    over = "" if finding.recovered_s is None else f", over at {finding.recovered_s:.1f} s"
    return f"{at}{named}{over}"


def alarm_difference(recorded: Sequence[Finding], today: Sequence[Finding], period_s: float) -> str:
    """The first alarm that differs, in words; "" if none does. Times may differ by a control period, sizes by 1 %."""
    for number in range(max(len(recorded), len(today))):
        before = recorded[number] if number < len(recorded) else None
        now = today[number] if number < len(today) else None
        if before is None or now is None or not _is_same(before, now, period_s):
            words = [in_words(one) if one is not None else "none" for one in (before, now)]
            return f"alarm {number + 1}: recorded {words[0]}; today {words[1]}"
    return ""


def _is_same(before: Finding, now: Finding, period_s: float) -> bool:
    names = ("kind", "target", "candidates", "looks")
    times = ("detected_s", "isolated_s", "recovered_s")
    same = all(getattr(before, name) == getattr(now, name) for name in names)
    on_time = all(_is_near(getattr(before, name), getattr(now, name), 1.001 * period_s) for name in times)
    return same and on_time and _is_near(before.size, now.size, SIZE_TOLERANCE * abs(before.size or 0.0))


def _is_near(before: float | None, now: float | None, tolerance: float) -> bool:
    if before is None or now is None:
        return before is now
    return isclose(before, now, rel_tol=0.0, abs_tol=tolerance + 1e-9)
