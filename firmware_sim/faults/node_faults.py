"""Faults of the two nodes. Target: "pump" or "level"."""

from typing import Annotated, Literal

from firmware_sim.faults.base import LONGEST_S, FaultTable
from firmware_sim.faults.effects import NS_PER_S, Effects, Episode
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
    """A node forgets everything and boots, at 0 V, with the next BootCount; until_s is when its power comes back."""

    kind: Literal["node_reboot"]
    target: NodeName

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Take the node's power away and give it back."""
        effects.reboots[self.target] = episode.begin_ns, episode.end_ns or episode.begin_ns
        if episode.end_ns is not None:
            effects.muted |= TRAFFIC[self.target]


class NodeSilent(FaultTable):
    """A node's line is cut: nothing comes from it, and the pump node hears no command."""

    kind: Literal["node_silent"]
    target: NodeName

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Cut the node off."""
        del episode
        effects.muted |= TRAFFIC[self.target]


class HeartbeatStop(FaultTable):
    """A node sends no heartbeats; everything else goes on."""

    kind: Literal["heartbeat_stop"]
    target: NodeName

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Stop the heartbeats."""
        del episode
        effects.muted.add(HEARTBEATS[self.target])


class ClockJump(FaultTable):
    """The node's wall clock is `value` s off. Nothing but the wall time in the change record may show it."""

    kind: Literal["clock_jump"]
    target: NodeName
    value: Annotated[float, within(-LONGEST_S, LONGEST_S)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the node's wall clock."""
        del episode
        effects.wall_ahead_ns[self.target] = round(self.value * NS_PER_S)


NODE_KINDS: tuple[type[FaultTable], ...] = (NodeReboot, NodeSilent, HeartbeatStop, ClockJump)
