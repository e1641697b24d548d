"""Level sensors while no pump runs: in range, status OK, zero where a tank is empty, and noise as in the rig file.

Noise is computed from the steps between consecutive readings, sqrt(mean(step^2) / 2), so that a falling level adds
none. Water in a tank falls, as eq. (1) says; a low level that does not is the zero of the sensor of an empty tank.
Levels are those of the level signals, see `hil.core.sensors`; what is shown is readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from statistics import fmean

from hil.core.counted import counted
from hil.core.sensors import LevelSensors
from hil.core.tanks import TankModel, level_rates
from hil.core.types import Pair, Quad
from hil.probe.check_result import Result, failed, not_checked, passed, warned
from hil.probe.observation import LEVEL_FRAMES, Observation
from hil.wire.receiver import CHANNEL_OK

STATUS_NAMES = {1: "under range", 2: "over range", 3: "fault"}
NOISE_WARN, NOISE_FAIL = 1.5, 3.0
"""Limits of the noise, as multiples of the rig file's."""
QUIET_WARN = 0.4
"""Noise below this share of it: the rig file is wrong, or the signal is at the end of its range."""
MIN_READINGS = 25
DT_S = 0.05
EMPTY_NOISES = 3.0
"""A level signal below so many times the noise counts as empty."""

LOW_SHARE = 0.05
"""A level signal below this share of the largest one that range and height allow may be that of an empty tank."""
STANDS_STILL = 0.3
"""A reading that falls by less than this share of what water would do is not that of water."""
FALL_STDS = 6.0
"""The fall of water must be so many of its standard deviations, to be judged."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One sensor as the rig file has it, and what was heard of it.

    readings_V : as sent. signals_V : as level signals. noise_V : of a reading. factor : level signal per reading.
    lowest_V, highest_V : the smallest and the largest level signal within its range, and the rim.
    """

    tank: int
    readings_V: list[float]
    signals_V: list[float]
    noise_V: float
    factor: float
    lowest_V: float
    highest_V: float

    @property
    def signal_noise(self) -> float:
        """Standard deviation of a level signal."""
        return abs(self.factor) * self.noise_V

    @property
    def is_empty(self) -> bool:
        """Whether the tank is empty, or its level too low for this sensor."""
        return fmean(self.signals_V) < max(self.lowest_V, 0.0) + EMPTY_NOISES * self.signal_noise

    @property
    def is_cut_off(self) -> bool:
        """Whether the end of the range cuts off the noise of an empty tank."""
        return fmean(self.signals_V) < self.lowest_V + EMPTY_NOISES * self.signal_noise


def channel_of(tank: int, readings_V: list[float], sensors: LevelSensors, noise_V: Quad, model: TankModel) -> Channel:
    """The channel of a tank (1 to 4) with these readings."""
    ends_V = [sensors.signals((end, end, end, end))[tank - 1] for end in sensors.range_V]
    return Channel(
        tank=tank,
        readings_V=readings_V,
        signals_V=[sensors.signals((v, v, v, v))[tank - 1] for v in readings_V],
        noise_V=noise_V[tank - 1],
        factor=sensors.factor[tank - 1],
        lowest_V=sensors.lowest_signals[tank - 1],
        highest_V=min(max(ends_V), sensors.signal_gain * model.height_cm[tank - 1]),
    )


def check_sensors(observation: Observation, sensors: LevelSensors, noise_V: Quad, model: TankModel) -> list[Result]:
    """Range, zero and noise of the four channels."""
    results = []
    falls_V = expected_falls(observation, sensors, model)
    for name, tanks in LEVEL_FRAMES.items():
        for tank in tanks:
            arrivals = observation.of(name)
            readings_V = [arrival.values[f"Level{tank}"] for arrival in arrivals]
            statuses = [int(arrival.values[f"Status{tank}"]) for arrival in arrivals]
            channel = channel_of(tank, readings_V, sensors, noise_V, model)
            results += [
                check_zero(channel, falls_V[tank - 1]) or check_range(tank, readings_V, statuses, sensors.range_V),
                check_noise(channel),
            ]
    return results


def check_range(tank: int, readings_V: list[float], statuses: list[int], range_V: Pair) -> Result:
    """Whether all readings are in the rig file's range with status OK."""
    check = f"sensor {tank} range"
    if not readings_V:
        return failed(check, "no reading", "is the level node switched on and connected to this bus?")
    invalid = [status for status in statuses if status != CHANNEL_OK]
    low_V, high_V = range_V
    outside = sum(not low_V <= reading_V <= high_V for reading_V in readings_V)
    mean_V = sum(readings_V) / len(readings_V)
    if invalid:
        what = STATUS_NAMES.get(invalid[-1], f"status {invalid[-1]}")
        found = f"{what} in {len(invalid)} of {counted(len(readings_V), 'reading')}, mean {mean_V:.3f} V"
        return failed(check, found, "check the sensor's wires and supply: open or short")
    if outside:
        found = f"{outside} of {counted(len(readings_V), 'reading')} outside {low_V:g}..{high_V:g} V"
        return failed(check, found, "check the sensor, or sensors.range_V in rig.toml")
    return passed(check, f"{mean_V:.3f} V, {min(readings_V):.3f} to {max(readings_V):.3f} V")


