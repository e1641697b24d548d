"""The variables of the unit: inputs, parameters and outputs, with units, ranges and start values.

Names are those of the columns in a run's `ticks.csv` where there is one. Ranges come from the checks of the settings
and of the fault kinds, start values from the settings of the rig.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import get_args

from firmware_sim.faults.base import FaultTable
from firmware_sim.faults.pump_faults import PumpEffectiveness, PumpLag, ValveSplit
from firmware_sim.faults.sensor_faults import SensorBias
from firmware_sim.faults.tank_faults import Leak, OutletBlock
from firmware_sim.setting_types import Accepts, Table, accepts, parts
from firmware_sim.settings import EmulatorSettings, PumpSettings, SensorSettings, TankSettings, equilibrium_cm

PUMPS, TANKS = (1, 2), (1, 2, 3, 4)
MAX_V = 10.0


class Causality(Enum):
    """What the other side does with a variable."""

    INPUT = "input"
    PARAMETER = "parameter"
    OUTPUT = "output"


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable. unit : "1" for a share. start, low, high : None for an output."""

    name: str
    causality: Causality
    unit: str
    description: str
    start: float | None = None
    low: float | None = None
    high: float | None = None


INPUT_OF_KIND = {
    "pump_effectiveness": "effectivenessN",
    "pump_dead": "effectivenessN at 0",
    "pump_stuck_on": "vN_applied_V at the voltage of the stuck pump",
    "pump_lag": "lagN_s",
    "valve_split": "splitN",
    "reservoir_low": "effectiveness1 and effectiveness2 at 0",
    "leak": "leakN",
    "outlet_block": "blockedN",
    "sensor_bias": "biasN_V",
    "sensor_drift": "biasN_V with a ramp",
    "sensor_noise": "biasN_V with a noise signal",
    "sensor_stuck": "",
    "sensor_open": "",
    "sensor_garbage": "",
}
"""Kind of fault -> the input that plays it, N for the target; "" where the other side replaces hN_V."""


def variables(settings: EmulatorSettings) -> tuple[Variable, ...]:
    """All variables, inputs first, then parameters, then outputs."""
    return (*_inputs(settings), *_parameters(settings), *_outputs())


def _inputs(settings: EmulatorSettings) -> Iterator[Variable]:
    pumps, own = settings.pumps, Causality.INPUT
    for n in PUMPS:
        yield Variable(f"v{n}_applied_V", own, "V", f"voltage at pump {n}", 0.0, 0.0, MAX_V)
    for n in PUMPS:
        yield _fault(PumpEffectiveness, f"effectiveness{n}", "1", f"share of its flow that pump {n} gives", 1.0)
    for n, lag_s in zip(PUMPS, parts(pumps.lag_s, 2), strict=True):
        yield _fault(PumpLag, f"lag{n}_s", "s", f"time constant of the lag from voltage to flow of pump {n}", lag_s)
    for n, split in zip(PUMPS, pumps.valve_split, strict=True):
        what = f"gamma: share of the flow of pump {n} that goes to its lower tank"
        yield _fault(ValveSplit, f"split{n}", "1", what, split)
    for n in TANKS:
        yield _fault(Leak, f"leak{n}", "1", f"area of a hole in tank {n} as a share of its outlet's", 0.0)
    for n in TANKS:
        yield _fault(OutletBlock, f"blocked{n}", "1", f"share of the outlet of tank {n} that is blocked", 0.0)
    for n in TANKS:
        yield _fault(SensorBias, f"bias{n}_V", "V", f"added to the level signal of tank {n}", 0.0)
    for n, error in zip(TANKS, parts(settings.sensors.scale_error, 4), strict=True):
        what = f"error of the gain of level sensor {n}, as a share of it"
        yield _setting(own, SensorSettings, "scale_error", f"scale_error{n}", "1", what, error)


