"""Faults of the tanks. Target: tank 1, 2 (lower), 3, 4 (upper)."""

from typing import Annotated, Literal

from firmware_sim.faults.base import FailureWord, FaultTable, Share, TankNumber
from firmware_sim.faults.effects import Effects
from firmware_sim.faults.episode import Episode
from firmware_sim.setting_types import within


class Leak(FaultTable):
    """A hole in the bottom, `value` times as large as the tank's outlet, through which water leaves the rig.

    At 0.2 a further 20 % of the outflow is lost; the hole follows the same square-root law as the outlet.
    """

    acts_on = "tank"
    unit = "share of the outlet's area"
    grows_from = "0"
    words = (FailureWord("tank", "leak"),)

    kind: Literal["leak"]
    target: TankNumber
    value: Annotated[float, within(0.0, 10.0)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the hole of the target tank."""
        effects.leak[self.target - 1] = episode.grown(0.0, self.value)


class OutletBlock(FaultTable):
    """A share of the outlet's area is blocked (1: completely)."""

    acts_on = "tank"
    unit = "share of the outlet's area"
    grows_from = "0"
    words = (FailureWord("tank", "blocked"),)

    kind: Literal["outlet_block"]
    target: TankNumber
    value: Share

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the blocked share of the target tank."""
        effects.blocked[self.target - 1] = episode.grown(0.0, self.value)
