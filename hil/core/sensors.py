"""Level sensors as they are: each with a gain of its own, of either sign, and an offset.

A reading is v = offset + gain times level. A *level signal* is what a sensor without offset would read whose gain is
the same for all four: y = k (v - offset)/gain = k times level. Control law, level filter, diagnosis and record work
with level signals; only the wire, its checks (range, saturation, readings that repeat) and `can.log` have readings.

k is the sensors' gain if all have the same one and it is positive, so that without an offset a level signal is the
reading. Otherwise it is 0.5 V/cm, that of the paper.

Why: `docs/decisions/0025-a-rig-as-it-is.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from hil.core.types import Measurement, Pair, Quad

PAPER_GAIN_V_CM = 0.5


def signal_gain(gain_V_cm: float | Sequence[float]) -> float:
    """The k of the level signals, V/cm, for sensors of this gain, or of these."""
    gains = [gain_V_cm] if isinstance(gain_V_cm, int | float) else list(gain_V_cm)
    first = float(gains[0])
    return first if first > 0.0 and all(gain == first for gain in gains) else PAPER_GAIN_V_CM


def levels_shown(signal_V: Quad, gain_V_cm: float) -> Quad:
    """(4,) the levels in cm that these level signals show. gain_V_cm : their k."""
    y1, y2, y3, y4 = signal_V
    return y1 / gain_V_cm, y2 / gain_V_cm, y3 / gain_V_cm, y4 / gain_V_cm


@dataclass(frozen=True)
class LevelSensors:
    """The four sensors; by default those of the paper.

    gain_V_cm, offset_V : (4,) as above. range_V : smallest and largest valid reading.
    """

    gain_V_cm: Quad = (PAPER_GAIN_V_CM, PAPER_GAIN_V_CM, PAPER_GAIN_V_CM, PAPER_GAIN_V_CM)
    offset_V: Quad = (0.0, 0.0, 0.0, 0.0)
    range_V: Pair = (0.0, 10.24)

    @cached_property
    def signal_gain(self) -> float:
        """The k of the level signals, V/cm."""
        return signal_gain(self.gain_V_cm)

    @cached_property
    def is_plain(self) -> bool:
        """Whether a level signal is the reading itself."""
        return self.offset_V == (0.0, 0.0, 0.0, 0.0) and self.gain_V_cm == (self.signal_gain,) * 4

    @cached_property
    def factor(self) -> Quad:
        """(4,) by how many V each level signal rises with 1 V of its reading; negative for a falling sensor."""
        if self.is_plain:
            return (1.0, 1.0, 1.0, 1.0)
        k, (g1, g2, g3, g4) = self.signal_gain, self.gain_V_cm
        return k / g1, k / g2, k / g3, k / g4

    @cached_property
    def lowest_signals(self) -> Quad:
        """(4,) the smallest level signal that each sensor can show within its range; below 0 V it is not cut off."""
        signals = [self.signals((end, end, end, end)) for end in self.range_V]
        w1, w2, w3, w4 = (min(ends) for ends in zip(*signals, strict=True))
        return w1, w2, w3, w4

    def signals(self, reading_V: Quad) -> Quad:
        """(4,) the level signals of these readings."""
        if self.is_plain:
            return reading_V
        (v1, v2, v3, v4), (o1, o2, o3, o4), (f1, f2, f3, f4) = reading_V, self.offset_V, self.factor
        return f1 * (v1 - o1), f2 * (v2 - o2), f3 * (v3 - o3), f4 * (v4 - o4)

    def readings(self, signal_V: Quad) -> Quad:
        """(4,) the readings that have these level signals."""
        if self.is_plain:
            return signal_V
        (y1, y2, y3, y4), (o1, o2, o3, o4), (f1, f2, f3, f4) = signal_V, self.offset_V, self.factor
        return o1 + y1 / f1, o2 + y2 / f2, o3 + y3 / f3, o4 + y4 / f4

    def scaled(self, noise_V: Quad) -> Quad:
        """(4,) standard deviations of readings, as those of the level signals."""
        n1, n2, n3, n4 = (abs(f) * noise for f, noise in zip(self.factor, noise_V, strict=True))
        return n1, n2, n3, n4

    def level_signals(self, readings: Measurement) -> Measurement:
        """A measurement of readings, as one of level signals; what was valid stays valid."""
        if self.is_plain:
            return readings
        return replace(
            readings,
            level_V=self.signals(readings.level_V),
            variance_V2=self._squared(readings.variance_V2),
            jitter_V2=self._squared(readings.jitter_V2),
        )

    def _squared(self, square_V2: Quad) -> Quad:
        (s1, s2, s3, s4), (f1, f2, f3, f4) = square_V2, self.factor
        return f1 * f1 * s1, f2 * f2 * s2, f3 * f3 * s3, f4 * f4 * s4


PLAIN = LevelSensors()
