"""Faults of the level sensors. Target: sensor of tank 1 .. 4.

Bias, drift and noise add to the signal before the converter, each once; stuck, open and garbage replace the reading
behind it, and of these only one can: the one that began last.
"""

from typing import Annotated, Literal

import numpy as np

from firmware_sim.faults.base import FaultTable, TankNumber
from firmware_sim.faults.effects import NS_PER_S, Codes, Effects, Episode, Reading
from firmware_sim.frames import ChannelStatus
from firmware_sim.setting_types import within

RANGE_V = 10.24


class SensorBias(FaultTable):
    """The signal is `value` V too high (below 0: too low)."""

    kind: Literal["sensor_bias"]
    target: TankNumber
    value: Annotated[float, within(-RANGE_V, RANGE_V)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the channel's bias."""
        del episode
        effects.channel(self.target).bias_V = self.value


class SensorDrift(FaultTable):
    """The signal runs away by `value` V/s from the onset on."""

    kind: Literal["sensor_drift"]
    target: TankNumber
    value: Annotated[float, within(-10.0, 10.0)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the channel's drift."""
        rate_V_s, begin_ns = self.value, episode.begin_ns
        effects.channel(self.target).drift_V = lambda now_ns: rate_V_s * (now_ns - begin_ns) / NS_PER_S


class SensorNoise(FaultTable):
    """White noise of standard deviation `value` V on top of the sensor's own."""

    kind: Literal["sensor_noise"]
    target: TankNumber
    value: Annotated[float, within(0.0, RANGE_V)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the channel's added noise."""
        rms_V, random = self.value, episode.random
        effects.channel(self.target).noise_V = lambda: rms_V * float(random.standard_normal())


class SensorStuck(FaultTable):
    """The converter repeats the reading that it sent last before the onset."""

    kind: Literal["sensor_stuck"]
    target: TankNumber

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Hold the channel's reading."""
        effects.channel(self.target).overrides.append(episode.memory(_Held))


class SensorOpen(FaultTable):
    """A broken wire on an input that is pulled up: the highest reading, and the channel says OverRange."""

    kind: Literal["sensor_open"]
    target: TankNumber

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Put the channel over its range."""
        del episode
        effects.channel(self.target).overrides.append(_pulled_up)


class SensorGarbage(FaultTable):
    """Uniformly random codes over the converter's whole range; the channel says Ok."""

    kind: Literal["sensor_garbage"]
    target: TankNumber

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Replace the channel's readings."""
        effects.channel(self.target).overrides.append(episode.memory(lambda: _Garbage(episode.random)))


class _Held:
    """Repeats one reading."""

    def __init__(self) -> None:
        self._reading: Reading | None = None

    def __call__(self, fresh: Reading, last: Reading | None, codes: Codes) -> Reading:
        del codes
        if self._reading is None:
            self._reading = fresh if last is None else last
        return self._reading


class _Garbage:
    """Makes readings up."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random

    def __call__(self, fresh: Reading, last: Reading | None, codes: Codes) -> Reading:
        del fresh, last
        return int(self._random.integers(0, codes.top + 1)) * codes.step_V, ChannelStatus.OK


def _pulled_up(fresh: Reading, last: Reading | None, codes: Codes) -> Reading:
    del fresh, last
    return codes.top * codes.step_V, ChannelStatus.OVER_RANGE


SENSOR_KINDS: tuple[type[FaultTable], ...] = (
    SensorBias,
    SensorDrift,
    SensorNoise,
    SensorStuck,
    SensorOpen,
    SensorGarbage,
)
