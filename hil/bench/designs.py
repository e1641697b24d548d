"""The table of designs: the names that `[control] design` in a scenario accepts. A new built-in design is a row here.

A maker gets the rig file's settings and returns a `GainDesign`; it raises `DesignError` when the rig can't have it.
Installed packages add rows by entry points of the group `fourtank_hil.designs`.
"""

from __future__ import annotations

from collections.abc import Callable

from hil.bench.choice_table import ChoiceTable, TableChoice
from hil.core.gain_design import CalibratedDesign, GainDesign, choose_rig_design
from hil.core.tanks import equilibrium, linearise
from hil.edge.config.rig_file import Rig

DesignMaker = Callable[[Rig], GainDesign]


def rig_design(rig: Rig) -> GainDesign:
    """Decoupled outputs within `control.noise_gain_max`. Raises DesignError when the rig's poles can't meet it."""
    model = rig.tank_model
    at = linearise(model, equilibrium(model, rig.operating_drives))
    return choose_rig_design(at, rig.control.output_poles, rig.control.noise_gain_max)


def calibrated_design(rig: Rig) -> GainDesign:  # noqa: ARG001 - the paper's gain is the same on every rig
    """The paper's gain, made for the paper's rig."""
    return CalibratedDesign()


DESIGNS: ChoiceTable[DesignMaker] = ChoiceTable(
    "control.design",
    "fourtank_hil.designs",
    TableChoice("rig", "eigenstructure assignment with decoupled outputs, for this rig", rig_design),
    TableChoice("calibrated", "the paper's gain; for comparison, on the paper's rig only", calibrated_design),
)
