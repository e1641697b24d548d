"""What the operator can enter: fields with their limits, the check of what was typed, and the request made of it.

A check raises EntryError with what is wrong and what is allowed. Nothing here knows of the screen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.core.errors import HilError
from hil.panel.run_messages import ShownAlarm, ShownRun, ShownState

RAMP_MAX_S = 3600.0
SHELVE_MAX_S = 3600.0
NOTE_MAX = 1000
MARK_MAX = 64


class EntryError(HilError):
    """What was typed can't be requested; the text says why."""


@dataclass(frozen=True, slots=True)
class EntryField:
    """One field: its label, the value that it begins with, and a line on what is allowed."""

    label: str
    value: str = ""
    allowed: str = ""


@dataclass(frozen=True, slots=True)
class EntryRequest:
    """A checked entry. question : what the operator confirms; "" for what moves no water."""

    request: Mapping[str, Any]
    question: str = ""


@dataclass(frozen=True, slots=True)
class EntryForm:
    """A dialog: title, fields, and `check`, from what was typed in each field to the request. Raises EntryError."""

    title: str
    fields: tuple[EntryField, ...]
    check: Callable[[Sequence[str]], EntryRequest]


def reference_form(run: ShownRun, state: ShownState) -> EntryForm:
    """New references of the lower tanks, in cm or V."""
    high_cm, gain = run.level_max_cm, run.level_gain_V_cm
    allowed = f"0 to {high_cm:g} cm, or with a V: 0 to {high_cm * gain:g} V; empty: unchanged"

    def check(typed: Sequence[str]) -> EntryRequest:
        levels_cm = [_level_cm(f"reference {i + 1}", typed[i], run) for i in (0, 1)]
        if levels_cm == [None, None]:
            raise EntryError("enter a reference for tank 1 or tank 2")
        ramp_s = _number_between("ramp", typed[2] or "0", 0.0, RAMP_MAX_S, "s")
        parts = [
            f"tank {i + 1} to {level_cm:.2f} cm ({level_cm * gain:.2f} V)"
            for i, level_cm in enumerate(levels_cm)
            if level_cm is not None
        ]
        how = f"within {ramp_s:g} s" if ramp_s > 0.0 else "at once"
        request = {"do": "reference", "levels_cm": levels_cm, "ramp_s": ramp_s}
        return EntryRequest(request, f"Move the reference of {' and of '.join(parts)}, {how}?")

    fields = tuple(
        EntryField(f"tank {i + 1}", _shown(state.reference_cm[i], " cm"), allowed if i == 1 else "") for i in (0, 1)
    )
    return EntryForm("References", (*fields, EntryField("ramp s", "20", f"0 to {RAMP_MAX_S:g} s")), check)


def manual_form(run: ShownRun, state: ShownState) -> EntryForm:
    """Voltages of the pumps by hand."""
    low_V, high_V = run.range_V
    allowed = f"{low_V:g} to {high_V:g} V; empty: unchanged"

    def check(typed: Sequence[str]) -> EntryRequest:
        voltage_V = [
            _number_between(f"pump {i + 1}", typed[i], low_V, high_V, "V") if typed[i].strip() else None for i in (0, 1)
        ]
        parts = [f"pump {i + 1} at {value:g} V" for i, value in enumerate(voltage_V) if value is not None]
        what = " and ".join(parts) if parts else "both pumps at what they have now"
        return EntryRequest(
            {"do": "manual", "voltage_V": voltage_V}, f"Take the pumps by hand: {what}? Control stops until Auto."
        )

    fields = tuple(
        EntryField(f"pump {i + 1}", _shown(state.command_V[i], " V"), allowed if i == 1 else "") for i in (0, 1)
    )
    return EntryForm("Manual voltages", fields, check)


def bypass_form(run: ShownRun) -> EntryForm:
    """Leave an interlock out for a time."""

    def check(typed: Sequence[str]) -> EntryRequest:
        name = typed[0].strip()
        if name not in run.bypassable:
            raise EntryError(
                f"interlock {name!r}: must be one of {', '.join(run.bypassable) or 'none: no bypass is allowed'}"
            )
        for_s = _number_between("time", typed[1], 1.0, run.bypass_max_s, "s")
        return EntryRequest(
            {"do": "bypass", "interlock": name, "for_s": for_s},
            f"Leave the interlock {name} out for {for_s:g} s? The rig is not protected by it in that time.",
        )

    first = run.bypassable[0] if run.bypassable else ""
    fields = (
        EntryField("interlock", first, f"one of {', '.join(run.bypassable) or '-'}"),
        EntryField("time s", "60", f"1 to {run.bypass_max_s:g} s"),
    )
    return EntryForm("Bypass an interlock", fields, check)


def note_form() -> EntryForm:
    """A note for the record."""

    def check(typed: Sequence[str]) -> EntryRequest:
        return EntryRequest({"do": "note", "text": _words("note", typed[0], NOTE_MAX)})

    return EntryForm("Note for the record", (EntryField("note", "", f"at most {NOTE_MAX} characters"),), check)


def mark_form() -> EntryForm:
    """A name for this moment."""

    def check(typed: Sequence[str]) -> EntryRequest:
        return EntryRequest({"do": "mark", "name": _words("name", typed[0], MARK_MAX)})

    return EntryForm("Mark this moment", (EntryField("name", "", f"at most {MARK_MAX} characters"),), check)


def shelve_form(alarm: ShownAlarm) -> EntryForm:
    """Hide an alarm for a time."""

    def check(typed: Sequence[str]) -> EntryRequest:
        for_s = _number_between("time", typed[0], 0.0, SHELVE_MAX_S, "s")
        return EntryRequest({"do": "shelve", "alarm": alarm.key, "for_s": for_s})

    field = EntryField("time s", "300", f"0 to {SHELVE_MAX_S:g} s; 0 ends it")
    return EntryForm(f"Shelve: {alarm.title}", (field,), check)


def _level_cm(name: str, typed: str, run: ShownRun) -> float | None:
    """A level in cm; None for an empty field. A V after the number makes it a level signal."""
    text = typed.strip()
    if not text:
        return None
    is_volt = text[-1:] in "vV"
    number = text.removesuffix("cm").rstrip("vV ").strip()
    if is_volt:
        gain = run.level_gain_V_cm
        return _number_between(name, number, 0.0, run.level_max_cm * gain, "V") / gain
    return _number_between(name, number, 0.0, run.level_max_cm, "cm")


def _number_between(name: str, typed: str, low: float, high: float, unit: str) -> float:
    text = typed.strip().removesuffix(unit).strip().replace(",", ".")
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not low <= number <= high:
        raise EntryError(f"{name} {typed.strip() or 'empty'}: must be {low:g} to {high:g} {unit}")
    return number


def _words(name: str, typed: str, longest: int) -> str:
    text = typed.strip()
    if not 0 < len(text) <= longest:
        raise EntryError(f"{name}: must have 1 to {longest} characters, not {len(text)}")
    return text


def _shown(value: float, unit: str) -> str:
    return f"{value:.2f}{unit}" if math.isfinite(value) else ""
