"""Inflow check: a mass balance of the upper tank that a pump fills, over one second, without the filter.

With two faults at once the filter may explain a pump that runs dry by something else; the balance does not.
"""

from __future__ import annotations

from math import isfinite, sqrt

import numpy as np

from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, READING, VOLTAGE
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.refilter import RING

WINDOW_S = 1.0
MIN_V = 2.0
"""A pump with a lower voltage fills its tank too slowly for a check within the window."""

MIN_SHARE = 0.2
"""A smaller share of the expected inflow counts as no water; with 5 mV of noise it is known to a tenth at MIN_V."""

MIN_READ = 0.3
"""Share of the periods that must have a reading: short periods do not all have one."""


def is_missing(config: DetectorConfig, m: Memory, pump: int) -> bool:
    """Whether pump 0 or 1 has been driven for the whole window and its upper tank received no water from it.

    False where that can't be judged, because the pump's voltage was too low or the tank's sensor is not used.
    """
    steps = round(WINDOW_S / float(m.entry[PERIOD]))
    if not 2 <= steps < min(m.now, RING):
        return False
    tank = 3 - pump  # each pump fills the upper tank across
    rows = m.history.entries[np.arange(m.now - steps, m.now + 1) % RING]
    voltages = rows[:, VOLTAGE + pump].tolist()
    if min(voltages) < MIN_V or not m.usable[tank]:
        return False
    # plain numbers: for a window of some ten rows numpy's functions take several times as long
    model, gain, time_s = config.model, config.model.level_gain_V_cm, 0.0
    times_s: list[float] = []
    levels_cm: list[float] = []
    for reading_V, period_s in zip(rows[:, READING + tank].tolist(), rows[:, PERIOD].tolist(), strict=True):
        time_s += period_s
        if isfinite(reading_V):
            times_s.append(time_s)
            levels_cm.append(reading_V / gain)
    if len(levels_cm) < max(MIN_READ * len(voltages), 2):
        return False
    datum_cm = float(model.datum_cm[tank])
    root = sum(sqrt(max(level_cm, 0.0) + datum_cm) for level_cm in levels_cm) / len(levels_cm)
    inflow = float(model.area_cm2[tank]) * _slope(times_s, levels_cm) + float(model.outlet_flow[tank]) * root
    expected = (1.0 - float(model.valve_split[pump])) * float(model.pump_gain_cm3_Vs[pump])
    return bool(inflow < MIN_SHARE * expected * sum(voltages) / len(voltages))


def _slope(times: list[float], values: list[float]) -> float:
    """Slope of the straight line with the least squared errors. times : ascending, two at least."""
    mean = sum(times) / len(times)
    offsets = [time - mean for time in times]
    return sum(o * value for o, value in zip(offsets, values, strict=True)) / sum(o * o for o in offsets)
