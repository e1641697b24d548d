"""Simulation of a record: levels and readings from voltages, with derivatives where they are wanted.

The model and its limits: `kernel`. A reading is offset + gain times level and is cut off at the ends of the record's
saturation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, sqrt

import numpy as np
from numpy.typing import NDArray

from hil.core.diagnosis.glr.compiled import entry_point
from hil.core.identification import kernel
from hil.core.identification.parameters import PARAMETERS, RigModel, values_of
from hil.core.identification.records import LevelRecord
from hil.core.identification.result import Prediction
from hil.core.tanks import equilibrium
from hil.core.types import Quad

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LEVELS = ("h1", "h2", "h3", "h4")
"""Names of the initial levels, behind those of the parameters."""

ORDER = {name: index for index, name in enumerate((*(row.name for row in PARAMETERS), *LEVELS))}
"""Index of a parameter in the vector of the simulation."""

_integrate = entry_point(kernel.integrate)


@dataclass(frozen=True, eq=False)
class Simulated:
    """What the model gives for a record.

    level_cm : (n, 4). rows : (r,) ascending, those of which the derivatives are known. by : (r, 4, m) derivatives of
    the levels there by the parameters that were asked for.
    """

    level_cm: Array
    by: Array
    rows: Ints


def levels(
    model: RigModel, record: LevelRecord, initial_cm: Quad, wanted: Sequence[str] = (), rows: Ints | None = None
) -> Simulated:
    """Levels of a record, with their derivatives by the parameters of these names (h1..h4: initial levels).

    rows : of which the derivatives are wanted, ascending; None: all.
    The initial levels are limited to those between empty and full. Before the first row the voltages were those of the
    first row.
    """
    tanks = model.tanks
    geometry = kernel.Geometry(
        np.array(tanks.area_cm2), np.array(tanks.height_cm), sqrt(2.0 * tanks.gravity_cm_s2), np.array(tanks.arriving)
    )
    column = np.full(len(ORDER), -1, dtype=np.int64)
    for position, name in enumerate(wanted):
        column[ORDER[name]] = position
    level_cm = np.zeros((len(record.time_s), 4))
    n = len(record.time_s)
    rows = np.arange(n, dtype=np.int64) if rows is None else rows
    slot = np.full(n, -1, dtype=np.int64)
    slot[rows] = np.arange(len(rows))
    by = np.zeros((len(rows), 4, len(wanted)))
    start_cm = np.clip(np.array(initial_cm), 0.0, geometry.height_cm)
    time_s, voltage_V = np.array(record.time_s), np.array(record.voltage_V)
    theta = np.array(list(values_of(model).values()))
    _integrate(theta, geometry, time_s, voltage_V, start_cm, column, slot, level_cm, by)
    return Simulated(level_cm, by, rows)


def first_levels(model: RigModel, record: LevelRecord, window_s: float = 0.5) -> Quad:
    """Levels at the record's start: those known, otherwise by the median of the readings of the first window_s.

    Where there are no readings, or only saturated ones, the level at which the first voltages would hold the tank.
    """
    (g1, g2, g3, g4), tanks = model.sensors.gain_V_cm, model.tanks
    at_rest = equilibrium(tanks, _positive(model, record))
    known = []
    for i, gain in enumerate((g1, g2, g3, g4)):
        early = record.reading_V[record.time_s <= record.time_s[0] + window_s, i]
        low_V, high_V = record.ends
        early = early[(early > low_V) & (early < high_V)]
        level = record.initial_cm[i]
        if isnan(level):
            level = (float(np.median(early)) - model.sensors.offset_V[i]) / gain if len(early) else at_rest[i]
        known.append(min(max(level, 0.0), tanks.height_cm[i]))
    return known[0], known[1], known[2], known[3]


def _positive(model: RigModel, record: LevelRecord) -> tuple[float, float]:
    """The drives of the record's first row, 0 V at least."""
    first, second = model.pumps.drive((float(record.voltage_V[0, 0]), float(record.voltage_V[0, 1])))
    return max(first, 0.0), max(second, 0.0)


def readings(model: RigModel, record: LevelRecord, level_cm: Array) -> Array:
    """(n, 4) what the sensors show at these levels, within the record's saturation."""
    reading_V = np.array(model.sensors.offset_V) + np.array(model.sensors.gain_V_cm) * level_cm
    return np.clip(reading_V, *record.saturation_V)


def simulate(
    model: RigModel, record: LevelRecord, initial_cm: Quad | None = None, is_held_out: bool = False
) -> Prediction:
    """The record, and what the model predicts for its voltages.

    initial_cm : levels at its start; None: `first_levels`. To fit them: `robust_fit.fit_initial`.
    """
    level_cm = levels(model, record, first_levels(model, record) if initial_cm is None else initial_cm).level_cm
    return prediction(model, record, level_cm, is_held_out)


def prediction(model: RigModel, record: LevelRecord, level_cm: Array, is_held_out: bool = False) -> Prediction:
    """The record and these simulated levels (n, 4), as a `Prediction`."""
    predicted_V = np.where(np.isnan(record.reading_V), np.nan, readings(model, record, level_cm))
    return Prediction(
        name=record.name,
        is_held_out=is_held_out,
        time_s=record.time_s,
        voltage_V=record.voltage_V,
        reading_V=record.reading_V,
        predicted_V=predicted_V,
        level_cm=level_cm,
    )
