"""Faults of the level sensors. Target: sensor of tank 1 .. 4.

Bias, drift and noise add to the signal before the converter, each once. Stuck, open and garbage replace the converter's
reading; of these, the fault that began last is used.
"""

from typing import Annotated, Literal

import numpy as np

from firmware_sim.faults.base import FailureWord, FaultTable, TankNumber
from firmware_sim.faults.effects import NS_PER_S, Codes, Effects, Reading
from firmware_sim.faults.episode import Episode
from firmware_sim.frames import ChannelStatus
from firmware_sim.setting_types import within

RANGE_V = 10.24


class SensorBias(FaultTable):
    """`value` V are added to the signal, before the converter."""

    acts_on = "sensor of tank"
    unit = "V"
    grows_from = "0"
    words = (FailureWord("level", "wrong"),)

    kind: Literal["sensor_bias"]
    target: TankNumber
    value: Annotated[float, within(-RANGE_V, RANGE_V)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the channel's bias."""
        effects.channel(self.target).bias_V = episode.grown(0.0, self.value)


class SensorDrift(FaultTable):
    """The signal drifts by `value` V/s from the onset on.

    With `ramp_s` the rate grows from 0, and the error with the square of the time; without it the error grows evenly.
    """

    acts_on = "sensor of tank"
    unit = "V/s"
    grows_from = "0"
    words = (FailureWord("level", "drift"),)

    kind: Literal["sensor_drift"]
    target: TankNumber
    value: Annotated[float, within(-10.0, 10.0)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the channel's drift."""
        rate_V_s = self.value
        effects.channel(self.target).drift_V = lambda now_ns: rate_V_s * episode.grown_ns(now_ns) / NS_PER_S


class SensorNoise(FaultTable):
    """White noise of standard deviation `value` V is added to the sensor's own."""

    acts_on = "sensor of tank"
    unit = "V rms"
    grows_from = "0"
    words = (FailureWord("level", "noise"),)

    kind: Literal["sensor_noise"]
    target: TankNumber
    value: Annotated[float, within(0.0, RANGE_V)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the channel's added noise."""
        rms_V, random = episode.grown(0.0, self.value), episode.random
        effects.channel(self.target).noise_V = lambda: rms_V * float(random.standard_normal())


class SensorStuck(FaultTable):
    """The converter repeats the last reading before the onset, with its status."""

    acts_on = "sensor of tank"
    words = (FailureWord("level", "stuck"),)

    kind: Literal["sensor_stuck"]
    target: TankNumber

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Hold the channel's reading."""
        effects.channel(self.target).overrides.append(episode.memory(_Held))


class SensorOpen(FaultTable):
    """A broken wire on an input with a pull-up resistor: the highest reading, with status OverRange."""

    acts_on = "sensor of tank"
    words = (FailureWord("level", "off"),)

    kind: Literal["sensor_open"]
    target: TankNumber

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Put the channel over its range."""
        del episode
        effects.channel(self.target).overrides.append(_pulled_up)


class SensorGarbage(FaultTable):
    """Uniformly random codes over the converter's whole range, with status Ok."""

    acts_on = "sensor of tank"
    words = (FailureWord("level", "garbage"),)

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
    """Returns a random code each time."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random

    def __call__(self, fresh: Reading, last: Reading | None, codes: Codes) -> Reading:
        del fresh, last
        return int(self._random.integers(0, codes.top + 1)) * codes.step_V, ChannelStatus.OK


def _pulled_up(fresh: Reading, last: Reading | None, codes: Codes) -> Reading:
    del fresh, last
    return codes.top * codes.step_V, ChannelStatus.OVER_RANGE
