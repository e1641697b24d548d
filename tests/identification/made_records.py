"""Records for the tests of identification.

`levels_of` is a plain simulation of its own (small Euler steps, no kernel), to check the compiled one; records for the
tests of the fit are made with the compiled one, which is quick.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.simulation import simulate
from hil.core.types import Quad

Array = NDArray[np.float64]

DT_S = 0.005


def steps(seed: int, duration_s: float, period_s: float, *, low_V: float, high_V: float, hold_s: float) -> Array:
    """(n, 2) voltages of both pumps, drawn again after every hold_s."""
    random = np.random.default_rng(seed)
    n, hold = round(duration_s / period_s), round(hold_s / period_s)
    return np.repeat(random.uniform(low_V, high_V, (-(-n // hold), 2)), hold, axis=0)[:n]


def levels_of(model: RigModel, voltage_V: Array, period_s: float, initial_cm: Quad) -> Array:
    """(n, 4) levels at the rows: Euler steps of 5 ms. Delays are rounded to such steps."""
    A, a, top = model.tanks.area_cm2, model.tanks.outlet_cm2, model.tanks.height_cm
    d, s = model.tanks.datum_cm, sqrt(2.0 * model.tanks.gravity_cm_s2)
    per_row = round(period_s / DT_S)
    drive = np.array([model.pumps.drive((float(v1), float(v2))) for v1, v2 in voltage_V])
    late = [round(delay_s / DT_S) for delay_s in model.pumps.delay_s]
    h, w = list(initial_cm), drive[0].tolist()
    found = np.zeros((len(voltage_V), 4))
    (k1, k2), (g1, g2) = model.tanks.pump_gain_cm3_Vs, model.tanks.valve_split
    for row in range(len(voltage_V)):
        found[row] = h
        for part in range(per_row):
            for i in (0, 1):
                at = max((row * per_row + part - late[i]) // per_row, 0)
                w[i] += DT_S / max(model.lag_s[i], DT_S) * (drive[at, i] - w[i])
            flow = [a[i] * s * sqrt(max(h[i] + d[i], 0.0)) for i in range(4)]
            into3, into4 = (1.0 - g2) * k2 * w[1], (1.0 - g1) * k1 * w[0]
            flow[2] = min(flow[2], into3 + max(h[2], 0.0) * A[2] / DT_S)
            flow[3] = min(flow[3], into4 + max(h[3], 0.0) * A[3] / DT_S)
            into1, into2 = flow[2] + g1 * k1 * w[0], flow[3] + g2 * k2 * w[1]
            for i, into in enumerate((into1, into2, into3, into4)):
                h[i] = max(h[i] + DT_S / A[i] * (into - flow[i]), 0.0)
            for i in (2, 3):
                h[i - 2] += model.overflow_to_lower[i - 2] * max(h[i] - top[i], 0.0) * A[i] / A[i - 2]
            h = [min(level, end) for level, end in zip(h, top, strict=True)]
    return found


def record_of(
    model: RigModel,
    voltage_V: Array,
    period_s: float,
    initial_cm: Quad,
    *,
    seed: int = 0,
    name: str = "made",
    saturation_V: tuple[float, float] = (0.0, 10.24),
) -> LevelRecord:
    """A record with white noise of the model's own size, cut off at the ends of the saturation."""
    n = len(voltage_V)
    empty = LevelRecord(name, np.arange(n, dtype=float) * period_s, voltage_V, np.zeros((n, 4)))
    level_cm = simulate(model, empty, initial_cm).level_cm
    noise_V = np.random.default_rng(seed).standard_normal(level_cm.shape) * np.array(model.noise_V)
    reading_V = np.array(model.sensors.offset_V) + np.array(model.sensors.gain_V_cm) * level_cm + noise_V
    return replace(empty, reading_V=np.clip(reading_V, *saturation_V), saturation_V=saturation_V)
