"""A trajectory of the references: a CSV file with the columns `t_s,y1_V,y2_V`, or `t_s,y1_cm,y2_cm`.

The time counts from the reference's `at_s`; between two lines the references move linearly. A first line at 0 is a
step; a later one is reached from the reference before.
"""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

from hil.core.types import Pair
from hil.edge.config.settings_file import MAX_DURATION_S, SettingsError, read_text

HEADERS = {("t_s", "y1_V", "y2_V"): False, ("t_s", "y1_cm", "y2_cm"): True}
"""The columns, and whether levels are in cm."""

MAX_LINES = 200_000

Point = tuple[float, Pair]


def load_trajectory(path: Path, level_gain_V_cm: float, highest_V: float) -> tuple[Point, ...]:
    """The points (t_s, (y1, y2) in V). Raises SettingsError that names file, line, column and value."""
    try:
        rows = list(csv.reader(io.StringIO(read_text(path)), strict=True))
    except csv.Error as error:
        raise SettingsError(f"{path}: is not a CSV file: {error}") from None
    header = tuple(name.strip() for name in rows[0]) if rows else ()
    if header not in HEADERS:
        raise SettingsError(f"{path}: line 1: want t_s,y1_V,y2_V or t_s,y1_cm,y2_cm, not {','.join(header)[:80]!r}")
    if not 2 <= len(rows) <= MAX_LINES:
        raise SettingsError(f"{path}: has {len(rows) - 1} points, want 1 to {MAX_LINES - 1}")
    gain = level_gain_V_cm if HEADERS[header] else 1.0
    points: list[Point] = []
    for line, row in enumerate(rows[1:], 2):
        if not row:
            continue
        if len(row) != len(header):
            raise SettingsError(f"{path}: line {line}: has {len(row)} values, want {len(header)}")
        where = f"{path}: line {line}"
        t_s, y1, y2 = (_number(where, name, text) for name, text in zip(header, row, strict=True))
        if t_s < 0.0 or t_s > MAX_DURATION_S:
            raise SettingsError(f"{where}: t_s = {t_s:g}: outside 0..{MAX_DURATION_S:g} s")
        if points and t_s <= points[-1][0]:
            raise SettingsError(f"{where}: t_s = {t_s:g}: not after {points[-1][0]:g} of the line before")
        for name, level in zip(header[1:], (y1, y2), strict=True):
            if not 0.0 <= gain * level <= highest_V:
                raise SettingsError(
                    f"{where}: {name} = {level:g}: outside 0..{highest_V / gain:g} (safety.level_max_cm)"
                )
        points.append((t_s, (gain * y1, gain * y2)))
    if not points:
        raise SettingsError(f"{path}: has no points")
    return tuple(points)


def _number(where: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise SettingsError(f"{where}: {name} = {text[:40]!r}: is not a number") from None
    if not math.isfinite(value):
        raise SettingsError(f"{where}: {name} = {text.strip()[:40]}: must be finite")
    return value
