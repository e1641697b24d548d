"""Every kind of fault by name."""

from firmware_sim.faults.base import FaultTable, kind_of
from firmware_sim.faults.bus import BUS_KINDS
from firmware_sim.faults.frame import FRAME_KINDS
from firmware_sim.faults.node import NODE_KINDS
from firmware_sim.faults.pump import PUMP_KINDS
from firmware_sim.faults.sensor import SENSOR_KINDS
from firmware_sim.faults.tank import TANK_KINDS

FAMILIES = (PUMP_KINDS, TANK_KINDS, SENSOR_KINDS, FRAME_KINDS, BUS_KINDS, NODE_KINDS)
KINDS: dict[str, type[FaultTable]] = {kind_of(table): table for family in FAMILIES for table in family}
