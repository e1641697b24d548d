"""What each alarm means: its priority, the time to respond, its cause, and what to do.

Priorities follow the habit of process plants (ISA-18.2, IEC 62682): by what happens if nobody responds, and how soon.
High: water, a pump or the experiment is in danger within two minutes. Medium: the run is disturbed, or over and safe.
Low: worth knowing. The tables of docs/how-to/operating.md have the same rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Priority(StrEnum):
    """Of an alarm; the most urgent first."""

    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"

    @property
    def rank(self) -> int:
        """0 for the most urgent."""
        return list(Priority).index(self)


@dataclass(frozen=True, slots=True)
class Explanation:
    """name : of a trip's cause, a kind of fault or an event code. respond_s : within which somebody should respond."""

    name: str
    priority: Priority
    respond_s: float
    cause: str
    action: str


TRIPS: tuple[Explanation, ...] = (
    Explanation(
        "stale_levels",
        Priority.MEDIUM,
        600.0,
        "no valid level frame came for too long (`safety.levels_age_max_s`)",
        "level node, cable; `hil doctor`",
    ),
    Explanation(
        "invalid_levels",
        Priority.MEDIUM,
        600.0,
        (
            "a level was out of range, or its node marked it as invalid, several readings in a row "
            "(`safety.invalid_run_max`)"
        ),
        "the sensor and its wires",
    ),
    Explanation(
        "stale_status",
        Priority.HIGH,
        120.0,
        "no valid PumpStatus came for too long (`safety.status_age_max_s`)",
        "pump node, cable",
    ),
    Explanation(
        "node_tripped",
        Priority.MEDIUM,
        600.0,
        "the pump node's watchdog has tripped",
        "computer too slow, commands lost, cable; then `--clear-trip`",
    ),
    Explanation(
        "node_rebooted",
        Priority.MEDIUM,
        600.0,
        "a node has rebooted, or is booting",
        "its supply; its firmware",
    ),
    Explanation(
        "node_lost",
        Priority.MEDIUM,
        600.0,
        "no heartbeat came from a node for too long (`safety.heartbeat_age_max_s`)",
        "the node, cable",
    ),
    Explanation(
        "wrong_contract",
        Priority.MEDIUM,
        600.0,
        "a node was built for another `bench.dbc`",
        "build its firmware again, or use its DBC",
    ),
    Explanation(
        "echo_missing",
        Priority.HIGH,
        120.0,
        "the pump node does not echo commands (`safety.echo_age_max_s`)",
        "pump node, adapter, bus load",
    ),
    Explanation(
        "foreign_command",
        Priority.HIGH,
        60.0,
        "another sender sent a pump command; the controller sends nothing more",
        "find and stop the other program",
    ),
    Explanation(
        "echo_mismatch",
        Priority.HIGH,
        60.0,
        ("the pump node applies another voltage than the one it echoed (`safety.echo_tolerance_V`, `echo_mismatch_s`)"),
        "its converter; its firmware",
    ),
    Explanation(
        "frames_refused",
        Priority.MEDIUM,
        600.0,
        (
            "several frames of one identifier in a row were refused (`safety.refused_run_max`): CRC, counter,"
            " length or range"
        ),
        "the node that sends them; `hil doctor`",
    ),
    Explanation(
        "error_storm",
        Priority.MEDIUM,
        600.0,
        "too many error frames came within a second (`safety.errors_per_s_max`)",
        "cable, termination, bit rate",
    ),
    Explanation(
        "sensors_lost",
        Priority.MEDIUM,
        600.0,
        (
            "the diagnosis has isolated two level sensors; or the sensor of a lower tank, and the model does "
            'not know its level either. With `safety.lost_lower_level = "stop"`: a stop as soon as the sensor'
            " of a lower tank is isolated"
        ),
        "compare sensors 1 to 4 with a ruler",
    ),
    Explanation(
        "high_level",
        Priority.HIGH,
        60.0,
        (
            "a tank is above `safety.level_max_cm`, or would rise to within `rim_margin_cm` of its rim. The "
            "text may name a sensor that the diagnosis does not trust: a drift and a clogging outlet look the"
            " same, so its reading still counts. As a stop: the pumps give so much more than at the start "
            "that the tank leaks, or is fuller than its sensor shows"
        ),
        "outlet, valves; let it drain. With a sensor named: compare it with a ruler first",
    ),
    Explanation(
        "dry_run",
        Priority.HIGH,
        120.0,
        (
            "pumps are driven (`safety.dry_run_V`) but no water comes: by the diagnosis, or for 10 s by the "
            "levels of the upper tanks"
        ),
        "fill the reservoir; suction hoses",
    ),
    Explanation(
        "pump_stuck_on",
        Priority.HIGH,
        30.0,
        "a pump runs at any command, 0 V included",
        "cut the pumps' supply; relay or driver",
    ),
    Explanation(
        "pump_dead",
        Priority.MEDIUM,
        600.0,
        (
            'a pump has almost no effect (`safety.dead_below`), and `safety.dead_pump = "stop"`; this is a '
            "stop, not a trip"
        ),
        "the pump, its fuse",
    ),
    Explanation(
        "no_stable_law",
        Priority.MEDIUM,
        600.0,
        (
            "a valve has shifted so far (splits that add up to 1 or less) that no control law holds the "
            "outputs, or outlets that leave none; this is a stop, not a trip"
        ),
        "set the valve back, clean the outlet; after a wanted change set `pumps.valve_split`",
    ),
    Explanation(
        "start_failed",
        Priority.MEDIUM,
        600.0,
        (
            "at the end of the start phase a lower level was not at its first reference "
            "(`start.tolerance_cm`), or a lower tank leaks, may be fuller than its sensor shows, or has lost "
            "its sensor; a split more than 10 % too small looks the same; this is a stop, not a trip. The "
            "text says which, by how much, and which pump was at its limit"
        ),
        (
            "the tank that it names: level by eye, leak, sensor; `hil identify` for the splits. A pump at its"
            " limit: pump, hose, reservoir, leak. Otherwise more time: `start.settle_s`, a lower "
            "`start.rate_cm_s`"
        ),
    ),
    Explanation(
        "estimator_diverged",
        Priority.MEDIUM,
        600.0,
        "no known fault explains the readings",
        "read the report; compare the rig file with the rig",
    ),
    Explanation(
        "unknown_fault",
        Priority.MEDIUM,
        600.0,
        (
            "for `safety.unknown_fault_max_s` something has been wrong that no known fault explains; this is "
            "a stop, not a trip. While it is open, a level within 2 cm of `safety.level_max_cm` stops the "
            "run, too, as a high level"
        ),
        "read what the alarm says it looks like, and at which sensors; check hoses, plugs and tanks there",
    ),
    Explanation(
        "unattended",
        Priority.MEDIUM,
        600.0,
        (
            "nobody has acknowledged an alarm of high priority for `safety.unattended_s`, or sent a request for twice "
            "the time of `--attended`; this is a stop, not a trip"
        ),
        "the alarm that the text names; stay at the bench",
    ),
    Explanation(
        "bus_failed",
        Priority.HIGH,
        120.0,
        "the bus has failed, or accepts no frames",
        "adapter, link state; use a real bus",
    ),
    Explanation(
        "controller_failed",
        Priority.HIGH,
        120.0,
        "a control step raised an error, or its result was not a number",
        "keep the run folder, report it",
    ),
)
"""By the names of `TripCause`, for the events `trip` and `stop`."""

