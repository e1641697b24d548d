"""Chooses runs by an expression such as `status == 'tripped' and iae.gain_fall[0] > 1`, and sorts them by a key.

A name in it is a field of `IndexedRun`, or a key of kpi.json; `iae` is short for `iae_Vs`; `kpi` is all of kpi.json, so
that `kpi.alarms[0].kind` is there beside the number `alarms`. Only runs for which the expression is true are chosen; a
value that a run does not have is unknown. A name that no run has is an error that names near ones.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

from hil.run_index.expression import Expression, kind_of, step_into
from hil.run_index.expression import SelectionError as SelectionError
from hil.run_index.indexed_run import IndexedRun

SHORT = {"iae": "iae_Vs"}
ALL_FIGURES = "kpi"
LISTED = ("alarms", "trips")
"""A number as a field, a list in kpi.json."""


def names_of(row: IndexedRun) -> dict[str, Any]:
    """What an expression can name: fields first, then keys of kpi.json; None is unknown, and "" too for a field."""
    fields = {name: None if value == "" else value for name, value in row.as_dict().items() if name != "figures"}
    named = {**row.figures, **fields, ALL_FIGURES: row.figures}
    return named | {short: named[name] for short, name in SHORT.items() if name in named}


def chosen(rows: Sequence[IndexedRun], expression: str) -> list[IndexedRun]:
    """The runs for which the expression is true, in their order. Raises SelectionError."""
    condition = Expression(expression)
    found = [row for row in rows if condition.is_true(names_of(row))]
    _check_names(condition, rows)
    return found


def ordered(rows: Sequence[IndexedRun], key: str) -> list[IndexedRun]:
    """The runs by a key, such as `size_bytes` or `iae.gain_fall[0]`; `-key` the largest first; unknown ones last.

    Raises SelectionError.
    """
    is_reverse, text = key.startswith("-"), key.removeprefix("-")
    value = Expression(text)
    values = [value.value(names_of(row)) for row in rows]
    _check_names(value, rows)
    known = [(one, row) for one, row in zip(values, rows, strict=True) if one is not None]
    unknown = [row for one, row in zip(values, rows, strict=True) if one is None]
    try:
        known.sort(key=lambda pair: pair[0], reverse=is_reverse)
    except TypeError:
        raise SelectionError(f"{text}: runs can't be sorted by this: its values can't be compared") from None
    return [row for _, row in known] + unknown


_ABSENT = object()


def _check_names(expression: Expression, rows: Sequence[IndexedRun]) -> None:
    """Every path that the expression names is known to some run, or SelectionError; nothing without runs."""
    named = [names_of(row) for row in rows]
    for path in expression.paths if named else ():
        _check_path(path, named)


def _check_path(path: Sequence[str | int], named: Sequence[Mapping[str, Any]]) -> None:
    holders: list[Any] = list(named)
    for depth, key in enumerate(path):
        inside = [found for holder in holders if (found := step_into(holder, key, _ABSENT)) is not _ABSENT]
        if inside:
            holders = inside
            continue
        if all(holder is None or (isinstance(holder, list) and isinstance(key, int)) for holder in holders):
            return  # its holder is known by name, and unknown or shorter in each of these runs
        raise SelectionError(f"{_shown(path[: depth + 1])}: no run here has this; {_hint(path, depth, holders)}")


def _hint(path: Sequence[str | int], depth: int, holders: Sequence[Any]) -> str:
    """What there is in place of `path[depth]`, which none of the holders has."""
    key, before = str(path[depth]), _shown(path[:depth])
    keys = sorted({str(one) for holder in holders if isinstance(holder, Mapping) for one in holder})
    if near := difflib.get_close_matches(key, keys, n=3, cutoff=0.5):
        return f"did you mean {' or '.join(_shown((*path[:depth], one)) for one in near)}?"
    if keys:
        return f"{f'{before} has' if before else 'they have'}: {', '.join(keys)}"
    listed = f", the list is {ALL_FIGURES}.{before}" if before in LISTED else ""
    return f"{before} is {kind_of(holders[0])}{listed}"


def _shown(path: Sequence[str | int]) -> str:
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)
    return text.removeprefix(".")
