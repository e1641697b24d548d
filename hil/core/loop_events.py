"""The events of one step of the control loop, with their texts."""

from __future__ import annotations

from dataclasses import asdict

from hil.core import start_phase
from hil.core.loop_state import LoopState
from hil.core.reference_path import RunReferences
from hil.core.types import UNKNOWN, UNRESOLVED, Alarm, Event, Severity


def events_of_step(references: RunReferences, old: LoopState, new: LoopState) -> tuple[Event, ...]:
    """Alarms, the start phase, references, and what the law reports, in this order."""
    events = [_alarm(alarm) for alarm in new.diagnosis.new_alarms]
    if new.start is not None and new.stepped_ns == new.started_ns - new.start.length_ns:
        events.append(start_phase.begins(new.start, new.inputs.requested_V))
    events += _reference_events(references, old, new)
    is_told = new.followed.effectiveness == old.followed.effectiveness or new.followed.told_s > old.followed.told_s
    events += [event for event in new.request.events if is_told or event.code != "reconfigured"]
    if new.request.reason not in ("", old.request.reason) and all(e.code != "target" for e in new.request.events):
        (r1, r2), reason = new.request.target_V, new.request.reason
        text = f"not at the reference ({reason}): aiming at {r1:.4f}, {r2:.4f} V"
        events.append(Event(Severity.WARNING, "target", text, {"target_V": [r1, r2], "reason": reason}))
    return tuple(events)


def _reference_events(references: RunReferences, old: LoopState, new: LoopState) -> list[Event]:
    """An event for a step, and one at the beginning of a ramp or trajectory."""
    if new.is_starting:
        return []
    number = references.entry(new.t_s)
    move = references.move(number)
    if move is None:
        if new.reference_V == old.reference_V:
            return []
        r1, r2 = new.reference_V
        return [Event(Severity.INFO, "reference", f"reference {r1:.4f}, {r2:.4f} V", {"reference_V": [r1, r2]})]
    if references.entry(old.t_s) == number and new.stepped_ns > new.started_ns:
        return []
    (r1, r2), time_s = references.schedule[number][1], move.end_s - move.times_s[0]
    text = f"reference moves to {r1:.4f}, {r2:.4f} V in {time_s:g} s"
    return [Event(Severity.INFO, "reference", text, {"reference_V": [r1, r2], "move_s": time_s})]


def _alarm(alarm: Alarm) -> Event:
    if alarm.is_recovery:
        text = (
            "what no known fault explained is over" if alarm.kind == UNKNOWN else f"{alarm.kind} {alarm.target} is over"
        )
    elif alarm.kind == UNRESOLVED:
        text = f"a fault: {' or '.join(alarm.candidates)}"
    elif alarm.kind == UNKNOWN:
        text = f"something that no known fault explains: {alarm.looks}"
    else:
        text = f"{alarm.kind} {alarm.target}: {alarm.size:.3f}"
    return Event(Severity.WARNING, "alarm", text, asdict(alarm))