FAULTS: tuple[Explanation, ...] = (
    Explanation(
        "pump_effectiveness",
        Priority.MEDIUM,
        600.0,
        ("a pump gives less, or more, than the rig file says: worn, clogged, air in its hose, another supply voltage"),
        "look at pump and hose; control goes on with what is left",
    ),
    Explanation(
        "pump_dead",
        Priority.HIGH,
        120.0,
        "a pump gives no water",
        "its fuse, supply and hose; control goes on with the other pump, or stops (`safety.dead_pump`)",
    ),
    Explanation(
        "pump_stuck_on",
        Priority.HIGH,
        30.0,
        "a pump runs whatever its command is",
        "cut the pumps' supply; relay or driver",
    ),
    Explanation(
        "pump_lag",
        Priority.LOW,
        600.0,
        "a pump follows its command more slowly than the rig file says",
        "air in the hose, a filter in the driver; after a wanted change set `pumps.lag_s`",
    ),
    Explanation(
        "valve_split",
        Priority.MEDIUM,
        600.0,
        "a valve shares its flow in another way between the lower and the upper tank",
        "set the valve back; after a wanted change set `pumps.valve_split`",
    ),
    Explanation(
        "reservoir_low",
        Priority.HIGH,
        60.0,
        "the pumps draw air",
        "fill the reservoir; suction hoses",
    ),
    Explanation(
        "leak",
        Priority.HIGH,
        120.0,
        "a tank loses water beside its outlet",
        "look under the tank; close the leak, or stop the run",
    ),
    Explanation(
        "outlet_block",
        Priority.MEDIUM,
        300.0,
        "a tank's outlet lets out less than the rig file says",
        "clean the outlet; watch the level of that tank",
    ),
    Explanation(
        "sensor_bias",
        Priority.MEDIUM,
        600.0,
        "a sensor reads a constant amount too high or too low; its level is estimated without it",
        "compare it with a ruler; calibrate it after the run",
    ),
    Explanation(
        "sensor_drift",
        Priority.MEDIUM,
        600.0,
        "a sensor's reading moves away from the level; its level is estimated without it",
        "compare it with a ruler; its supply and temperature",
    ),
    Explanation(
        "sensor_noise",
        Priority.LOW,
        600.0,
        "a sensor is noisier than it was",
        "its plug, wires and screen",
    ),
    Explanation(
        "sensor_stuck",
        Priority.MEDIUM,
        600.0,
        "a sensor always reads the same; its level is estimated without it",
        "its float or tube, its converter",
    ),
    Explanation(
        "sensor_open",
        Priority.MEDIUM,
        600.0,
        "a sensor's wire is open or shorted; its level is estimated without it",
        "its plug and wires",
    ),
    Explanation(
        "sensor_garbage",
        Priority.MEDIUM,
        600.0,
        "a sensor's readings have nothing to do with the level; its level is estimated without it",
        "its plug, wires and converter",
    ),
    Explanation(
        "unresolved",
        Priority.MEDIUM,
        120.0,
        "something is wrong, and several faults explain it",
        "look at what its candidates name, with your own eyes first",
    ),
    Explanation(
        "unknown",
        Priority.HIGH,
        60.0,
        (
            "something is wrong that no known fault explains; the run stops when it lasts for "
            "`safety.unknown_fault_max_s`"
        ),
        "read what it looks like, and at which sensors; check hoses, plugs and tanks there",
    ),
)
"""By the kinds of the event `alarm`."""

