"""A moment of a run, named by an event or a time: `trip`, `alarm:2`, `mode:3`, `123.4`."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path

from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import LoggedEvent, Ticks, read


class UnknownMomentError(RunFolderError):
    """The run has no such moment; the message says which it has."""


def moment_s(folder: RunFolder, text: str) -> float:
    """The run time that `text` names, s. Raises UnknownMomentError, and RunFolderError for a record without steps."""
    ticks, events = read(folder, ("t_s",))
    return moment_of(folder.path, ticks, events, text)


def moment_of(path: Path, ticks: Ticks, events: Sequence[LoggedEvent], text: str, option: str = "--at") -> float:
    """The same for a record that is read already. option : of the command line, for the error."""
    if not len(ticks):
        raise RunFolderError(f"{path} has no control step, so it has no moment {text}")
    try:
        at_s = float(text)
    except ValueError:
        return _of_event(path, events, text, option)
    begin_s, end_s = float(ticks["t_s"][0]), float(ticks["t_s"][-1])
    if not isfinite(at_s) or not begin_s <= at_s <= end_s:
        raise UnknownMomentError(f"{option} {text}: the run {path} lasts from {begin_s:g} to {end_s:g} s")
    return at_s


def _of_event(path: Path, events: Sequence[LoggedEvent], text: str, option: str) -> float:
    code, _, which = text.partition(":")
    number = int(which) if which.isascii() and which.isdigit() else 0
    if (which or ":" in text) and number < 1:
        raise UnknownMomentError(
            f"{option} {text}: after the colon comes a whole number from 1 on, as in {code or 'alarm'}:1"
        )
    found = [event for event in events if event.code == code]
    if not found:
        codes = ", ".join(sorted({event.code for event in events})) or "none"
        raise UnknownMomentError(f"{option} {text}: the run {path} has no {code or 'such'} event; it has: {codes}")
    if code == "alarm" and number:
        numbers = sorted({int(event.data.get("number") or 0) for event in found})
        found = [event for event in found if event.data.get("number") == number]
        if not found:
            known = ", ".join(map(str, numbers))
            raise UnknownMomentError(f"{option} {text}: the run {path} has no alarm {number}; it has: {known}")
        return found[0].t_s
    if number > len(found):
        raise UnknownMomentError(f"{option} {text}: the run {path} has {len(found)} of these events, not {number}")
    return found[max(number, 1) - 1].t_s
