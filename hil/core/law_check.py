"""What a control law returns is checked before anything is done with it: a law may be anybody's code.

Whatever is wrong raises an error, which trips the rig in the same step. Drives that are not finite are left to the
supervisor: it trips where it would have to send them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from hil.core.control_law import FeedbackRecord, LawRequest
from hil.core.types import Event, Pair, Severity

CODES = ("reconfigured", "target", "law")
"""Codes of the events that a law may return. `law` is for whatever the other two don't say."""

MAX_TEXT, MAX_SHOWN = 300, 64
"""Longest text, and most numbers or events of one step."""

FLOATS = {float}
GAINS = 12
"""Of two pumps, from four levels and two integrals."""

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}\Z")


def checked(request: Any) -> LawRequest:
    """The request, made of plain numbers and printable text. Raises TypeError or ValueError that says what is wrong."""
    if type(request) is not LawRequest:
        raise TypeError(f"the control law returned a {type(request).__name__}, not a LawRequest")
    return LawRequest(
        drive_V=_pair("drive_V", request.drive_V),
        target_V=_pair("target_V", request.target_V),
        reason=_text("reason", request.reason) if request.reason != "" else "",
        problem=_text("problem", request.problem) if request.problem != "" else "",
        shown={} if type(request.shown) is dict and not request.shown else _shown(request.shown),
        events=_events(request.events) if request.events != () else (),
        feedback=None if request.feedback is None else _feedback(request.feedback),
    )


def _pair(name: str, values: Any) -> Pair:
    if type(values) is tuple and len(values) == 2:
        first, second = values
        if type(first) is float and type(second) is float:
            return first, second
    try:
        first, second = values
    except (TypeError, ValueError):
        raise TypeError(f"the control law's {name} must be two numbers, not {_brief(values)}") from None
    return _number(name, first), _number(name, second)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"the control law's {name} must be numbers, not {_brief(value)}")
    return float(value)


def _text(name: str, value: Any) -> str:
    """The text in printable characters, of limited length: it is written to files and shown in terminals."""
    if type(value) is not str:
        raise TypeError(f"the control law's {name} must be text, not {_brief(value)}")
    return "".join(c if c.isprintable() else "?" for c in value[:MAX_TEXT])


def _shown(shown: Any) -> dict[str, float]:
    if not isinstance(shown, Mapping):
        raise TypeError(f"the control law's shown must be numbers by name, not {_brief(shown)}")
    if len(shown) > MAX_SHOWN:
        raise ValueError(f"the control law shows {len(shown)} numbers: at most {MAX_SHOWN}")
    for name in shown:
        if not (isinstance(name, str) and _is_name(str(name))):
            raise ValueError(f"the control law shows {_brief(name)}: names have letters, digits and _, at most 40")
    return {
        str(name): value if type(value) is float else _number(f"shown {name!r}", value) for name, value in shown.items()
    }


@lru_cache(maxsize=256)
def _is_name(name: str) -> bool:
    """Whether a number may be shown by this name. Kept: a law shows the same names at every step."""
    return NAME.match(name) is not None


def _events(events: Any) -> tuple[Event, ...]:
    if not (type(events) is tuple and len(events) <= MAX_SHOWN and all(type(event) is Event for event in events)):
        raise TypeError(f"the control law's events must be at most {MAX_SHOWN} of Event, not {_brief(events)}")
    return tuple(map(_event, events))


def _event(event: Event) -> Event:
    if event.code not in CODES:
        raise ValueError(f"the control law returned an event {_brief(event.code)}: must be one of {', '.join(CODES)}")
    severity = Severity.INFO if event.severity == Severity.INFO else Severity.WARNING
    data = {_text("event data", key): _plain(value) for key, value in event.data.items()}
    return Event(severity, str(event.code), _text("event text", event.text), data)


def _plain(value: Any) -> object:
    """Numbers, text and lists of these, as they may stand in a record."""
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value[:MAX_SHOWN]]
    return _text("event data", value) if isinstance(value, str) else _number("event data", value)


def _feedback(shown: Any) -> FeedbackRecord:
    if type(shown) is not FeedbackRecord:
        raise TypeError(f"the control law's feedback must be a FeedbackRecord, not {_brief(shown)}")
    gain = shown.gain
    if type(gain) is not tuple or len(gain) != GAINS:
        raise TypeError(f"the control law's feedback.gain must be {GAINS} numbers, not {_brief(gain)}")
    if set(map(type, gain)) != FLOATS:
        gain = tuple(_number("feedback.gain", value) for value in gain)
    return FeedbackRecord(
        operating_V=_pair("feedback.operating_V", shown.operating_V),
        integral_Vs=_pair("feedback.integral_Vs", shown.integral_Vs),
        gain=gain,
    )


def _brief(value: Any) -> str:
    """A value for a message; what it is, where it can't be printed."""
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - an object of anybody's class
        text = f"a {type(value).__name__}"
    return "".join(c if c.isprintable() else "?" for c in text[:60])
