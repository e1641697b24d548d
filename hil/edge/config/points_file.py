"""Known levels for `hil calibrate`: a CSV file with a header, or a TOML file with `[[point]]` tables.

    tank,level_cm,reading_V          [[point]]
    1,3.0,1.512                      tank = 1
    1,15.0,7.498                     level_cm = 3.0

A point without `reading_V` is a level at which the reading is still to be taken. `level_sd_cm` and `reading_sd_V` are
optional: one standard deviation each.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from hil.core.identification.calibration import RULER_SD_CM, LevelPoint
from hil.edge.config.settings_file import (
    Finite,
    LevelCm,
    NotNegative,
    Positive,
    Section,
    SettingsError,
    read_text,
    read_toml,
    validated,
)

COLUMNS = ("tank", "level_cm", "reading_V", "level_sd_cm", "reading_sd_V")
REQUIRED = COLUMNS[:2]


class KnownLevel(Section):
    """A point of the file. tank : 1..4."""

    tank: Annotated[int, Field(ge=1, le=4)]
    level_cm: LevelCm
    reading_V: Finite | None = None
    level_sd_cm: Positive = RULER_SD_CM
    reading_sd_V: NotNegative = 0.0

    def with_reading(self, reading_V: float, reading_sd_V: float) -> LevelPoint:
        """The point with a reading."""
        return LevelPoint(self.tank - 1, self.level_cm, reading_V, self.level_sd_cm, reading_sd_V)

    @property
    def point(self) -> LevelPoint | None:
        """The point, None while it has no reading."""
        return None if self.reading_V is None else self.with_reading(self.reading_V, self.reading_sd_V)


class KnownLevels(Section):
    """The whole TOML file."""

    point: tuple[KnownLevel, ...]


def load_points(path: Path) -> tuple[KnownLevel, ...]:
    """The points of a file, TOML by its suffix, else CSV. Raises SettingsError that names file, line or key, value."""
    if path.suffix == ".toml":
        points = validated(KnownLevels, read_toml(path), str(path)).point
    else:
        points = _from_csv(path, read_text(path))
    if not points:
        raise SettingsError(f"{path}: has no points")
    return points


def points_csv(points: Sequence[LevelPoint]) -> str:
    """The points as the text of a CSV file, which `load_points` reads."""
    lines = [",".join(COLUMNS)]
    lines += [
        f"{one.tank + 1},{one.level_cm:g},{one.reading_V:.6g},{one.level_sd_cm:g},{one.reading_sd_V:.3g}"
        for one in points
    ]
    return "\n".join(lines) + "\n"


def _from_csv(path: Path, text: str) -> tuple[KnownLevel, ...]:
    reader = csv.reader(io.StringIO(text), skipinitialspace=True)
    header = [name.strip() for name in next(reader, [])]
    unknown = [name for name in header if name not in COLUMNS]
    missing = [name for name in REQUIRED if name not in header]
    if unknown or missing or len(set(header)) < len(header):
        raise SettingsError(
            f"{path} line 1: columns {', '.join(header)}; wanted {', '.join(REQUIRED)}, and if known "
            f"{', '.join(COLUMNS[2:])}"
        )
    return tuple(
        validated(KnownLevel, _row(path, reader.line_num, header, cells), f"{path} line {reader.line_num}")
        for cells in reader
        if any(cell.strip() for cell in cells)
    )


def _row(path: Path, line: int, header: Sequence[str], cells: Sequence[str]) -> dict[str, Any]:
    """The row's values by their column; an empty cell is left out."""
    if len(cells) != len(header):
        raise SettingsError(f"{path} line {line}: {len(cells)} values for {len(header)} columns")
    return {name: _number(name, cell.strip()) for name, cell in zip(header, cells, strict=True) if cell.strip()}


def _number(name: str, cell: str) -> int | float | str:
    """A number where the cell has one; any other text is left for the check to refuse."""
    try:
        return int(cell) if name == "tank" else float(cell)
    except ValueError:
        return cell
