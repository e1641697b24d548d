"""Key figures of runs side by side: a row for each figure, with ratios to the first run and the spread."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Value = float | bool | str | None

MIN_SPREAD = 3
"""Runs from which on a row has a spread."""

LEFT_OUT = frozenset(
    {
        *("scenario", "reason", "reconfigure", "recorder", "alarm_load", "parameters", "parameters_note", "speed_x"),
        *("overshoot_at_s", "level_max_at_s"),
    }
)
"""What is no figure, is of the computer and not of the run, or is the moment of another figure."""

COUNTED = ("alarms", "trips")
UNITS = (("_Vs", "V s"), ("_cm", "cm"), ("_V", "V"), ("_s", "s"))
NAMES = {
    "iae_Vs": "IAE",
    "iae_source": "IAE from",
    "iae_covered_s": "recorded part of the window",
    "iae_after_fault_Vs": "IAE after the fault",
    "settling_s": "settling time",
    "overshoot_cm": "overshoot",
    "applied_max_V": "largest applied voltage",
    "level_max_cm": "highest level",
    "applied_out_of_range": "applied voltage out of range",
    "duration_s": "duration",
    "start_phase_s": "start phase",
    "ticks": "control steps",
    "skipped": "periods skipped",
    "rejected": "frames rejected",
    "lateness_s": "lateness",
    "latency_s": "frame to command",
    "recorder_queue_max": "entries waiting for the recorder, at most",
}
PLACES = {"applied_max_V": "pump", "level_max_cm": "tank"}
"""What the numbers of a list belong to, where it is not the outputs."""


@dataclass(frozen=True, slots=True)
class FigureRow:
    """One figure of all runs.

    key : path in kpi.json; of `alarms` and `trips` the row has the number. label, unit : for people. values : of each
    run, None where it is not known. ratios : to the first run; None where one of both is no number, or the first is 0.
    median, low, high : of the known values, from `MIN_SPREAD` runs on.
    """

    key: str
    label: str
    unit: str
    values: tuple[Value, ...]
    ratios: tuple[float | None, ...]
    median: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def is_same(self) -> bool:
        """Whether all runs have the same value."""
        return len(set(self.values)) == 1


def figure_rows(figures: Sequence[Mapping[str, Any]]) -> tuple[FigureRow, ...]:
    """The rows, in the order of kpi.json; without those that no run has. figures : kpi.json of each run."""
    flat = [dict(_flat(one)) for one in figures]
    keys = _merged_order([list(one) for one in flat])
    rows = (_row(key, tuple(one.get(key) for one in flat)) for key in keys)
    return tuple(row for row in rows if any(value is not None for value in row.values))


def _merged_order(lists: Sequence[Sequence[str]]) -> list[str]:
    """All keys; a key that the first list lacks comes after the one before it in its own list."""
    merged: list[str] = []
    for keys in lists:
        after = 0
        for key in keys:
            if key in merged:
                after = merged.index(key) + 1
            else:
                merged.insert(after, key)
                after += 1
    return merged


def _flat(figures: Mapping[str, Any]) -> Iterator[tuple[str, Value]]:
    covered_s = figures.get("iae_covered_s")
    for key, value in figures.items():
        if key == "iae_Vs" and isinstance(value, Mapping) and isinstance(covered_s, Mapping):
            # a window that the run did not reach has no error, and not the error 0
            reached = {name: pair for name, pair in value.items() if covered_s.get(name, 1.0)}
            yield from _leaves(key, reached)
        elif key in COUNTED:
            yield key, float(len(value)) if isinstance(value, list | tuple) else None
        elif key not in LEFT_OUT:
            yield from _leaves(key, value)


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Value]]:
    if isinstance(value, Mapping):
        for name, inside in value.items():
            yield from _leaves(f"{key}.{name}", inside)
    elif isinstance(value, list | tuple):
        for place, inside in enumerate(value):
            yield from _leaves(f"{key}[{place}]", inside)
    elif isinstance(value, bool | str) or value is None:
        yield key, value
    elif isinstance(value, int | float):
        yield key, float(value) if math.isfinite(value) else None


def _row(key: str, values: tuple[Value, ...]) -> FigureRow:
    numbers = [value if isinstance(value, float) else None for value in values]
    first = numbers[0]
    ratios = tuple(None if value is None or not first else value / first for value in numbers)
    known = [value for value in numbers if value is not None]
    spread = (statistics.median(known), min(known), max(known)) if known and len(values) >= MIN_SPREAD else ()
    return FigureRow(key, label(key), _unit(key), values, ratios, *spread)


def _unit(key: str) -> str:
    stem = key.partition(".")[0].partition("[")[0]
    return next((unit for ending, unit in UNITS if stem.endswith(ending)), "")


def label(key: str) -> str:
    """A figure's path in kpi.json as words: `iae_Vs.gain_fall[0]` is "IAE (gain_fall), output 1"."""
    path, _, place = key.removesuffix("]").partition("[")
    stem, _, inside = path.partition(".")
    words = NAMES.get(stem, stem.replace("_", " "))
    if stem == "commands":
        words = inside.replace("_", " ")
    elif inside:
        words = f"{words} ({inside})"
    return f"{words}, {PLACES.get(stem, 'output')} {int(place) + 1}" if place.isdecimal() else words
