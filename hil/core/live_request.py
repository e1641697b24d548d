"""Requests that an operator sends while the run goes on, and the answers to them.

They come one by one from `hil.edge.control`, which has checked form and ranges; whether a request may be taken now is
decided in the control step: by the supervisor for those that a scenario can have, too, by `hil.core.live_plan` for
references and the scenario's clock.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from hil.core.types import Event, Pair, Severity, TripCause

MaybePair = tuple[float | None, float | None]
"""(2,) of output or pump 1 and 2; None keeps one."""


class LiveAction(StrEnum):
    """What an operator can ask for while the run goes on."""

    REFERENCE = "reference"
    MANUAL = "manual"
    AUTO = "auto"
    BYPASS = "bypass"
    CLEAR = "clear"
    STOP = "stop"
    HOLD = "hold"
    RESUME = "resume"
    NOTE = "note"
    MARK = "mark"
    ACK = "ack"
    SHELVE = "shelve"
    HERE = "here"


SUPERVISED = (LiveAction.MANUAL, LiveAction.AUTO, LiveAction.BYPASS, LiveAction.CLEAR, LiveAction.STOP)
"""Those that the supervisor decides on."""

MOVES_WATER = (*SUPERVISED, LiveAction.REFERENCE)
"""At most one of these is taken in a control step, so that each is answered by what became of it."""


@dataclass(frozen=True, slots=True)
class Author:
    """Who has sent a request, as the system says: name of the user, process number; number of the connection."""

    user: str
    pid: int
    client: int


@dataclass(frozen=True, slots=True)
class LiveRequest:
    """One request. number : connects the answer to it. sent : as the client wrote it, for the record.

    levels_V, levels_cm, change_V : of REFERENCE, one of them. ramp_s : of REFERENCE. voltage_V : of MANUAL; None keeps
    both. interlock : of BYPASS. for_s : of BYPASS and SHELVE. text : the note, the name of the mark, the alarm's key.
    """

    number: int
    action: LiveAction
    author: Author
    sent: dict[str, object] = field(default_factory=dict)
    levels_V: MaybePair | None = None
    levels_cm: MaybePair | None = None
    change_V: MaybePair | None = None
    ramp_s: float = 0.0
    voltage_V: MaybePair | None = None
    interlock: TripCause | None = None
    for_s: float = 0.0
    text: str = ""


@dataclass(frozen=True, slots=True)
class LiveAnswer:
    """What became of a request. number : of the request. reason : a code for programs, "" if it was accepted."""

    number: int
    text: str
    reason: str = ""


class RefusedError(Exception):
    """Why a request can't be taken now. reason : a code for programs."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


def accepted(request: LiveRequest, text: str) -> tuple[LiveAnswer, Event]:
    """The answer to a request that was taken, and its event."""
    author = request.author
    shown = f"operator {author.user} (process {author.pid}): {text}"
    return LiveAnswer(request.number, text), Event(Severity.INFO, "operator", shown, event_data(request))


def refused(request: LiveRequest, reason: str, text: str) -> tuple[LiveAnswer, Event]:
    """The answer to a request that was not taken, and its event. text : why not."""
    data = {"action": request.action.value, "reason": reason, **event_data(request)}
    shown = f"{request.action} refused: {text}"
    by = f" (operator {request.author.user}, process {request.author.pid})"
    return LiveAnswer(request.number, shown, reason), Event(Severity.WARNING, "refused", shown + by, data)


def event_data(request: LiveRequest) -> dict[str, object]:
    """Who, and what exactly."""
    author = request.author
    return {"user": author.user, "pid": author.pid, "client": author.client, "request": dict(request.sent)}


def merged(given: MaybePair, kept: Pair) -> Pair:
    """(2,) what is given, and what is kept where nothing is."""
    first, second = given
    return kept[0] if first is None else first, kept[1] if second is None else second