def expected_falls(observation: Observation, sensors: LevelSensors, model: TankModel) -> Quad:
    """(4,) by how many V each level signal falls from the first to the last quarter of the observation, by eq. (1)."""
    first_V, seconds = [], 0.0
    for name, tanks in LEVEL_FRAMES.items():
        arrivals = observation.of(name)
        quarter = arrivals[: max(len(arrivals) // 4, 1)]
        if not arrivals:
            return (0.0, 0.0, 0.0, 0.0)
        first_V += [fmean(arrival.values[f"Level{tank}"] for arrival in quarter) for tank in tanks]
        seconds = 0.75 * (arrivals[-1].t_ns - arrivals[0].t_ns) * 1e-9
    gain = model.level_gain_V_cm
    y1, y2, y3, y4 = sensors.signals((first_V[0], first_V[1], first_V[2], first_V[3]))
    start = h1, h2, h3, h4 = y1 / gain, y2 / gain, y3 / gain, y4 / gain
    for _ in range(round(seconds / DT_S)):
        r1, r2, r3, r4 = level_rates(model, (h1, h2, h3, h4), (0.0, 0.0))
        h1, h2 = max(h1 + r1 * DT_S, 0.0), max(h2 + r2 * DT_S, 0.0)
        h3, h4 = max(h3 + r3 * DT_S, 0.0), max(h4 + r4 * DT_S, 0.0)
    s1, s2, s3, s4 = start
    return gain * (s1 - h1), gain * (s2 - h2), gain * (s3 - h3), gain * (s4 - h4)


def check_zero(channel: Channel, fall_V: float) -> Result | None:
    """A warning if the level is low, but not zero, and does not fall as water would; None otherwise.

    fall_V : of the level signal, expected between the first and the last quarter of the readings.
    """
    signals_V, noise_V = channel.signals_V, channel.signal_noise
    quarter = len(signals_V) // 4
    if len(signals_V) < MIN_READINGS:
        return None
    is_low = not channel.is_empty and fmean(signals_V) < LOW_SHARE * channel.highest_V
    fell_V = fmean(signals_V[:quarter]) - fmean(signals_V[-quarter:])
    if not is_low or fall_V < FALL_STDS * noise_V * sqrt(2.0 / quarter) or fell_V > STANDS_STILL * fall_V:
        return None
    still = "it does not fall: water would" if channel.factor > 0.0 else "it does not rise: with water it would"
    found = f"{fmean(channel.readings_V):.3f} V, and {still}, by {fall_V / abs(channel.factor):.3f} V"
    advice = "if the tank is empty, adjust the sensor's zero, or sensors.offset_V; otherwise its outlet is blocked"
    return warned(f"sensor {channel.tank} range", found, advice)


def check_noise(channel: Channel) -> Result:
    """Standard deviation of a reading, compared with sensors.noise_V."""
    check, readings_V, noise_V = f"sensor {channel.tank} noise", channel.readings_V, channel.noise_V
    if len(readings_V) < MIN_READINGS:
        return not_checked(check, f"too few: {counted(len(readings_V), 'reading')}")
    steps = [(b - a) ** 2 for a, b in pairwise(readings_V)]
    found_V = sqrt(sum(steps) / (2 * len(steps)))
    found = f"{found_V * 1e3:.2f} mV; rig.toml {noise_V * 1e3:g} mV"
    is_empty = channel.is_cut_off
    if found_V == 0.0 and noise_V > 0.0 and not is_empty:
        return failed(check, f"does not change from {readings_V[0]:.4f} V", "the sensor or its converter is stuck")
    if found_V > NOISE_FAIL * noise_V:
        return failed(check, found, "check its shield and ground; is the water turbulent? Or set sensors.noise_V")
    if found_V > NOISE_WARN * noise_V:
        return warned(
            check, found, "set sensors.noise_V in rig.toml to the measured value, or find the source of the noise"
        )
    if is_empty:
        return not_checked(check, "the tank is empty: its noise is cut off at 0 V", "fill it and check again")
    if found_V < QUIET_WARN * noise_V:
        return warned(check, found, "set sensors.noise_V in rig.toml to the measured value: faults are detected sooner")
    return passed(check, found)
