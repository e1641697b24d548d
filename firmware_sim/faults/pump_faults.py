"""Faults of the pumps, their valves and the reservoir. Target: pump 1 or 2."""

from typing import Annotated, Literal

from firmware_sim.faults.base import FailureWord, FaultTable, PumpNumber, Share, Volt
from firmware_sim.faults.effects import Change, Effects
from firmware_sim.faults.episode import Episode
from firmware_sim.setting_types import one_of, within


class PumpEffectiveness(FaultTable):
    """A pump gives only a share of the flow that its voltage should give (1: healthy, 0: dead)."""

    acts_on = "pump"
    unit = "share of the flow"
    grows_from = "1"
    words = (FailureWord("pump", "wrong"),)

    kind: Literal["pump_effectiveness"]
    target: PumpNumber
    value: Share

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the share of the target pump."""
        effects.effectiveness[self.target - 1] = episode.grown(1.0, self.value)


class PumpDead(FaultTable):
    """A pump gives no flow."""

    acts_on = "pump"
    words = (FailureWord("pump", "off"),)

    kind: Literal["pump_dead"]
    target: PumpNumber

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the share of the target pump to zero."""
        del episode
        effects.effectiveness[self.target - 1] = 0.0


class PumpStuckOn(FaultTable):
    """A pump gets `value` V whatever its node puts out, as with welded relay contacts.

    The node reports its own output.
    """

    acts_on = "pump"
    unit = "V"
    words = (FailureWord("pump", "stuck"),)

    kind: Literal["pump_stuck_on"]
    target: PumpNumber
    value: Volt

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the voltage of the target pump."""
        del episode
        effects.stuck_on_V[self.target - 1] = self.value


class PumpLag(FaultTable):
    """A pump's flow follows its voltage with a first-order lag of `value` s."""

    acts_on = "pump"
    unit = "s"
    grows_from = "the pump's own lag"
    words = (FailureWord("pump", "slow"),)

    kind: Literal["pump_lag"]
    target: PumpNumber
    value: Annotated[float, within(0.0, 60.0)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the lag of the target pump."""
        effects.lag_s[self.target - 1] = Change(self.value, episode.share)


class ValveSplit(FaultTable):
    """The valve behind a pump sends the share `value` (the new γ) of the pump's flow to the lower tank."""

    acts_on = "valve of pump"
    unit = "share of the flow"
    grows_from = "the valve's own share"
    words = (FailureWord("valve", "wrong"),)

    kind: Literal["valve_split"]
    target: PumpNumber
    value: Share

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set gamma of the target pump."""
        effects.valve_split[self.target - 1] = Change(self.value, episode.share)


class ReservoirLow(FaultTable):
    """The reservoir is dry: both pumps draw air."""

    acts_on = "reservoir"
    words = (FailureWord("reservoir", "off"),)

    kind: Literal["reservoir_low"]
    target: Annotated[int, one_of(0)] = 0

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Take the water away."""
        del episode
        effects.is_dry = True
