"""The records that flow through a control step.

Order everywhere: tank 1, 2 (lower), 3, 4 (upper); pump 1, 2; output 1, 2. Signals keep the unit they have on the
bench: level *voltages* in V (0.5 V/cm), pump voltages in V; levels in cm only where the name ends in _cm.
Small vectors are tuples of floats: immutable, quick, and written to a record as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from math import inf, nan
from typing import NamedTuple

Pair = tuple[float, float]
Quad = tuple[float, float, float, float]

ALL_SENSORS = (True, True, True, True)
"""Of `Measurement.valid` and `Diagnosis.trusted`: every channel."""


class Mode(IntEnum):
    """Mode of the controller; the number is what the record and the Rerun timeline contain."""

    DISARMED = 0
    READY = 1
    RUNNING = 2
    DEGRADED = 3
    STOPPING = 4
    TRIPPED = 5
    MANUAL = 6

    @property
    def is_controlling(self) -> bool:
        """Whether the loop is closed in this mode."""
        return self in _CONTROLLING

    @property
    def moves_pumps(self) -> bool:
        """Whether the loop or the operator sets pump voltages in this mode."""
        return self in _MOVING


_CONTROLLING = (Mode.RUNNING, Mode.DEGRADED)
_MOVING = (*_CONTROLLING, Mode.MANUAL)


class NodeState(IntEnum):
    """State of a node, as in the value table of the DBC."""

    BOOT = 0
    READY = 1
    RUN = 2
    TRIPPED = 3


class TripCause(StrEnum):
    """Why the pumps went to 0 V: the interlocks by name. The first cause is kept until the trip is cleared."""

    STALE_LEVELS = "stale_levels"
    INVALID_LEVELS = "invalid_levels"
    STALE_STATUS = "stale_status"
    NODE_TRIPPED = "node_tripped"
    NODE_REBOOTED = "node_rebooted"
    NODE_LOST = "node_lost"
    WRONG_CONTRACT = "wrong_contract"
    ECHO_MISSING = "echo_missing"
    FOREIGN_COMMAND = "foreign_command"
    ECHO_MISMATCH = "echo_mismatch"
    FRAMES_REFUSED = "frames_refused"
    ERROR_STORM = "error_storm"
    SENSORS_LOST = "sensors_lost"
    HIGH_LEVEL = "high_level"
    DRY_RUN = "dry_run"
    PUMP_STUCK_ON = "pump_stuck_on"
    PUMP_DEAD = "pump_dead"
    NO_STABLE_LAW = "no_stable_law"
    START_FAILED = "start_failed"
    ESTIMATOR_DIVERGED = "estimator_diverged"
    UNKNOWN_FAULT = "unknown_fault"
    UNATTENDED = "unattended"
    BUS_FAILED = "bus_failed"
    CONTROLLER_FAILED = "controller_failed"


class Severity(StrEnum):
    """Severity of an event, named like log levels."""

    INFO = "INFO"
    WARNING = "WARN"
    ERROR = "ERROR"


@dataclass(frozen=True, slots=True)
class Event:
    """A line of the event log: `code` for programs, `text` for people, `data` with the numbers."""

    severity: Severity
    code: str
    text: str
    data: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Measurement:
    """The four level voltages at a control step.

    level_V : mean of the valid readings since the last step; without any, the newest reading, valid or not; NaN before
    the first.
    valid : whether each channel's newest reading was in range and marked valid by its node.
    age_s : age of the oldest of the newest readings; inf before the first.
    readings : number of readings since the last step (the smaller of the two frames), valid or not.
    variance_V2 : of the valid readings about their mean, per channel; NaN for fewer than two.
    jitter_V2 : half the mean square of the differences of consecutive readings, without the largest difference: small
    for a sensor that jumps once, large for a noisy one; NaN for fewer than two.
    repeats : number of consecutive readings before the newest that equal the newest.
    invalid_run : number of consecutive readings, up to the newest, that were not valid.
    """

    level_V: Quad
    valid: tuple[bool, bool, bool, bool]
    age_s: float
    readings: int
    variance_V2: Quad = (nan, nan, nan, nan)
    jitter_V2: Quad = (nan, nan, nan, nan)
    repeats: tuple[int, int, int, int] = (0, 0, 0, 0)
    invalid_run: tuple[int, int, int, int] = (0, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class PumpFeedback:
    """The newest status of the pump node.

    applied_V : (2,) its outputs. shortfall_V : (2,) the command that it last echoed minus its outputs. age_s : of the
    status; inf before the first. unechoed_s : age of the oldest command that the node has not echoed; 0 when all are
    echoed.
    """

    applied_V: Pair
    shortfall_V: Pair
    state: NodeState
    trip_cause: int
    age_s: float
    unechoed_s: float


@dataclass(frozen=True, slots=True)
class NodeHealth:
    """Heartbeats: the age of the older one, whether a node has rebooted, whether the nodes use our DBC.

    is_lossy : whether frame counters show that frames were lost lately, so that heartbeats may be lost, too.
    """

    age_s: float
    rebooted: bool
    contract_matches: bool
    is_lossy: bool = False


@dataclass(frozen=True, slots=True)
class BusHealth:
    """Counters of the bus since the start: frames accepted, frames rejected, sends failed, and whether it is up.

    refused_run : the largest number of consecutive refused frames of one identifier since the last step. errors_per_s :
    error frames within the last second. last_error : text of the last bus error.
    rejection_summary : how many frames and lines were rejected since the start, of which identifier, and why; or "".
    """

    accepted: int
    rejected: int
    send_failures: int
    foreign_commands: int
    is_up: bool
    refused_run: int = 0
    errors_per_s: int = 0
    last_error: str = ""
    rejection_summary: str = ""


@dataclass(frozen=True, slots=True)
class Timing:
    """Lateness of this step, and the number of control periods skipped since the start."""

    lateness_s: float = 0.0
    skipped: int = 0


class Action(StrEnum):
    """Requests of an operator."""

    MANUAL = "manual"
    AUTO = "auto"
    BYPASS = "bypass"
    CLEAR = "clear"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Request:
    """An operator request.

    voltage_V : (2,) for MANUAL; None keeps the present voltages. interlock, for_s : for BYPASS. number : of a request
    that came while the run went on; 0 for the scenario's.
    """

    action: Action
    voltage_V: Pair | None = None
    interlock: TripCause | None = None
    for_s: float = 0.0
    number: int = 0


@dataclass(frozen=True, slots=True)
class Inputs:
    """The inputs of a control step, besides its state and the time.

    is_attended : whether an operator has sent any request since the last step. noted : events of bus and record since
    then.
    """

    measurement: Measurement
    pumps: PumpFeedback
    nodes: NodeHealth
    bus: BusHealth
    timing: Timing = Timing()
    stop_requested: bool = False
    requests: tuple[Request, ...] = ()
    is_attended: bool = False
    noted: tuple[Event, ...] = ()


@dataclass(frozen=True, slots=True)
class Command:
    """What is sent to the pump node: voltages within range and rate, or disabled at 0 V.

    start_phase : time 0 of the scenario has not come; the emulator needs to know, a pump node ignores it.
    """

    voltage_V: Pair
    enable: bool
    clear_trip: bool = False
    start_phase: bool = False


@dataclass(frozen=True, slots=True)
class Alarm:
    """A report of the diagnosis on one fault; later reports on the same fault keep its number.

    kind, target : as in a scenario's [[fault]]; `UNRESOLVED`, 0 while several candidates remain.
    size : in the unit of the scenario's `value` (for `pump_effectiveness`: the remaining effectiveness).
    size_std : its standard deviation; NaN if unknown. onset_s : estimated onset. isolated_s : when kind and target were
    determined; None before. candidates : "kind target" of all possible faults, the most likely first; for `UNKNOWN`
    those that it resembles most. is_recovery : the fault is over (a pump has recovered, a sensor is trusted again).
    looks : of `UNKNOWN`, what it looks like, a sentence.
    """

    detected_s: float
    kind: str
    target: int
    size: float
    size_std: float = nan
    onset_s: float = nan
    isolated_s: float | None = None
    candidates: tuple[str, ...] = ()
    number: int = 0
    is_recovery: bool = False
    looks: str = ""


UNRESOLVED = "unresolved"
"""Kind of an alarm whose fault is not isolated yet."""

UNKNOWN = "unknown"
"""Kind of an alarm about something that no known fault explains."""

NAMELESS = (UNRESOLVED, UNKNOWN)
"""Kinds of alarms that name no fault."""


@dataclass(frozen=True, slots=True)
class OpenQuestion:
    """An alarm that can't be resolved at rest: the level of a lower tank changes, or its sensor drifts.

    alarm : its number. tank : 1 or 2. apart_cm : by how much the two put that level apart: the more, the sooner a
    movement of the pumps or of the reference answers it.
    """

    alarm: int
    tank: int
    apart_cm: float


@dataclass(frozen=True, slots=True)
class Waterways:
    """Where the water goes, as the diagnosis has identified it: faults and the rig's own differences from its file.

    outlet : (4,) cross-section of each outlet over the file's. leak : (2,) leak of tanks 3 and 4, over the outlet of
    the file. gain : (2,) gain of each healthy pump over the file's. split : (2,) splits of the valves.
    """

    outlet: Quad
    leak: Pair
    gain: Pair
    split: Pair


@dataclass(frozen=True, slots=True)
class PossibleRig:
    """What the rig is if one candidate of an open alarm is true; fields as in `Diagnosis`.

    names : "kind target" of the candidate, of both pumps if it is both.
    """

    names: tuple[str, ...]
    effectiveness: Pair
    valve_split: Pair | None = None
    waterways: Waterways | None = None


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The current result of the diagnosis.

    effectiveness : (2,) each pump's gain over the healthy one; above 1 it gives more than its file says. new_alarms :
    the alarms of this step. trusted : (4,) sensors whose readings may be used. level_V : (4,) levels of the filter
    of the diagnosis, to use for sensors that are not trusted; None if it has no filter. stuck_on : (2,) pumps whose
    flow does not follow the command. is_diverged : no known fault explains the readings any more.
    unproven : (2,) pumps that may deliver nothing: a pump that was at rest when the other failed and has not been
    driven since, a pump that is dead if the most likely hypothesis is true, a pump whose upper tank gets no inflow.
    is_blind : a level has no sensor, and the model can no longer estimate it.
    refuted : (4,) sensors that are not trusted and can't show the level, whatever the fault: they keep no veto on high
    levels. A sensor that may drift because a leak or a blockage moves the level is not refuted.
    proven_V : (4,) by how much sensors that are not trusted read too high for certain, because a movement of the pumps
    has told their drift from a change of the level. All that they have read more since then may be the level.
    valve_split : (2,) splits of the valves if one has shifted; None if they are the rig file's.
    waterways : once a leak or a blocked outlet is declared; None otherwise.
    level_walk_cm_sqrt_s : (4,) standard deviation of the levels' random walk after a second, cm, as learned; NaN where
    nothing is learned.
    level_std_V : (4,) standard deviation of level_V; NaN without a filter. test_ratio, test_limit : the largest
    log-likelihood ratio of a fault against none, and the one from which on an alarm is raised; NaN for other methods.
    open_question : what a movement of the pumps would answer; None if nothing.
    hidden_cm : (2,) levels of the lower tanks, cm, if a sensor drifts downwards that nothing excludes yet; -inf if none
    may.
    is_unknown : something is wrong that no known fault explains. unknown_s : for how long it has been, s; it counts
    down slowly afterwards. possible_V : (4,) the levels that the pumps would have caused without it, which the tanks
    may have if the sensors are what is wrong; None if nothing is unknown.
    possible : what the rig may be while an alarm has been unresolved for some seconds; empty otherwise.
    flow_V : (2,) drive of a pump as its file has it that would give what each pump gives now, with lag and curve as
    learned, V; 0 where that is not well known, and on a rig that is as its file says.
    """

    effectiveness: Pair = (1.0, 1.0)
    new_alarms: tuple[Alarm, ...] = ()
    trusted: tuple[bool, bool, bool, bool] = (True, True, True, True)
    level_V: Quad | None = None
    stuck_on: tuple[bool, bool] = (False, False)
    is_diverged: bool = False
    unproven: tuple[bool, bool] = (False, False)
    is_blind: bool = False
    refuted: tuple[bool, bool, bool, bool] = (False, False, False, False)
    proven_V: Quad = (0.0, 0.0, 0.0, 0.0)
    valve_split: Pair | None = None
    waterways: Waterways | None = None
    level_walk_cm_sqrt_s: Quad = (nan, nan, nan, nan)
    level_std_V: Quad = (nan, nan, nan, nan)
    test_ratio: float = nan
    test_limit: float = nan
    open_question: OpenQuestion | None = None
    hidden_cm: Pair = (-inf, -inf)
    is_unknown: bool = False
    unknown_s: float = 0.0
    possible_V: Quad | None = None
    possible: tuple[PossibleRig, ...] = ()
    flow_V: Pair = (0.0, 0.0)

    @property
    def has_fault(self) -> bool:
        """Whether a pump or a sensor has a fault, or something is wrong that no known fault explains."""
        is_named = self.effectiveness != (1.0, 1.0) or not all(self.trusted) or any(self.stuck_on)
        return is_named or self.is_unknown


