"""The records that flow through a control step.

Order everywhere: tank 1, 2 (lower), 3, 4 (upper); pump 1, 2; output 1, 2. Signals keep the unit they have on the
bench: level *voltages* in V (0.5 V/cm), pump voltages in V; levels in cm only where a name says so.
Small vectors are tuples of floats: immutable, quick, and written to a record as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from math import nan

Pair = tuple[float, float]
Quad = tuple[float, float, float, float]


class Mode(IntEnum):
    """What the controller is doing; the number is what the record and the timeline carry."""

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
        return self in (Mode.RUNNING, Mode.DEGRADED)

    @property
    def moves_pumps(self) -> bool:
        """Whether somebody asks for pump voltages in this mode: the loop or the operator."""
        return self in (Mode.RUNNING, Mode.DEGRADED, Mode.MANUAL)


class NodeState(IntEnum):
    """State of a node, as the wire's value table has it."""

    BOOT = 0
    READY = 1
    RUN = 2
    TRIPPED = 3


class TripCause(StrEnum):
    """What took the pumps to 0 V: the interlocks by name. The first one stays until the trip is cleared."""

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
    ESTIMATOR_DIVERGED = "estimator_diverged"
    BUS_FAILED = "bus_failed"
    CONTROLLER_FAILED = "controller_failed"


class Severity(StrEnum):
    """How much an event matters; named as log levels are."""

    INFO = "INFO"
    WARNING = "WARN"
    ERROR = "ERROR"


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth a line in the log: `code` is for programs, `text` for people, `data` has the numbers."""

    severity: Severity
    code: str
    text: str
    data: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Measurement:
    """The four level voltages as they stand at a control step.

    level_V : mean of the valid readings that came since the last step; the newest one, valid or not, when there were
    none; NaN before the first.
    valid : whether each channel's newest reading was in range and its node vouches for it.
    age_s : age of the oldest of the newest readings; inf before the first.
    readings : how many came since the last step (the smaller of the two frames), valid or not.
    variance_V2 : of the valid ones about their mean, per channel; NaN for fewer than two.
    jitter_V2 : half the mean square of their steps from one to the next, the largest step left out: little for a sensor
    that jumps once, much for a noisy one; NaN for fewer than two.
    repeats : how many readings in a row, up to the newest, had the newest one's value (the newest left out).
    invalid_run : how many readings in a row, up to the newest, were not valid.
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
    """What the pump node last said of itself.

    applied_V : its own outputs. shortfall_V : by how much they fell short of the command that it last echoed.
    age_s : of its status; inf before the first. unechoed_s : how long the oldest command that the node has not
    confirmed has been waiting; 0 when all are confirmed.
    """

    applied_V: Pair
    shortfall_V: Pair
    state: NodeState
    trip_cause: int
    age_s: float
    unechoed_s: float


@dataclass(frozen=True, slots=True)
class NodeHealth:
    """What the heartbeats say: the age of the older one, whether any node booted anew, and whose DBC they hold.

    is_lossy : whether counters have shown other frames to be missing of late, so that heartbeats may well be, too.
    """

    age_s: float
    rebooted: bool
    contract_matches: bool
    is_lossy: bool = False


@dataclass(frozen=True, slots=True)
class BusHealth:
    """Counters of the bus since the start: frames accepted, frames rejected, sends failed, and whether it is up.

    refused_run : the longest run of frames of one identifier since the last step that were refused one after the
    other. errors_per_s : error frames within the last second. last_error : what the bus last complained of.
    """

    accepted: int
    rejected: int
    send_failures: int
    foreign_commands: int
    is_up: bool
    refused_run: int = 0
    errors_per_s: int = 0
    last_error: str = ""


@dataclass(frozen=True, slots=True)
class Timing:
    """How late this step began, and how many control periods have been skipped since the start."""

    lateness_s: float = 0.0
    skipped: int = 0


class Action(StrEnum):
    """What an operator can ask for."""

    MANUAL = "manual"
    AUTO = "auto"
    BYPASS = "bypass"
    CLEAR = "clear"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Request:
    """An operator's wish.

    voltage_V : for MANUAL; None keeps what the pumps have. interlock, for_s : for BYPASS.
    """

    action: Action
    voltage_V: Pair | None = None
    interlock: TripCause | None = None
    for_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Inputs:
    """All that a control step gets to see besides its own state and the time."""

    measurement: Measurement
    pumps: PumpFeedback
    nodes: NodeHealth
    bus: BusHealth
    timing: Timing = Timing()
    stop_requested: bool = False
    requests: tuple[Request, ...] = ()


@dataclass(frozen=True, slots=True)
class Command:
    """What is sent to the pump node: voltages within range and rate, or disabled at 0 V."""

    voltage_V: Pair
    enable: bool
    clear_trip: bool = False


@dataclass(frozen=True, slots=True)
class Alarm:
    """What the diagnosis says of one fault; said again, under the same number, when more is known.

    kind, target : as in a scenario's [[fault]]; `UNRESOLVED`, 0 while several candidates remain.
    size : in the unit of the scenario's `value` (for `pump_effectiveness`: the effectiveness that is left).
    size_std : its standard deviation; NaN when not known. onset_s : when the fault is thought to have begun.
    isolated_s : when kind and target were settled; None before. candidates : "kind target" of all that could be,
    the likeliest first. is_recovery : the fault is over (a pump that came back, a sensor that can be trusted again).
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


UNRESOLVED = "unresolved"
"""Kind of an alarm whose candidates can't be told apart yet."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The current verdict.

    effectiveness : (2,) what is left of each pump's gain. new_alarms : what is new at this step.
    trusted : (4,) which sensors' readings may be used. level_V : (4,) the levels as the diagnosis' own filter has
    them, good for the sensors that are not trusted; None when it has none. stuck_on : (2,) pumps that deliver whatever
    they are told. is_diverged : the filter no longer explains the readings by any fault that it knows.
    unproven : (2,) pumps that may give no water: one that stood still when the other failed and has not been seen to
    work since, one that is dead if the likeliest suspicion is true, one whose upper tank gets nothing of it.
    is_blind : a level without a sensor is no longer known from the model either.
    has_fault : whether anything at all is accommodated.
    """

    effectiveness: Pair = (1.0, 1.0)
    new_alarms: tuple[Alarm, ...] = ()
    trusted: tuple[bool, bool, bool, bool] = (True, True, True, True)
    level_V: Quad | None = None
    stuck_on: tuple[bool, bool] = (False, False)
    is_diverged: bool = False
    unproven: tuple[bool, bool] = (False, False)
    is_blind: bool = False

    @property
    def has_fault(self) -> bool:
        """Whether a pump or a sensor is not what it should be."""
        return self.effectiveness != (1.0, 1.0) or not all(self.trusted) or any(self.stuck_on)


@dataclass(frozen=True, slots=True)
class TickRecord:
    """One control step, as recorded. Time is that of the run: 0 at the first step in control.

    monotonic_ns : the same moment on the clock that drives the loop.
    """

    t_s: float
    mode: Mode
    measured_V: Quad
    estimated_V: Quad
    reference_V: Pair  # asked for
    target_V: Pair  # in force: the nearest that the pumps can reach
    operating_V: Pair  # pump voltages that hold the target, nominal pumps
    raw_V: Pair  # what the control law asked for
    command_V: Pair  # what the supervisor let pass
    applied_V: Pair  # what the pump node says it applies
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
