"""Whether the fields of a `run.json` have the types that its readers rely on, so that each error names the key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime
from math import isfinite
from typing import Any

MODES = ("lockstep", "live")
CLOCKS = ("monotonic_zero_epoch_s", "run_zero_epoch_s")
MAX_SHOWN = 60


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _is_time(value: Any) -> bool:
    try:
        return datetime.fromisoformat(value).tzinfo is not None
    except (TypeError, ValueError):
        return False


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_table_of_texts(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_text, value.values()))


def _is_window(value: Any) -> bool:
    keys = {"name": _is_text, "from_s": _is_number, "to_s": _is_number}
    return isinstance(value, dict) and value.keys() == keys.keys() and all(keys[key](value[key]) for key in keys)


Rule = tuple[Callable[[Any], bool], str]

RULES: Mapping[str, Rule] = {
    "scenario": (_is_text, "text"),
    "mode": (lambda value: value in MODES, f"one of {', '.join(MODES)}"),
    "seed": (lambda value: value is None or (isinstance(value, int) and not isinstance(value, bool)), "a whole number"),
    "period_s": (lambda value: _is_number(value) and value > 0.0, "a number above 0"),
    "windows": (
        lambda value: isinstance(value, list) and all(map(_is_window, value)),
        "a list of tables with name, from_s and to_s",
    ),
    "reconfigure": (lambda value: isinstance(value, bool), "true or false"),
    "settings": (lambda value: isinstance(value, dict), "a table"),
    "copies": (_is_table_of_texts, "a table of texts"),
    "shown": (lambda value: isinstance(value, list) and all(map(_is_text, value)), "a list of texts"),
    "reason": (_is_text, "text"),
    "started_utc": (_is_time, "a time with its zone, as 2026-11-26T17:46:59.170+00:00"),
    "ended_utc": (lambda value: value is None or _is_time(value), "null or a time with its zone"),
    "versions": (_is_table_of_texts, "a table of texts"),
    "speed_x": (lambda value: value is None or _is_number(value), "null or a number"),
    "recorder": (lambda value: isinstance(value, dict), "a table"),
    "clock": (
        lambda value: (
            isinstance(value, dict)
            and value.keys() <= set(CLOCKS)
            and all(v is None or _is_number(v) for v in value.values())
        ),
        f"a table of numbers, {' and '.join(CLOCKS)}",
    ),
}
"""Key of run.json -> what its value has to be. Missing keys are another matter: some came with later versions."""


def wrong_field(raw: Mapping[str, Any]) -> str:
    """The first value that is of another kind than its readers take, in words; "" for none."""
    for key, (is_right, allowed) in RULES.items():
        if key in raw and not is_right(raw[key]):
            shown = repr(raw[key])
            return f"{key} = {shown[:MAX_SHOWN]}{'...' if len(shown) > MAX_SHOWN else ''} must be {allowed}"
    return ""
