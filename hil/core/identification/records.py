"""What an identification is made from: voltages, readings, and levels that somebody read by a ruler."""

from __future__ import annotations

from dataclasses import dataclass

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
    saturation_V : readings at or beyond these ends say only that the level is at least, or at most, that.
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
