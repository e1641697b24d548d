"""The kinds of faults that a scenario may have, by name, and what each acts on.

One table: the check of `[[fault]]` tables and its message, the reference of the settings, and the judgement of alarms
follow from it. The emulator has its own, with the numbers that each kind takes; a test holds the two together.
"""

from __future__ import annotations

from enum import StrEnum


class FaultKind(StrEnum):
    """A kind of fault; its value is the name in a scenario, and `acts_on` says in which part of the rig it lies."""

    acts_on: str

    def __new__(cls, name: str, acts_on: str = "") -> FaultKind:
        """A member with its name in the scenario and what it acts on."""
        kind = str.__new__(cls, name)
        kind._value_ = name
        kind.acts_on = acts_on
        return kind

    PUMP_EFFECTIVENESS = "pump_effectiveness", "pump"
    PUMP_DEAD = "pump_dead", "pump"
    PUMP_STUCK_ON = "pump_stuck_on", "pump"
    PUMP_LAG = "pump_lag", "pump"
    VALVE_SPLIT = "valve_split", "valve"
    RESERVOIR_LOW = "reservoir_low", "reservoir"
    LEAK = "leak", "tank"
    OUTLET_BLOCK = "outlet_block", "tank"
    SENSOR_BIAS = "sensor_bias", "sensor"
    SENSOR_DRIFT = "sensor_drift", "sensor"
    SENSOR_NOISE = "sensor_noise", "sensor"
    SENSOR_STUCK = "sensor_stuck", "sensor"
    SENSOR_OPEN = "sensor_open", "sensor"
    SENSOR_GARBAGE = "sensor_garbage", "sensor"
    FRAME_LOSS = "frame_loss", "frame"
    FRAME_BURST = "frame_burst", "frame"
    FRAME_DELAY = "frame_delay", "frame"
    FRAME_DUPLICATE = "frame_duplicate", "frame"
    FRAME_REORDER = "frame_reorder", "frame"
    FRAME_CORRUPT = "frame_corrupt", "frame"
    COUNTER_STUCK = "counter_stuck", "frame"
    WRONG_LENGTH = "wrong_length", "frame"
    WRONG_ID = "wrong_id", "frame"
    EXTENDED_ID = "extended_id", "frame"
    REMOTE_FRAME = "remote_frame", "frame"
    BABBLE = "babble", "bus"
    FOREIGN_COMMAND = "foreign_command", "bus"
    ERROR_FRAMES = "error_frames", "bus"
    BUS_OFF = "bus_off", "bus"
    NODE_REBOOT = "node_reboot", "node"
    NODE_SILENT = "node_silent", "node"
    HEARTBEAT_STOP = "heartbeat_stop", "node"
    CLOCK_JUMP = "clock_jump", "node"

    @property
    def is_of_the_process(self) -> bool:
        """Whether a diagnosis of the process can find it; the others are found by the checks of frames and nodes."""
        return self.acts_on in ("pump", "valve", "reservoir", "tank", "sensor")


def fault_kind(name: str) -> FaultKind | None:
    """The kind of that name; None when there is none, as in the record of a later version."""
    return FaultKind(name) if name in set(FaultKind) else None
