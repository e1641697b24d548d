"""The parameters that can be identified: one row of a table each.

The model is that of `hil.core.tanks`, `hil.core.pumps` and `hil.core.sensors`. Beyond what a rig file can say it knows
the share of an upper tank's overflow that falls into the tank below.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from hil.core.pumps import PumpPath
from hil.core.sensors import LevelSensors
from hil.core.tanks import TankModel
from hil.core.types import Pair, Quad


@dataclass(frozen=True)
class RigModel:
    """All that is needed to predict readings from voltages.

    lag_s : (2,) of the pumps. noise_V : (4,) standard deviation of one reading. overflow_to_lower : (2,) share of the
    overflow of tanks 3, 4 that falls into tanks 1, 2.
    """

    tanks: TankModel = field(default_factory=TankModel)
    pumps: PumpPath = field(default_factory=PumpPath)
    sensors: LevelSensors = field(default_factory=LevelSensors)
    lag_s: Pair = (0.2, 0.2)
    noise_V: Quad = (0.005, 0.005, 0.005, 0.005)
    overflow_to_lower: Pair = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A row. name : k1, gamma2, a3 and so on. group : what is chosen together. index : of the pump (0, 1) or tank.

    key : where the rig file has it; "" where it can't say it.
    """

    name: str
    unit: str
    group: str
    index: int
    key: str
    meaning: str


def _rows(group: str, count: int, unit: str, key: str, meaning: str, first: int = 1) -> tuple[Parameter, ...]:
    what = "pump" if count == 2 and first == 1 else "tank"
    return tuple(
        Parameter(
            f"{group}{first + i}",
            unit,
            group,
            i if first == 1 else first - 1 + i,
            key,
            meaning.format(f"{what} {first + i}"),
        )
        for i in range(count)
    )


PARAMETERS: tuple[Parameter, ...] = (
    *_rows("k", 2, "cm3/Vs", "pumps.gain_cm3_Vs", "flow of {} for 1 V"),
    *_rows("gamma", 2, "1", "pumps.valve_split", "share of the flow of {} that goes to its lower tank"),
    *_rows("a", 4, "cm2", "tanks.outlet_cm2", "cross-section of the outlet of {}"),
    *_rows("lag", 2, "s", "pumps.lag_s", "time constant of {}"),
    *_rows("dead_zone", 2, "V", "pumps.dead_zone_V", "voltage below which {} gives no flow"),
    *_rows("curve", 2, "1/V", "pumps.curve_1_V", "bend of the curve of {}"),
    *_rows("delay", 2, "s", "pumps.delay_s", "time until the flow of {} arrives"),
    *_rows("datum", 4, "cm", "tanks.datum_cm", "how far the outlet of {} lies below the tank's zero"),
    *_rows("sensor_gain", 4, "V/cm", "sensors.gain_V_cm", "rise of the reading of {} for 1 cm"),
    *_rows("sensor_offset", 4, "V", "sensors.offset_V", "reading of {} at its zero"),
    *_rows("overflow", 2, "1", "", "share of the overflow of {} that falls into the tank below", first=3),
)
"""In the order in which reports show them."""

BY_NAME = {row.name: row for row in PARAMETERS}

BASIC = ("k", "gamma", "a", "lag")
"""The groups that are always free, unless somebody fixes one."""

EXTENSIONS = ("dead_zone", "curve", "delay", "datum", "sensor_gain", "sensor_offset", "overflow")
"""The groups that a structure may have or not."""


@dataclass(frozen=True, slots=True)
class Choice:
    """How a parameter is treated: free, fixed at its value, or with a prior around it of one standard deviation sd."""

    role: Literal["free", "fixed", "prior"] = "free"
    sd: float = 0.0


def values_of(model: RigModel) -> dict[str, float]:
    """The value of every parameter of a rig."""
    pumps, tanks, sensors = model.pumps, model.tanks, model.sensors
    numbers = (
        *tanks.pump_gain_cm3_Vs,
        *tanks.valve_split,
        *tanks.outlet_cm2,
        *model.lag_s,
        *pumps.dead_zone_V,
        *pumps.curve_1_V,
        *pumps.delay_s,
        *tanks.datum_cm,
        *sensors.gain_V_cm,
        *sensors.offset_V,
        *model.overflow_to_lower,
    )
    return {row.name: value for row, value in zip(PARAMETERS, numbers, strict=True)}


def with_values(model: RigModel, changed: Mapping[str, float]) -> RigModel:
    """A rig with these values in place of its own. Raises KeyError for an unknown name."""
    values = values_of(model)
    for name, value in changed.items():
        values[BY_NAME[name].name] = float(value)
    k1, k2, g1, g2, a1, a2, a3, a4, lag1, lag2, z1, z2, c1, c2, t1, t2, *rest = values.values()
    d1, d2, d3, d4, s1, s2, s3, s4, o1, o2, o3, o4, over3, over4 = rest
    return replace(
        model,
        tanks=replace(
            model.tanks,
            pump_gain_cm3_Vs=(k1, k2),
            valve_split=(g1, g2),
            outlet_cm2=(a1, a2, a3, a4),
            datum_cm=(d1, d2, d3, d4),
        ),
        pumps=replace(model.pumps, dead_zone_V=(z1, z2), curve_1_V=(c1, c2), delay_s=(t1, t2)),
        sensors=replace(model.sensors, gain_V_cm=(s1, s2, s3, s4), offset_V=(o1, o2, o3, o4)),
        lag_s=(lag1, lag2),
        overflow_to_lower=(over3, over4),
    )
