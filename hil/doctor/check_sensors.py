"""Level sensors while no pump runs: in range, status OK, and noise as in the rig file.

Noise is computed from the steps between consecutive readings, sqrt(mean(step^2) / 2), so that a falling level adds
none.
"""

from __future__ import annotations

from itertools import pairwise
from math import sqrt

from hil.core.counted import counted
from hil.core.types import Pair
from hil.probe.observation import LEVEL_FRAMES, Observation
from hil.probe.result import Result, failed, not_checked, passed, warned
from hil.wire.receiver import CHANNEL_OK

STATUS_NAMES = {1: "under range", 2: "over range", 3: "fault"}
NOISE_WARN, NOISE_FAIL = 1.5, 3.0
"""Limits of the noise, as multiples of the rig file's."""
QUIET_WARN = 0.4
"""Noise below this share of it: the rig file is wrong, or the signal is at the end of its range."""
MIN_READINGS = 25
EMPTY_NOISES = 3.0
"""A level below so many times the noise counts as empty: its noise is cut off at 0 V."""


def check_sensors(observation: Observation, range_V: Pair, noise_V: float) -> list[Result]:
    """Range and noise of the four channels."""
    results = []
    for name, tanks in LEVEL_FRAMES.items():
        for tank in tanks:
            arrivals = observation.of(name)
            readings_V = [arrival.values[f"Level{tank}"] for arrival in arrivals]
            statuses = [int(arrival.values[f"Status{tank}"]) for arrival in arrivals]
            results += [
                check_range(tank, readings_V, statuses, range_V),
                check_noise(tank, readings_V, noise_V),
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


def check_noise(tank: int, readings_V: list[float], noise_V: float) -> Result:
    """Standard deviation of a reading, compared with sensors.noise_V."""
    check = f"sensor {tank} noise"
    if len(readings_V) < MIN_READINGS:
        return not_checked(check, f"too few: {counted(len(readings_V), 'reading')}")
    steps = [(b - a) ** 2 for a, b in pairwise(readings_V)]
    found_V = sqrt(sum(steps) / (2 * len(steps)))
    found = f"{found_V * 1e3:.2f} mV; rig.toml {noise_V * 1e3:g} mV"
    is_empty = sum(readings_V) / len(readings_V) < EMPTY_NOISES * noise_V
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
