"""A moment of a run, named by an event or a time: `trip`, `alarm:2`, `mode:3`, `123.4`."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from hil.edge.record.run_folder import RunFolder, RunFolderError
from hil.review.ticks import LoggedEvent, read


class UnknownMomentError(RunFolderError):
    """The run has no such moment; the message says which it has."""


def moment_s(folder: RunFolder, text: str) -> float:
    """The run time that `text` names, s. Raises UnknownMomentError, and RunFolderError for a record without steps."""
    ticks, events = read(folder, ("t_s",))
    if not len(ticks):
        raise RunFolderError(f"{folder.path} has no control step, so there is no moment to open it at")
    try:
        at_s = float(text)
    except ValueError:
        return _of_event(folder, events, text)
    begin_s, end_s = float(ticks["t_s"][0]), float(ticks["t_s"][-1])
    if not isfinite(at_s) or not begin_s <= at_s <= end_s:
        raise UnknownMomentError(f"--at {text}: the run {folder.path} lasts from {begin_s:g} to {end_s:g} s")
    return at_s


def _of_event(folder: RunFolder, events: Sequence[LoggedEvent], text: str) -> float:
    code, _, which = text.partition(":")
    number = int(which) if which.isascii() and which.isdigit() else 0
    if (which or ":" in text) and number < 1:
        raise UnknownMomentError(
            f"--at {text}: after the colon comes a whole number from 1 on, as in {code or 'alarm'}:1"
        )
    found = [event for event in events if event.code == code]
    if not found:
        codes = ", ".join(sorted({event.code for event in events})) or "none"
        raise UnknownMomentError(f"--at {text}: the run {folder.path} has no {code or 'such'} event; it has: {codes}")
    if code == "alarm" and number:
        numbers = sorted({int(event.data.get("number") or 0) for event in found})
        found = [event for event in found if event.data.get("number") == number]
        if not found:
            known = ", ".join(map(str, numbers))
            raise UnknownMomentError(f"--at {text}: the run {folder.path} has no alarm {number}; it has: {known}")
        return found[0].t_s
    if number > len(found):
        raise UnknownMomentError(f"--at {text}: the run {folder.path} has {len(found)} of these events, not {number}")
    return found[max(number, 1) - 1].t_s
