"""Every kind of fault by name."""

from firmware_sim.faults.base import FaultTable, kind_of
from firmware_sim.faults.pump import PUMP_KINDS
from firmware_sim.faults.sensor import SENSOR_KINDS
from firmware_sim.faults.tank import TANK_KINDS

KINDS: dict[str, type[FaultTable]] = {kind_of(table): table for table in (*PUMP_KINDS, *TANK_KINDS, *SENSOR_KINDS)}
