"""The table of designs: the names that `[control] design` in a scenario accepts. A new built-in design is a row here.

A maker gets the rig file's settings and returns a `GainDesign`; it raises `DesignError` when the rig can't have it.
Installed packages add rows by entry points of the group `fourtank_hil.designs`.
"""

from __future__ import annotations

from collections.abc import Callable

from hil.bench.choice_table import ChoiceTable, TableChoice
from hil.core.eigenstructure import DesignError
from hil.core.gain_design import CalibratedDesign, GainDesign
from hil.core.nonminimum_phase import choose_any_split_design
from hil.core.tanks import equilibrium, linearise
from hil.edge.config.rig_file import Rig

DesignMaker = Callable[[Rig], GainDesign]


def rig_design(rig: Rig) -> GainDesign:
    """The design for this rig's valves within `control.noise_gain_max`.

    Raises DesignError when that can't be met, or near gamma1 + gamma2 = 1.
    """
    model = rig.tank_model
    at = linearise(model, equilibrium(model, rig.operating_drives))
    try:
        return choose_any_split_design(at, rig.control.output_poles, rig.control.noise_gain_max)
    except DesignError as error:
        total = sum(model.valve_split)
        raise DesignError(
            f"{error} (pumps.valve_split adds up to {total:.3f}, {abs(total - 1.0):.3f} from 1)"
        ) from None


def calibrated_design(rig: Rig) -> GainDesign:  # noqa: ARG001 - the paper's gain is the same on every rig
    """The paper's gain, made for the paper's rig."""
    return CalibratedDesign()


DESIGNS: ChoiceTable[DesignMaker] = ChoiceTable(
    "control.design",
    "fourtank_hil.designs",
    TableChoice(
        "rig",
        "for this rig: eigenstructure assignment with decoupled outputs, or linear-quadratic if gamma1 + gamma2 < 1",
        rig_design,
    ),
    TableChoice("calibrated", "the paper's gain; for comparison, on the paper's rig only", calibrated_design),
)
