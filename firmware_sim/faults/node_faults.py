"""Faults of the two nodes. Target: "pump" or "level"."""

from typing import Annotated, Literal

from firmware_sim.faults.base import MAX_S, FailureWord, FaultTable
from firmware_sim.faults.effects import NS_PER_S, Effects
from firmware_sim.faults.episode import Episode
from firmware_sim.frames import (
    COMMAND_ID,
    LEVEL_HEARTBEAT_ID,
    LOWER_LEVELS_ID,
    PUMP_HEARTBEAT_ID,
    STATUS_ID,
    UPPER_LEVELS_ID,
)
from firmware_sim.setting_types import named, within

HEARTBEATS = {"pump": PUMP_HEARTBEAT_ID, "level": LEVEL_HEARTBEAT_ID}
TRAFFIC = {
    "pump": {STATUS_ID, PUMP_HEARTBEAT_ID, COMMAND_ID},
    "level": {LOWER_LEVELS_ID, UPPER_LEVELS_ID, LEVEL_HEARTBEAT_ID},
}

NodeName = Annotated[str, named("pump", "level")]


class NodeReboot(FaultTable):
    """A node loses its state and boots, at 0 V, with the next BootCount.

    With `until_s` it has no power, and sends nothing, until then; with `period_s` it loses its power in every period.
    """

    acts_on = "node"
    words = (FailureWord("node", "reboot"),)

    kind: Literal["node_reboot"]
    target: NodeName

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Take the node's power away and give it back."""
        effects.reboots[self.target] = episode.begin_ns, episode.gone_ns or episode.begin_ns
        if episode.gone_ns is not None:
            effects.muted |= TRAFFIC[self.target]


class NodeSilent(FaultTable):
    """The node is cut off: no frame comes from it, and the pump node receives no command, so its watchdog trips."""

    acts_on = "node"
    words = (FailureWord("node", "off"),)

    kind: Literal["node_silent"]
    target: NodeName

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Cut the node off."""
        del episode
        effects.muted |= TRAFFIC[self.target]


class HeartbeatStop(FaultTable):
    """A node sends no heartbeats; all its other frames continue."""

    acts_on = "node"
    words = (FailureWord("node", "no_heartbeat"),)

    kind: Literal["heartbeat_stop"]
    target: NodeName

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Stop the heartbeats."""
        del episode
        effects.muted.add(HEARTBEATS[self.target])


class ClockJump(FaultTable):
    """The node's wall clock is `value` s ahead. Only `wall_s` in the change record (`--record`) shows it."""

    acts_on = "node"
    unit = "s"
    grows_from = "0"
    words = (FailureWord("node", "clock"),)

    kind: Literal["clock_jump"]
    target: NodeName
    value: Annotated[float, within(-MAX_S, MAX_S)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the node's wall clock."""
        effects.wall_ahead_ns[self.target] = round(episode.grown(0.0, self.value) * NS_PER_S)
