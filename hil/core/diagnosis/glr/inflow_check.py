"""Inflow check: a mass balance of the upper tank that a pump fills, over one second, without the filter.

With two faults at once the filter may explain a pump that runs dry by something else; the balance does not.
"""

from __future__ import annotations

import numpy as np

from hil.core.diagnosis.glr.filter import PERIOD, READING, VOLTAGE
from hil.core.diagnosis.glr.memory import DetectorConfig, Memory
from hil.core.diagnosis.glr.replay import RING

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
    rows = m.history.entries[np.arange(m.now - steps, m.now + 1) % RING]
    tank = 3 - pump  # each pump fills the upper tank across
    voltage_V = rows[:, VOLTAGE + pump]
    level_cm = rows[:, READING + tank] / config.model.level_gain_V_cm
    is_read = np.isfinite(level_cm)
    if float(voltage_V.min()) < MIN_V or not m.usable[tank] or is_read.sum() < MIN_READ * len(rows):
        return False
    level_cm, times_s = level_cm[is_read], np.cumsum(rows[:, PERIOD])[is_read]
    rate_cm_s = float(np.polyfit(times_s, level_cm, 1)[0])
    model = config.model
    heads_cm = np.maximum(level_cm, 0.0) + model.datum_cm[tank]
    inflow = model.area_cm2[tank] * rate_cm_s + model.outlet_flow[tank] * np.sqrt(heads_cm).mean()
    expected = (1.0 - model.valve_split[pump]) * model.pump_gain_cm3_Vs[pump] * voltage_V.mean()
    return bool(inflow < MIN_SHARE * expected)
