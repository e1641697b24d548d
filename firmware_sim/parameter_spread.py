"""The parameters of a run's rig: each drawn uniformly within its spread, by the run's seed.

The numbers come from their own random stream, always in the same order, so that one spread does not change what
another one draws. With all spreads at 0 the settings are returned unchanged.
"""

import math

import numpy as np

from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings

PARAMETER_STREAM = 1
TURBULENCE_STREAM = 2
SPLIT_RANGE = (1e-3, 1.0 - 1e-3)


def drawn(settings: EmulatorSettings, seed: int) -> EmulatorSettings:
    """Return the settings with outlets, pump gains, valve splits, pump lags and sensor scales as the seed has them.

    A valve split stays within 0.001 .. 0.999. In the result pumps.lag_s and sensors.scale_error are values for each
    pump and sensor where a spread was asked for, and parameter_spread and lag_spread say what was asked for.
    """
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(PARAMETER_STREAM,)))
    deviation = random.uniform(-1.0, 1.0, 14).tolist()
    tanks, pumps, sensors = settings.tanks, settings.pumps, settings.sensors
    spread = settings.parameter_spread
    if spread > 0.0:
        tanks = tanks.model_copy(update={"outlet_cm2": _spread(tanks.outlet_cm2, spread, deviation[0:4])})
        low, high = SPLIT_RANGE
        splits = _spread(pumps.valve_split, spread, deviation[6:8])
        gains = _spread(pumps.gain_cm3_Vs, spread, deviation[4:6])
        pumps = pumps.model_copy(
            update={"gain_cm3_Vs": gains, "valve_split": tuple(min(max(split, low), high) for split in splits)}
        )
    if pumps.lag_spread > 0.0:
        lags = _spread(parts(pumps.lag_s, 2), pumps.lag_spread, deviation[8:10])
        pumps = pumps.model_copy(update={"lag_s": lags})
    if isinstance(sensors.scale_error, float) and sensors.scale_error != 0.0:
        errors = tuple(sensors.scale_error * part for part in deviation[10:14])
        sensors = sensors.model_copy(update={"scale_error": errors})
    return settings.model_copy(update={"tanks": tanks, "pumps": pumps, "sensors": sensors})


class Turbulence:
    """Volumes in cm3 that white flow noise adds to each tank in one level period, drawn by the seed."""

    def __init__(self, settings: EmulatorSettings, seed: int) -> None:
        root_s = math.sqrt(settings.nodes.levels_period_s)
        self._std_cm3 = [part * root_s for part in parts(settings.tanks.turbulence_cm3_sqrt_s, 4)]
        self._random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(TURBULENCE_STREAM,)))

    def volumes_cm3(self) -> list[float]:
        """Draw the next four."""
        volumes_cm3: list[float] = self._random.normal(0.0, self._std_cm3).tolist()
        return volumes_cm3


def _spread(values: tuple[float, ...], spread: float, deviation: list[float]) -> tuple[float, ...]:
    return tuple(value * (1.0 + spread * part) for value, part in zip(values, deviation, strict=True))
