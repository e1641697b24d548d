"""Pumps as they are: a dead zone, a curve that bends, and a delay between the pump and its tanks.

The drive of a pump is the voltage at which a pump without dead zone and curve would give the same flow in the steady
state: with v at its terminals and x = max(0, v - dead zone),

    drive = x (1 + curve x),      flow = gain times drive

Control law, level filter and diagnosis work with drives throughout, so that eq. (1) holds for them as it stands.
Commands, the pump node's report and the record are voltages. The delay is that of the hose: what a pump gives now
arrives delay_s later.

Why: `docs/decisions/0025-a-rig-as-it-is.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

from hil.core.types import Pair

NONE: Pair = (0.0, 0.0)

Piece = tuple[int, int, Pair]
"""From and until when, in ns, the pumps had these drives."""


@dataclass(frozen=True)
class PumpPath:
    """What lies between the commands and the flow of both pumps, but for gain and lag; the default is straight.

    dead_zone_V : (2,) below it a pump gives no flow. curve_1_V : (2,) bend, 1/V. delay_s : (2,) until the flow arrives.
    range_V : smallest and largest voltage.
    """

    dead_zone_V: Pair = NONE
    curve_1_V: Pair = NONE
    delay_s: Pair = NONE
    range_V: Pair = (0.0, 10.0)

    @cached_property
    def is_straight(self) -> bool:
        """Whether the drive is the voltage itself."""
        return self.dead_zone_V == NONE and self.curve_1_V == NONE

    @cached_property
    def is_direct(self) -> bool:
        """Whether the flow arrives at once."""
        return self.delay_s == NONE

    @cached_property
    def drive_ranges(self) -> tuple[Pair, Pair]:
        """Smallest and largest drive, of pump 1 and of pump 2."""
        low_V, high_V = self.range_V
        low, high = self.drive((low_V, low_V)), self.drive((high_V, high_V))
        return (low[0], high[0]), (low[1], high[1])

    @property
    def max_drives(self) -> Pair:
        """(2,) the largest drive of each pump."""
        return self.drive_ranges[0][1], self.drive_ranges[1][1]

    def drive(self, voltage_V: Pair) -> Pair:
        """(2,) the drives for these voltages."""
        if self.is_straight:
            return voltage_V
        (v1, v2), (d1, d2), (c1, c2) = voltage_V, self.dead_zone_V, self.curve_1_V
        x1, x2 = max(v1 - d1, 0.0), max(v2 - d2, 0.0)
        return x1 * (1.0 + c1 * x1), x2 * (1.0 + c2 * x2)

    def voltage(self, drive_V: Pair) -> Pair:
        """(2,) the voltages for these drives; a drive of 0 V or less is given back as it is: such a pump is off.

        Nothing is limited to the range; a drive that the curve never reaches gives the voltage of its largest one.
        """
        if self.is_straight:
            return drive_V
        return self._voltage_of(0, drive_V[0]), self._voltage_of(1, drive_V[1])

    def _voltage_of(self, pump: int, drive_V: float) -> float:
        if drive_V <= 0.0:
            return drive_V
        root = sqrt(max(1.0 + 4.0 * self.curve_1_V[pump] * drive_V, 0.0))
        return self.dead_zone_V[pump] + 2.0 * drive_V / (1.0 + root)

    def within_range(self, pump: int, drive_V: float) -> float:
        """The voltage of one pump (0, 1) for a drive, within its range."""
        drive = (drive_V, 0.0) if pump == 0 else (0.0, drive_V)
        low_V, high_V = self.range_V
        return min(max(self.voltage(drive)[pump], low_V), high_V)

    def slope(self, pump: int, drive_V: float) -> float:
        """By how many V the voltage of one pump (0, 1) rises with its drive, at this drive."""
        if self.is_straight:
            return 1.0
        return 1.0 / sqrt(max(1.0 + 4.0 * self.curve_1_V[pump] * max(drive_V, 0.0), 1e-6))


STRAIGHT = PumpPath()


@dataclass(frozen=True, slots=True)
class UnderWay:
    """Drives that have not arrived yet, the oldest first."""

    pieces: tuple[Piece, ...] = ()

    def with_drive(self, pumps: PumpPath, from_ns: int, until_ns: int, drive_V: Pair) -> UnderWay:
        """Add the drives of the last period; what has arrived before it is dropped."""
        oldest_ns = from_ns - round(max(pumps.delay_s) * 1e9)
        kept = tuple(piece for piece in self.pieces if piece[1] > oldest_ns)
        return UnderWay((*kept, (from_ns, until_ns, drive_V)))

    def arrived(self, pumps: PumpPath, from_ns: int, until_ns: int) -> Pair:
        """(2,) mean drives of what arrives in this time; before the first piece, those of the first piece."""
        return self._mean(0, pumps, from_ns, until_ns), self._mean(1, pumps, from_ns, until_ns)

    def largest(self) -> Pair:
        """(2,) the largest drive of each pump that is still under way; 0 V if none is."""
        if not self.pieces:
            return NONE
        first = max((drive[0] for _, _, drive in self.pieces), default=0.0)
        return first, max((drive[1] for _, _, drive in self.pieces), default=0.0)

    def _mean(self, pump: int, pumps: PumpPath, from_ns: int, until_ns: int) -> float:
        delay_ns = round(pumps.delay_s[pump] * 1e9)
        from_ns, until_ns = from_ns - delay_ns, until_ns - delay_ns
        first_ns, _, first = self.pieces[0]
        total = first[pump] * max(min(first_ns, until_ns) - from_ns, 0)
        for begin_ns, end_ns, drive_V in self.pieces:
            total += drive_V[pump] * max(min(end_ns, until_ns) - max(begin_ns, from_ns), 0)
        return total / (until_ns - from_ns)