def _parameters(settings: EmulatorSettings) -> Iterator[Variable]:
    tanks, pumps, sensors = settings.tanks, settings.pumps, settings.sensors
    rows: tuple[tuple[type[Table], str, str, str, str, tuple[float, ...]], ...] = (
        (TankSettings, "area_cm2", "area{}_cm2", "cm2", "cross-section of tank {}", tanks.area_cm2),
        (TankSettings, "outlet_cm2", "outlet{}_cm2", "cm2", "cross-section of the outlet of tank {}", tanks.outlet_cm2),
        (TankSettings, "height_cm", "height{}_cm", "cm", "height of the rim of tank {}", parts(tanks.height_cm, 4)),
        (TankSettings, "datum_cm", "datum{}_cm", "cm", "depth of the outlet of tank {} below its zero",
         parts(tanks.datum_cm, 4)),
        (TankSettings, "overflow_to_lower", "overflow_to_lower{}", "1",
         "share of the overflow of the upper tank that falls into tank {}", parts(tanks.overflow_to_lower, 2)),
        (TankSettings, "gravity_cm_s2", "gravity_cm_s2", "cm/s2", "acceleration of gravity", (tanks.gravity_cm_s2,)),
        (PumpSettings, "gain_cm3_Vs", "gain{}_cm3_Vs", "cm3/(V.s)", "flow of pump {} for 1 V", pumps.gain_cm3_Vs),
        (PumpSettings, "dead_zone_V", "dead_zone{}_V", "V", "voltage below which pump {} gives no flow",
         parts(pumps.dead_zone_V, 2)),
        (PumpSettings, "curve_1_V", "curve{}_1_V", "1/V", "bend of the curve of pump {}", parts(pumps.curve_1_V, 2)),
        (PumpSettings, "delay_s", "delay{}_s", "s", "transport delay from pump {} to the tanks",
         parts(pumps.delay_s, 2)),
        (PumpSettings, "wear_per_h", "wear{}_1_h", "1/h", "share of its first gain that pump {} loses in an hour",
         parts(pumps.wear_per_h, 2)),
        (SensorSettings, "gain_V_cm", "sensor_gain{}_V_cm", "V/cm", "level signal of tank {} for 1 cm",
         parts(sensors.gain_V_cm, 4)),
        (SensorSettings, "offset_V", "sensor_offset{}_V", "V", "level signal of tank {} at its zero",
         parts(sensors.offset_V, 4)),
        (TankSettings, "height_cm", "start{}_cm", "cm", "level of tank {} at the start", equilibrium_cm(settings)),
    )  # fmt: skip
    for table, key, name, unit, what, values in rows:
        for n, value in enumerate(values, start=1):
            yield _setting(Causality.PARAMETER, table, key, name.format(n), unit, what.format(n), value)


def _outputs() -> Iterator[Variable]:
    own = Causality.OUTPUT
    for n in TANKS:
        yield Variable(f"true_h{n}_cm", own, "cm", f"level of tank {n}")
    for n in TANKS:
        yield Variable(f"h{n}_V", own, "V", f"level signal of tank {n}, before the converter, without noise")
    for n in PUMPS:
        yield Variable(f"flow{n}_cm3_s", own, "cm3/s", f"flow of pump {n} that arrives at its valve")
    for n in PUMPS:
        what = f"flow out of tank {n} and through leaks of it and of the tank above it"
        yield Variable(f"drain{n}_cm3_s", own, "cm3/s", what)
    for name, what in (
        ("pumped_cm3", "volume that both pumps have moved"),
        ("drained_cm3", "volume that has left through the lower outlets and through leaks"),
        ("spilled_cm3", "volume that has gone over a rim"),
        ("caught_cm3", "part of the spilled volume that fell into a tank"),
    ):
        yield Variable(name, own, "cm3", what)


def _fault(kind: type[FaultTable], name: str, unit: str, description: str, start: float) -> Variable:
    low, high = _range(kind, "value")
    return _within(Variable(name, Causality.INPUT, unit, description, start, low, high))


def _setting(
    causality: Causality, table: type[Table], key: str, name: str, unit: str, description: str, start: float
) -> Variable:
    low, high = _range(table, key)
    if key == "gain_V_cm":
        low = -high  # the setting's range is that of the magnitude
    if name.startswith("start"):
        low = 0.0
    return _within(Variable(name, causality, unit, description, start, low, high))


def _within(one: Variable) -> Variable:
    """The variable with a range that has its start value: a drawn one may lie a little outside the settings' range."""
    start, low, high = one.start or 0.0, one.low or 0.0, one.high or 0.0
    return replace(one, low=min(low, start), high=max(high, start))


def _range(table: type[Table], key: str) -> tuple[float, float]:
    field = table.model_fields[key]
    checks = [accepts(field), *(one for part in get_args(field.annotation) for one in get_args(part)[1:])]
    for check in checks:
        if isinstance(check, Accepts) and check.numbers is not None:
            return check.numbers
    raise LookupError(f"{table.__name__}.{key} has no range")
