"""The CAN bus of a run or a check: what its user names, and the rig file's for the rest."""

from __future__ import annotations

from hil.edge.can.bus import BusAddress
from hil.edge.config.rig_file import Rig


def chosen_bus(rig: Rig, interface: str | None, channel: str | None, bitrate: int | None) -> BusAddress:
    """The address; None (and "", and 0): as the rig file has it. Raises BusError for an unknown interface."""
    bus = rig.bus
    return BusAddress(interface or bus.interface, channel or bus.channel, bitrate or bus.bitrate)
