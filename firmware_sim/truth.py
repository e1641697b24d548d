"""The true state of the rig, for tests and for the record of a lockstep run."""

from dataclasses import dataclass

from firmware_sim.frames import NodeState
from firmware_sim.level_node import Quad


@dataclass(frozen=True, slots=True)
class Truth:
    """The true state of the rig now. scenario_s is None until the scenario starts.

    effectiveness : share of the flow of a pump as new, less wear and with any fault. faults : those active now, by kind
    and target.
    """

    t_s: float
    scenario_s: float | None
    levels_cm: Quad
    applied_V: tuple[float, float]
    effectiveness: tuple[float, float]
    spilled_cm3: float
    pump_state: NodeState
    faults: tuple[str, ...] = ()
