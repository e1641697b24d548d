"""What an identification is made from: voltages, readings, and levels that somebody read by a ruler.

Times, and how they come into a record. At 0.02 % of error in gains and outlets a few milliseconds are seen, above all
in the lags: on the emulator frames stamped 5 ms late make the lags 3 % larger, 20 ms late 10 %, and gains and outlets
0.003 %.

* A level frame has the readings of its own time: the level node samples and sends at once, every 20 ms. Its line in
  `can.log` has the time at which it arrived: the kernel's stamp where the interface has one (socketcan), otherwise
  the moment at which the loop took it from the bus, up to some milliseconds later. In lockstep it is exact. Whole
  microseconds. This is the best source: one row for each pair of level frames, `samples` 1.
* A command acts when the pump node gets it: the time of its own line in `can.log`, which is after the step that
  computed it. In lockstep that is the tick's time, after the frames of that time: row k has a reading from before the
  change, and the voltage from it on, as `LevelRecord` says.
* The voltage is what PumpStatus reports next: the node's converter of 12 bit has steps of 2.4 mV, so that the command
  itself is up to 1.2 mV off. PumpStatus comes every 50 ms and says nothing of when the voltage changed: take the time
  from the command and the value from the first status after it, whose echo is that command.
* Steps of the wire: with few different voltages, whose steps of 0.2 mV in PumpStatus do not average out, gains and
  outlets are 0.003 % off, half of the standard deviation after 12 minutes; with a voltage of its own in each hold the
  error is gone. A reading of a converter of 12 bit is 0.05 mV too high on average, because its steps of 2.5 mV are
  rounded to those of the wire; that is seen a little.
* `ticks.csv`: h1_V .. h4_V of a row are means of all readings since the last tick, so for the time t - (count - 1)/2
  frame periods, with 0.1 s and 20 ms 40 ms before t_s; they are level signals and not readings. v1_applied_V of a row
  is what the node reported before this tick, so it belongs to the interval from the last tick to this one. Used as
  they are, with each row's own voltage (v1_V), the lags come out 20 % too large, with v1_applied_V 30 % too small;
  gains and outlets 0.01 % off. Right is one row at each tick, which has the voltage and no reading (NaN), and one 40
  ms before each tick, which has the mean, `samples` 5 and the voltage of the row before. Nothing is lost by the
  means: the intervals are as with single frames, in a third of the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RulerReading:
    """A level that was read by a ruler. tank : 0..3. sd_cm : one standard deviation of the reading."""

    time_s: float
    tank: int
    level_cm: float
    sd_cm: float = 0.1


@dataclass(frozen=True, eq=False)
class LevelRecord:
    """One record of one experiment, without gaps.

    time_s : (n,) ascending. voltage_V : (n, 2) at the pumps' terminals; row k holds from time_s[k] to time_s[k + 1].
    reading_V : (n, 4) readings of the sensors as they are, before any calibration; NaN where there is none, or where
    it is not to be used. samples : (n, 4) how many readings of the sensor each value is the mean of.
    saturation_V : range of the sensors; readings at or beyond `ends` say only that the level is at least, or at most,
    that.
    initial_cm : (4,) levels at time_s[0] where they are known (an empty rig), NaN where not.
    """

    name: str
    time_s: Array
    voltage_V: Array
    reading_V: Array
    samples: Array | None = None
    saturation_V: tuple[float, float] = (-float("inf"), float("inf"))
    initial_cm: tuple[float, float, float, float] = (float("nan"),) * 4
    ruler: tuple[RulerReading, ...] = ()

    def __post_init__(self) -> None:
        for name in ("time_s", "voltage_V", "reading_V", "samples"):
            value = getattr(self, name)
            if value is not None:
                array = np.array(value, dtype=float)
                array.flags.writeable = False
                object.__setattr__(self, name, array)
        n = len(self.time_s)
        if n < 2 or self.voltage_V.shape != (n, 2) or self.reading_V.shape != (n, 4):
            raise ValueError(
                f"record {self.name!r}: shapes {self.time_s.shape}, {self.voltage_V.shape}, {self.reading_V.shape}"
            )
        if not (np.diff(self.time_s) > 0.0).all():
            raise ValueError(f"record {self.name!r}: its times do not ascend")

    @property
    def ends(self) -> tuple[float, float]:
        """V from where on readings count as saturated: the range's lower end, and a thousandth below its upper end.

        The highest code of a converter lies a step below the end of its range: 10.2375 V with 12 bits over 10.24 V.
        """
        low_V, high_V = self.saturation_V
        return low_V, high_V - (1e-3 * (high_V - low_V) if isfinite(high_V - low_V) else 0.0)
