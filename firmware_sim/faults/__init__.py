"""Faults of the emulated rig: what can go wrong, from when on and until when.

A kind of fault is one frozen table with an `apply` method that writes into `Effects`; plant and nodes read
`Effects` and do not know the schedule. `catalogue.KINDS` has every kind by name.
"""

from firmware_sim.faults.base import Fault, FaultTable
from firmware_sim.faults.effects import NS_PER_S, Effects
from firmware_sim.faults.pump_faults import PumpEffectiveness
from firmware_sim.faults.schedule import FaultSchedule

__all__ = ["NS_PER_S", "Effects", "Fault", "FaultSchedule", "FaultTable", "PumpEffectiveness"]