class TickRecord(NamedTuple):
    """One control step, as recorded. Time is that of the run: 0 at the first step in control or after a start phase.

    monotonic_ns : the same moment on the clock that drives the loop.
    """

    t_s: float
    mode: Mode
    measured_V: Quad
    estimated_V: Quad
    reference_V: Pair  # requested
    target_V: Pair  # in force: the nearest to it that the pumps can reach
    operating_V: Pair  # pump voltages that hold the target, nominal pumps
    raw_V: Pair  # output of the control law
    command_V: Pair  # what the supervisor allowed
    applied_V: Pair  # what the pump node reports
    effectiveness: Pair
    integral_Vs: Pair
    gain: tuple[float, ...]  # (12,): K by rows, in force on the pumps (effectiveness included)
    iae_Vs: Pair
    levels_age_s: float
    status_age_s: float
    lateness_s: float
    skipped: int  # control periods skipped so far
    accepted: int
    rejected: int
    events: tuple[Event, ...] = ()
    monotonic_ns: int = 0
    level_walk_cm_sqrt_s: Quad = (nan, nan, nan, nan)  # as diagnosis has learned it
    level_std_V: Quad = (nan, nan, nan, nan)  # of the filter of the diagnosis
    test_ratio: float = nan  # of the diagnosis, with the limit at which it raises an alarm
    test_limit: float = nan
    probe_V: Pair = (0.0, 0.0)  # part of raw_V: the movement that tells faults apart
    shown: Mapping[str, float] = {}  # of the control law, by name
