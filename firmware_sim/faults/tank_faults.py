"""Faults of the tanks. Target: tank 1, 2 (lower), 3, 4 (upper)."""

from typing import Annotated, Literal

from firmware_sim.faults.base import FaultTable, Share, TankNumber
from firmware_sim.faults.effects import Effects, Episode
from firmware_sim.setting_types import within


class Leak(FaultTable):
    """A hole in the bottom, `value` times as large as the tank's outlet, through which water leaves the rig."""

    kind: Literal["leak"]
    target: TankNumber
    value: Annotated[float, within(0.0, 10.0)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the hole of the target tank."""
        del episode
        effects.leak[self.target - 1] = self.value


class OutletBlock(FaultTable):
    """A share of the outlet's area is blocked (1: nothing gets through)."""

    kind: Literal["outlet_block"]
    target: TankNumber
    value: Share

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the blocked share of the target tank."""
        del episode
        effects.blocked[self.target - 1] = self.value


TANK_KINDS: tuple[type[FaultTable], ...] = (Leak, OutletBlock)
