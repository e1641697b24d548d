"""Every kind of fault by name."""

from firmware_sim.faults.base import FaultTable, kind_of
from firmware_sim.faults.bus_faults import BUS_KINDS
from firmware_sim.faults.frame_faults import FRAME_KINDS
from firmware_sim.faults.node_faults import NODE_KINDS
from firmware_sim.faults.pump_faults import PUMP_KINDS
from firmware_sim.faults.sensor_faults import SENSOR_KINDS
from firmware_sim.faults.tank_faults import TANK_KINDS

FAMILIES = (PUMP_KINDS, TANK_KINDS, SENSOR_KINDS, FRAME_KINDS, BUS_KINDS, NODE_KINDS)
KINDS: dict[str, type[FaultTable]] = {kind_of(table): table for family in FAMILIES for table in family}
