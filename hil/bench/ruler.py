"""Levels that somebody reads by a ruler during an experiment, and the file `ruler.csv` that keeps them.

The file has one line for each reading: t_s (run time of the phase), tank (1 to 4), level_cm, sd_cm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from sys import maxsize
from typing import Protocol

import numpy as np

from hil.core.controller import Output
from hil.core.identification.records import RulerReading
from hil.core.types import Event, Inputs, Mode, Quad
from hil.edge.config.settings_file import SettingsError, read_text
from hil.edge.record.file_writing import writing

FILE = "ruler.csv"
EVENT = "ruler"
"""Code of the event at which the levels are asked for; its data name the tanks, from 1 on."""

HEADER = "t_s,tank,level_cm,sd_cm"
SD_CM = 0.1

Level = tuple[int, float, float]
"""Tank (0 to 3), level in cm, its standard deviation in cm."""


class Ruler(Protocol):
    """Who reads the levels."""

    def ask(self, tanks: Sequence[int]) -> None:
        """Begin to ask for the levels of these tanks (0 to 3); returns at once."""
        ...

    def take(self) -> tuple[Level, ...]:
        """What was read since the last call."""
        ...

    def is_done(self) -> bool:
        """Whether nothing more will come."""
        ...


class RulerWatch:
    """Asks the ruler when a phase says so, and gives every reading its time."""

    def __init__(self, ruler: Ruler | None) -> None:
        self._ruler = ruler
        self._asked = 0
        self.readings: list[RulerReading] = []

    def write(self, folder: Path) -> None:
        """Keep the readings in a run folder if levels were asked for. Raises IncompleteRecordError."""
        if self._asked:
            write_readings(folder, self.readings)

    def see(self, inputs: Inputs, output: Output, mode: Mode) -> None:
        """One step of the loop."""
        del inputs, mode
        if self._ruler is None or output.record is None:
            return
        for event in output.events:
            if event.code == EVENT:
                self._asked += 1
                self._ruler.ask(tanks_of(event))
        if self._asked:
            t_s = output.record.t_s
            self.readings += [RulerReading(t_s, tank, level_cm, sd_cm) for tank, level_cm, sd_cm in self._ruler.take()]

    def answered(self) -> int:
        """How often the levels were asked for and read."""
        if self._ruler is None:
            return maxsize
        return self._asked if self._ruler.is_done() else self._asked - 1


class GivenRuler:
    """Readings that are known beforehand: each asking takes the next one of every tank that it asks for."""

    def __init__(self, levels: Sequence[Level]) -> None:
        self._levels = list(levels)
        self._now: list[Level] = []

    def ask(self, tanks: Sequence[int]) -> None:
        """Give one of each of these tanks; of a tank that has no more, none."""
        for tank in tanks:
            found = next((level for level in self._levels if level[0] == tank), None)
            if found is not None:
                self._levels.remove(found)
                self._now.append(found)

    def take(self) -> tuple[Level, ...]:
        """Those that were asked for."""
        levels, self._now = tuple(self._now), []
        return levels

    def is_done(self) -> bool:
        """Whether they were taken."""
        return not self._now


class EmulatedRuler:
    """Reads the emulator's true levels, each time with an error of the standard deviation sd_cm."""

    def __init__(self, true_level_cm: Callable[[], Quad], seed: int, sd_cm: float = SD_CM) -> None:
        self._true_level_cm, self._sd_cm = true_level_cm, sd_cm
        self._random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(12,)))
        self._levels: tuple[Level, ...] = ()

    def ask(self, tanks: Sequence[int]) -> None:
        """Read these now."""
        errors_cm = self._random.normal(0.0, self._sd_cm, len(tanks)).tolist()
        levels_cm = self._true_level_cm()
        self._levels = tuple(
            (tank, max(levels_cm[tank] + error_cm, 0.0), self._sd_cm)
            for tank, error_cm in zip(tanks, errors_cm, strict=True)
        )

    def take(self) -> tuple[Level, ...]:
        """What was read."""
        levels, self._levels = self._levels, ()
        return levels

    def is_done(self) -> bool:
        """Whether it was taken."""
        return not self._levels


def tanks_of(event: Event) -> tuple[int, ...]:
    """The tanks (0 to 3) that an event asks for."""
    tanks = event.data["tanks"]
    return tuple(int(tank) - 1 for tank in tanks) if isinstance(tanks, list) else ()


def read_readings(folder: Path) -> tuple[RulerReading, ...]:
    """The readings that a run folder keeps; none without the file. Raises SettingsError."""
    path = folder / FILE
    if not path.is_file():
        return ()
    rows = _rows(path, ("t_s", "tank", "level_cm", "sd_cm"))
    return tuple(RulerReading(row["t_s"], int(row["tank"]) - 1, row["level_cm"], row["sd_cm"]) for row in rows)


def write_readings(folder: Path, readings: Sequence[RulerReading]) -> None:
    """Keep readings in a run folder, also that there are none. Raises IncompleteRecordError."""
    lines = [f"{r.time_s:.3f},{r.tank + 1},{r.level_cm:.4f},{r.sd_cm:g}" for r in readings]
    with writing(folder / FILE):
        (folder / FILE).write_text("\n".join([HEADER, *lines]) + "\n", encoding="utf-8")


def _rows(path: Path, needed: Sequence[str]) -> list[dict[str, float]]:
    header, *lines = [line.strip() for line in read_text(path).splitlines() if line.strip()] or [""]
    names = [name.strip() for name in header.split(",")]
    missing = [name for name in needed if name not in names]
    if missing:
        raise SettingsError(
            f"{path}: the first line must name the columns {', '.join(needed)}; {missing[0]} is missing"
        )
    rows = []
    for number, line in enumerate(lines, 2):
        try:
            row = dict(zip(names, (float(cell) for cell in line.split(",")), strict=True))
        except ValueError:
            raise SettingsError(f"{path}: line {number}: want one number for each of {', '.join(names)}") from None
        if row["tank"] not in (1, 2, 3, 4):
            raise SettingsError(f"{path}: line {number}: tank = {row['tank']:g}: must be 1, 2, 3 or 4")
        if not 0.0 <= row["level_cm"] <= 1e3 or not 0.0 < row.get("sd_cm", SD_CM) <= 10.0:
            raise SettingsError(f"{path}: line {number}: level_cm must lie in 0..1000, sd_cm above 0 and up to 10")
        rows.append(row)
    return rows