EVENTS: tuple[Explanation, ...] = (
    Explanation(
        "relay_cut",
        Priority.HIGH,
        30.0,
        "a pump runs although its command is 0 V",
        "cut the pumps' supply now",
    ),
    Explanation(
        "bypass",
        Priority.LOW,
        600.0,
        "an interlock is bypassed",
        "watch what the interlock would watch; end it by time, or stop the run",
    ),
    Explanation(
        "target",
        Priority.LOW,
        600.0,
        "the pumps can't reach the reference; the nearest reachable one is used",
        "a smaller reference",
    ),
    Explanation(
        "bus_error",
        Priority.MEDIUM,
        600.0,
        "the CAN controller reports errors on the bus",
        "cable, termination, bit rate, other nodes on the bus",
    ),
    Explanation(
        "recorder_failed",
        Priority.MEDIUM,
        300.0,
        "part of the record is lost; control goes on",
        "disk space",
    ),
    Explanation(
        "recorder_lost",
        Priority.MEDIUM,
        300.0,
        "the recorder's process has ended; control goes on without a record",
        "disk space, memory",
    ),
    Explanation(
        "record_dropped",
        Priority.LOW,
        600.0,
        "the record has gaps: disk or viewer too slow",
        "another disk; `--no-rerun`",
    ),
    Explanation(
        "operator_absent",
        Priority.MEDIUM,
        60.0,
        "no operator has sent a request for the time that `--attended` asks for",
        "press a key in `hil panel` or send any request, such as `hil ctl here`; the run stops after the same time "
        "again",
    ),
)
"""By event code."""


def _by_name(rows: tuple[Explanation, ...]) -> dict[str, Explanation]:
    return {row.name: row for row in rows}


TRIP_BY_CAUSE, FAULT_BY_KIND, EVENT_BY_CODE = _by_name(TRIPS), _by_name(FAULTS), _by_name(EVENTS)
