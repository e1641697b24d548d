"""Somebody beside the rig reads the levels and types them, while the phase goes on."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from math import isfinite
from queue import SimpleQueue

from rich.console import Console

from hil.bench.ruler import SD_CM, Level
from hil.edge.host.typed_lines import TypedLines

MAX_CM = 1000.0


class TerminalRuler:
    """Asks for one tank after the other; an empty line leaves a tank out. The loop never waits for the terminal.

    sd_cm : standard deviation of each reading.
    """

    def __init__(self, console: Console, lines: TypedLines | None = None, sd_cm: float = SD_CM) -> None:
        self._console, self._sd_cm = console, sd_cm
        self._lines = lines
        self._tanks: list[int] = []
        self._texts: SimpleQueue[str] = SimpleQueue()
        threading.Thread(target=self._write, name="ruler", daemon=True).start()

    def ask(self, tanks: Sequence[int]) -> None:
        """Begin with the first of these tanks (0 to 3)."""
        self._lines = self._lines or TypedLines()
        self._tanks = list(tanks)
        self._prompt()

    def take(self) -> tuple[Level, ...]:
        """The level that was typed since the last call, if any."""
        if self.is_done() or self._lines is None:
            return ()
        try:
            line = self._lines.next()
        except EOFError:
            self._tanks = []
            return ()
        if line is None:
            return ()
        level = self._level(line)
        if level is None:
            self._texts.put(f"{line!r} is no level in cm within 0..{MAX_CM:g}")
            self._prompt()
            return ()
        tank = self._tanks.pop(0)
        self._prompt()
        return ((tank, level, self._sd_cm),) if isfinite(level) else ()

    def is_done(self) -> bool:
        """Whether all tanks were asked for."""
        return not self._tanks

    def _level(self, line: str) -> float | None:
        """The level, NaN for an empty line, None for what is no level."""
        if not line.strip():
            return float("nan")
        try:
            level_cm = float(line.strip().replace(",", "."))
        except ValueError:
            return None
        return level_cm if 0.0 <= level_cm <= MAX_CM else None

    def _prompt(self) -> None:
        text = (
            "thank you"
            if self.is_done()
            else f"level of tank {self._tanks[0] + 1} by the ruler, cm (Enter: leave it out):"
        )
        self._texts.put(text)

    def _write(self) -> None:
        while True:
            self._console.print(self._texts.get(), highlight=False, markup=False)
