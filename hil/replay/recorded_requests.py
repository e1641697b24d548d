"""What an operator asked for while a run went on, from its events, as the control step takes it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import numpy as np

from hil.core.counted import counted
from hil.core.live_request import Author, LiveRequest
from hil.core.types import Mode
from hil.edge.control.messages import MessageError, live_request, parse
from hil.replay.recorded_steps import RecordedStep
from hil.review.ticks import LoggedEvent

OF_REQUESTS = ("operator", "refused")


def placed_requests(
    events: Sequence[LoggedEvent], steps: Sequence[RecordedStep], period_s: float, doubts: list[str]
) -> Mapping[int, tuple[LiveRequest, ...]]:
    """Number of a step -> the requests that it took. doubts : gets what can't be placed."""
    in_control = [at for at, step in enumerate(steps) if step.is_in_control]
    times_s = np.array([steps[at].t_s for at in in_control])
    placed: dict[int, tuple[LiveRequest, ...]] = {}
    lost = early = number = 0
    has_begun = False
    for event in events:
        has_begun |= event.code == "mode" and event.data.get("mode") in (Mode.RUNNING.name, Mode.DEGRADED.name)
        if event.code not in OF_REQUESTS or "request" not in event.data:
            continue
        number += 1
        request = _request(event, number)
        if request is None or not in_control:
            lost += 1
            continue
        at = in_control[int(np.argmin(np.abs(times_s - event.t_s)))]
        if not has_begun:
            early += 1
            at = 0
        elif abs(steps[at].t_s - event.t_s) > 0.5 * period_s:
            lost += 1
            continue
        placed[at] = (*placed.get(at, ()), request)
    if lost:
        doubts.append(
            f"{counted(lost, 'request')} of an operator could not be repeated: not in these steps, or unreadable"
        )
    if early:
        doubts.append(f"{counted(early, 'request')} of an operator before control: repeated at the first step")
    return placed


def _request(event: LoggedEvent, number: int) -> LiveRequest | None:
    """The request as it was sent; None where today's program does not know it."""
    data = event.data
    try:
        message = parse(json.dumps(data["request"]).encode())
        author = Author(str(data["user"]), int(data["pid"]), int(data["client"]))
        return live_request(message, number, author)
    except (MessageError, KeyError, TypeError, ValueError):
        return None
