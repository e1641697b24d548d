"""The public cascaded-tanks record, fitted with the project's model and engine.

The record (Schoukens, Mattsson, Wigren and Noel, "Cascaded tanks benchmark combining soft and hard nonlinearities",
2016): a pump fills an upper tank, which drains into a lower one; both may overflow. Every 4 s it has the pump's
voltage and the reading of the lower tank's sensor, which ends at 10 V. One half is to be fitted (uEst, yEst), the other
to be predicted (uVal, yVal). The initial levels are unknown.

It is the four-tank process with pump 2 only, gamma 2 = 0, tanks 3 and 1, and sensor 1. Nothing is known of the
geometry, so levels are counted in volts of the sensor (1 V/cm), and both areas are those of the shipped rig: only the
ratio of an outlet or a gain to the area counts.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import inf, nan, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.parameters import Choice, RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.robust_fit import RobustFit, fit_initial, robust_fit
from hil.core.identification.simulation import simulate
from hil.core.identification.unknowns import Unknowns, unknowns
from hil.core.tanks import TankModel

Array = NDArray[np.float64]

PERIOD_S = 4.0
CLIPPED_V = 10.0
FIRST_S = 120.0
"""The initial levels of the predicted half are fitted to its readings of the first so many seconds."""
COLUMNS = ("uEst", "yEst", "uVal", "yVal")
SPEED = sqrt(2.0 * 981.0)
AREA_CM2 = (28.0, 32.0, 28.0, 32.0)
"""Of tanks 1 to 4. The record knows tanks 1 and 3 only."""
FREE = ("k2", "a1", "a3", "dead_zone2", "curve2", "overflow3")
STRUCTURES = {"outlet of tank 1 below its zero": ("datum1",), "offset of sensor 1": ("sensor_offset1",)}
"""What is free beyond `FREE`, by name."""
HEIGHTS_CM = (9.0, 11.0, 13.0)
"""Rims of the upper tank that are tried: the engine takes heights as measured, and here nobody has."""
TOP_CM = 10.3
"""Rim of the lower tank: its sensor ends below."""
OFFSET_V = 0.5
EVERY_RESIDUAL = 1e3
"""No residual is an outlier: what is to be small is the plain RMSE."""
LIMITS = {"datum1": (0.0, 30.0), "curve2": (-0.06, 0.1)}


@dataclass(frozen=True, eq=False)
class Result:
    """A fit and its simulation error on both halves, V. height_cm : of the upper tank's rim.

    names : of what was fitted, with its values.
    """

    names: tuple[str, ...]
    values: Array
    rmse_V: float
    test_rmse_V: float
    height_cm: float


class DataError(ValueError):
    """A file that is not the record."""


def load(path: Path) -> tuple[LevelRecord, LevelRecord]:
    """Both halves. Raises DataError, OSError."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = list(csv.DictReader(file))
    try:
        u_est, y_est, u_val, y_val = (np.array([float(row[name]) for row in rows if row[name]]) for name in COLUMNS)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: wanted the columns {', '.join(COLUMNS)} with numbers: {error!r}") from None
    return record_of("fitted half", u_est, y_est), record_of("predicted half", u_val, y_val)


def record_of(name: str, voltage_V: Array, reading_V: Array) -> LevelRecord:
    """One half: pump 2 and sensor 1."""
    n = len(voltage_V)
    readings = np.full((n, 4), nan)
    readings[:, 0] = reading_V
    return LevelRecord(
        name=name,
        time_s=np.arange(0.0, n, dtype=np.float64) * np.float64(PERIOD_S),
        voltage_V=np.column_stack([np.zeros(n), voltage_V]),
        reading_V=readings,
        saturation_V=(-inf, CLIPPED_V),
        initial_cm=(nan, 0.0, nan, 0.0),
    )


def start_model(height_cm: float, offset_V: float = 0.0) -> RigModel:
    """Where a fit begins. height_cm : of the upper tank's rim. offset_V : of sensor 1."""
    datum_cm = 0.5
    outlet1 = 0.12 * AREA_CM2[0] / SPEED / sqrt(5.0 + datum_cm)
    tanks = TankModel(
        area_cm2=AREA_CM2,
        outlet_cm2=(outlet1, 0.05, 0.045 * AREA_CM2[2] / SPEED, 0.05),
        pump_gain_cm3_Vs=(1.0, 0.055 * AREA_CM2[2]),
        valve_split=(0.5, 0.0),
        level_gain_V_cm=1.0,
        height_cm=(TOP_CM - offset_V, 100.0, height_cm, 100.0),
        datum_cm=(0.0 if offset_V else datum_cm, 0.0, 0.0, 0.0),
    )
    model = RigModel(tanks=tanks, noise_V=(0.2, 0.2, 0.2, 0.2), lag_s=(0.0, 0.0), overflow_to_lower=(0.7, 0.0))
    sensors = replace(model.sensors, gain_V_cm=(1.0, 1.0, 1.0, 1.0), offset_V=(offset_V, 0.0, 0.0, 0.0))
    return replace(model, sensors=sensors, pumps=replace(model.pumps, dead_zone_V=(0.0, 0.5)))


def fitted(record: LevelRecord, start: RigModel, free: Iterable[str]) -> tuple[RigModel, Unknowns, RobustFit]:
    """The fit of these parameters from this start, all others fixed: the model, the unknowns and their values."""
    fixed = {group: Choice("fixed") for group in ("k", "gamma", "a", "lag")}
    wanted = unknowns((record,), start, {**fixed, **{name: Choice("free") for name in free}}, LIMITS)
    found = robust_fit((record,), start, wanted, outlier_sd=EVERY_RESIDUAL)
    return wanted.model(start, found.values), wanted, found


def best(estimation: LevelRecord, test: LevelRecord, structure: str) -> Result:
    """The fit of a structure whose rim has the smallest error on the fitted half."""
    offset_V = OFFSET_V if "sensor_offset1" in STRUCTURES[structure] else 0.0
    free = (*FREE, *STRUCTURES[structure])
    fits = [fitted(estimation, start_model(height_cm, offset_V), free) for height_cm in HEIGHTS_CM]
    return min((judged(*one, estimation, test) for one in fits), key=lambda result: result.rmse_V)


def simulation_error(model: RigModel, record: LevelRecord, initial_cm: tuple[float, float, float, float]) -> float:
    """Simulation error over the whole record."""
    residual = simulate(model, record, initial_cm).residuals[:, 0]
    return float(np.sqrt(np.mean(residual**2)))


def judged(model: RigModel, wanted: Unknowns, found: RobustFit, estimation: LevelRecord, test: LevelRecord) -> Result:
    """The errors on both halves."""
    first = fit_initial(model, test, FIRST_S)
    return Result(
        wanted.names,
        found.values,
        simulation_error(model, estimation, wanted.initial(0, found.values)),
        simulation_error(model, test, first),
        model.tanks.height_cm[2],
    )
