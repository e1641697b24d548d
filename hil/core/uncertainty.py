"""How far the rig may be off its file: one standard deviation of each kind of parameter, relative to its value."""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.types import Pair, Quad


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """What the filter of the diagnosis believes before the first reading, as `[uncertainty]` of the rig file has it.

    pump_gain, valve_split, lag : (2,) by pump. outlet : (4,) by tank.
    """

    pump_gain: Pair
    valve_split: Pair
    outlet: Quad
    lag: Pair
