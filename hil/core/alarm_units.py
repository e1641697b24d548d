"""Alarms in the units of the bench: volts of the sensor and of the pump that an alarm is about.

A detector works with level signals and drives. What people and the record get to see, and what a scenario's `value` is
compared with, are readings and pump voltages, the latter never outside their range.
"""

from __future__ import annotations

from dataclasses import replace

from hil.core.pumps import PumpPath
from hil.core.sensors import LevelSensors
from hil.core.types import Alarm, Quad

DIFFERENCES = ("sensor_bias", "sensor_drift")
STANDARD_DEVIATIONS = ("sensor_noise",)
READINGS = ("sensor_stuck", "sensor_open", "sensor_garbage")
STUCK_ON = "pump_stuck_on"


def in_bench_units(alarms: tuple[Alarm, ...], sensors: LevelSensors, pumps: PumpPath) -> tuple[Alarm, ...]:
    """The alarms of a detector, as they are reported."""
    if not alarms or (sensors.is_plain and pumps.is_straight):
        return alarms
    return tuple(_converted(alarm, sensors, pumps) for alarm in alarms)


def _converted(alarm: Alarm, sensors: LevelSensors, pumps: PumpPath) -> Alarm:
    place = alarm.target - 1
    if alarm.kind == STUCK_ON:
        slope = pumps.slope(place, alarm.size)
        return replace(alarm, size=pumps.within_range(place, alarm.size), size_std=alarm.size_std * slope)
    if alarm.kind in READINGS:
        y: Quad = (alarm.size, alarm.size, alarm.size, alarm.size)
        return replace(alarm, size=sensors.readings(y)[place])
    if alarm.kind in DIFFERENCES or alarm.kind in STANDARD_DEVIATIONS:
        factor = sensors.factor[place]
        size = alarm.size / (factor if alarm.kind in DIFFERENCES else abs(factor))
        return replace(alarm, size=size, size_std=alarm.size_std / abs(factor))
    return alarm
