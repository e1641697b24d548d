"""An identification as a fit would return it, made by hand: a rig whose pump 1 gives 8 % less than its file says."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.parameters import PARAMETERS, RigModel
from hil.core.identification.result import FittedParameter, Identification, NullDirection, Prediction, Status
from hil.core.pumps import PumpPath
from hil.core.tanks import TankModel, equilibrium, level_rates
from hil.core.types import Pair, Quad

TRUE = RigModel(
    tanks=replace(
        TankModel(),
        pump_gain_cm3_Vs=(3.057, 3.41),
        valve_split=(0.71, 0.592),
        outlet_cm2=(0.0705, 0.0581, 0.0722, 0.0561),
    ),
    pumps=PumpPath(dead_zone_V=(0.31, 0.0)),
    lag_s=(0.31, 0.22),
)
OLD = RigModel()
SD = {"k": 3e-4, "gamma": 4e-5, "a": 8e-6, "lag": 5e-3, "dead_zone": 2e-3}


def identification(**changes: Any) -> Identification:
    """changes : fields of the `Identification` that differ."""
    training, held_out = prediction(TRUE, "basic", seed=1), prediction(TRUE, "check", seed=2, is_held_out=True)
    before = replace(prediction(OLD, "check", seed=2, is_held_out=True), reading_V=held_out.reading_V)
    values: dict[str, Any] = {
        "model": TRUE,
        "parameters": fitted(TRUE),
        "null_directions": (),
        "structure": ("dead_zone",),
        "predictions": (training, held_out),
        "holdout_rmse_V": _rmse(held_out),
        "holdout_rmse_before_V": _rmse(before),
        "predictions_before": (before,),
    }
    return Identification(**{**values, **changes})


def fitted(model: RigModel, status: Status = "identified") -> tuple[FittedParameter, ...]:
    """Every parameter; those of BASIC and the dead zones are free."""
    before = _numbers(OLD)
    rows = []
    for row, value in _numbers(model).items():
        parameter = next(one for one in PARAMETERS if one.name == row)
        sd = SD.get(parameter.group, 0.0)
        rows.append(
            FittedParameter(
                row,
                value,
                value - 1.96 * sd,
                value + 1.96 * sd,
                parameter.unit,
                before[row],
                status if sd else "fixed",
            )
        )
    return tuple(rows)


def without_records(**changes: Any) -> Identification:
    """The same without its records, so that no time is spent on their figures."""
    return replace(identification(**changes), predictions=(), predictions_before=())


def with_value(found: Identification, name: str, **changes: Any) -> Identification:
    """The identification with one parameter's fields replaced."""
    parameters = tuple(replace(one, **changes) if one.name == name else one for one in found.parameters)
    return replace(found, parameters=parameters)


def undetermined() -> Identification:
    """Pump gains and sensor gains free, and no ruler."""
    names = ("k1", "k2", "sensor_gain1", "sensor_gain2")
    text = "k1, k2 and the gains of all sensors can only be known together: read the level of tank 1 by a ruler"
    found = identification(null_directions=(NullDirection(names, (0.5, 0.5, -0.5, -0.5), text),))
    for name in names:
        found = with_value(found, name, status="not identifiable", low=-np.inf, high=np.inf)
    return found


@cache
def prediction(model: RigModel, name: str, *, seed: int, is_held_out: bool = False) -> Prediction:
    """120 s of steps at 10 Hz, with 5 mV of noise on what the true rig reads."""
    time_s = np.arange(0.0, 120.0, 0.1)
    voltage_V = np.full((len(time_s), 2), 3.0)
    voltage_V[300:, 0], voltage_V[700:, 1] = 3.6, 2.5
    level_cm = _levels(model, voltage_V)
    predicted_V = 0.5 * level_cm
    noise_V = np.random.default_rng(seed).normal(0.0, 0.005, predicted_V.shape)
    return Prediction(name, is_held_out, time_s, voltage_V, predicted_V + noise_V, predicted_V, level_cm)


def _levels(model: RigModel, voltage_V: NDArray[np.float64]) -> NDArray[np.float64]:
    level: Quad = equilibrium(model.tanks, model.pumps.drive((3.0, 3.0)))
    levels = []
    for v1, v2 in voltage_V.tolist():
        levels.append(level)
        rates = level_rates(model.tanks, level, model.pumps.drive((v1, v2)))
        h1, h2, h3, h4 = (h + 0.1 * rate for h, rate in zip(level, rates, strict=True))
        level = (h1, h2, h3, h4)
    return np.array(levels)


def _rmse(one: Prediction) -> Quad:
    r1, r2, r3, r4 = np.sqrt(np.mean(one.residuals**2, axis=0)).tolist()
    return r1, r2, r3, r4


def _numbers(model: RigModel) -> dict[str, float]:
    pumps, sensors = model.pumps, model.sensors
    groups: dict[str, Pair | Quad] = {
        "k": model.tanks.pump_gain_cm3_Vs,
        "gamma": model.tanks.valve_split,
        "a": model.tanks.outlet_cm2,
        "lag": model.lag_s,
        "dead_zone": pumps.dead_zone_V,
        "curve": pumps.curve_1_V,
        "delay": pumps.delay_s,
        "datum": model.tanks.datum_cm,
        "sensor_gain": sensors.gain_V_cm,
        "sensor_offset": sensors.offset_V,
        "overflow": model.overflow_to_lower,
    }
    numbers = [number for group in groups.values() for number in group]
    return {row.name: number for row, number in zip(PARAMETERS, numbers, strict=True)}
