"""A checked request on its way from the process that serves the clients to the control thread, as JSON."""

from __future__ import annotations

import json
from typing import Any

from hil.core.live_request import Author, LiveAction, LiveRequest
from hil.core.types import TripCause

PAIRS = ("levels_V", "levels_cm", "change_V", "voltage_V")


def packed(request: LiveRequest) -> bytes:
    """For `unpacked`."""
    author = request.author
    values: dict[str, Any] = {
        "number": request.number,
        "action": request.action.value,
        "author": [author.user, author.pid, author.client],
        "sent": request.sent,
        "ramp_s": request.ramp_s,
        "interlock": request.interlock,
        "for_s": request.for_s,
        "text": request.text,
    }
    return json.dumps(values | {name: getattr(request, name) for name in PAIRS}).encode()


def unpacked(line: bytes) -> LiveRequest:
    """The request. Raises KeyError, TypeError or ValueError for anything else."""
    data = json.loads(line)
    user, pid, client = data["author"]
    pairs = {name: None if data[name] is None else (data[name][0], data[name][1]) for name in PAIRS}
    interlock = data["interlock"]
    return LiveRequest(
        number=int(data["number"]),
        action=LiveAction(data["action"]),
        author=Author(str(user), int(pid), int(client)),
        sent=dict(data["sent"]),
        ramp_s=float(data["ramp_s"]),
        interlock=None if interlock is None else TripCause(interlock),
        for_s=float(data["for_s"]),
        text=str(data["text"]),
        **pairs,
    )
