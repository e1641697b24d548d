"""Whether somebody is at the bench, where a run asks for it: an orderly stop instead of a run that nobody watches.

`unattended_s`: an alarm of high priority that nobody has acknowledged or shelved for so long. `attended_s`: nobody has
sent any request for so long; then an alarm says so, and after the same time again the run stops. 0 switches either off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from hil.core.alarm_list import AlarmList
from hil.core.interlocks import Limits
from hil.core.types import Event, Severity


@dataclass(frozen=True, slots=True)
class Attendance:
    """seen_s : run time at which somebody was last at the bench; None before the first step. is_told : see above."""

    seen_s: float | None = None
    is_told: bool = False


def is_asked_for(limits: Limits) -> bool:
    """Whether a run that nobody watches has to stop."""
    return limits.unattended_s > 0.0 or limits.attended_s > 0.0


def watch_attendance(
    attendance: Attendance, limits: Limits, is_here: bool, t_s: float
) -> tuple[Attendance, tuple[Event, ...]]:
    """One step. is_here : whether an operator has sent a request since the last step."""
    if attendance.seen_s is None:
        return Attendance(t_s), ()
    if is_here:
        if not attendance.is_told:
            return Attendance(t_s), ()
        text = "somebody is at the bench again"
        return Attendance(t_s), (Event(Severity.INFO, "operator_absent", text, {"is_over": True}),)
    attended_s, absent_s = limits.attended_s, t_s - attendance.seen_s
    if attended_s <= 0.0 or attendance.is_told or absent_s < attended_s:
        return attendance, ()
    text = f"no request of an operator for {absent_s:.0f} s: the run stops in {attended_s:.0f} s"
    event = Event(Severity.WARNING, "operator_absent", text, {"is_over": False, "absent_s": absent_s})
    return replace(attendance, is_told=True), (event,)


def unattended(attendance: Attendance, alarms: AlarmList, limits: Limits, t_s: float) -> str:
    """Why nobody watches the run; "" while somebody does, or nobody has to."""
    attended_s, unattended_s = limits.attended_s, limits.unattended_s
    if attended_s > 0.0 and attendance.seen_s is not None and t_s - attendance.seen_s >= 2.0 * attended_s:
        return f"no request of an operator for {t_s - attendance.seen_s:.0f} s"
    title = alarms.unattended(unattended_s, t_s) if unattended_s > 0.0 else ""
    return f"nobody has acknowledged an alarm of high priority for {unattended_s:g} s: {title}" if title else ""
