"""The interlocks: the conditions that switch the pumps off, in the order in which a trip names its cause.

Each decides from one step's `Situation` whether it is active. TRIP: disabled at 0 V in the same step, latched.
STOP: an orderly ramp down. Trips come first in the table, so that the worst action wins. An operator may bypass, for a
limited time, interlocks that rest on the diagnosis alone; never an interlock on the node, the bus, a missing level or
an overflow. See docs/decisions/0011-interlocks.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import isfinite
from typing import NamedTuple

from hil.core.live_levels import NONE
from hil.core.overshoot import peak_levels
from hil.core.pumps import STRAIGHT, PumpPath
from hil.core.sensors import levels_shown
from hil.core.tanks import TankModel
from hil.core.types import ALL_SENSORS, Diagnosis, Inputs, NodeState, Pair, Quad, TripCause

NO_FAULT = Diagnosis()

UNKNOWN_MARGIN_CM = 2.0
"""While something is wrong that no known fault explains, a reading may come no closer to `level_max_cm`."""

LOSSY_AGE_FACTOR = 3.0
"""A heartbeat may be this many times older on a bus that loses frames: at 5 %, two in a row are lost every minute."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Configuration of the supervisor, from the rig file's [safety], [pumps], [sensors] and [tanks].

    lag_s : (2,) lag and delay of each pump: for so long it still delivers after its stop. pumps : commands as drives.
    rim_margin_cm : a predicted peak must stay this far below the rim. invalid_run_max, refused_run_max,
    errors_per_s_max : an interlock is active from this number on. echo_tolerance_V, echo_mismatch_s : by how much and
    for how long the applied voltages may differ from the echoed command. dead_below : a pump with less effectiveness is
    dead. dry_run_V : two dead pumps, one driven above this voltage, run dry. bypass_max_s : the longest bypass.
    unknown_fault_max_s : for how long a run goes on while something is wrong that no known fault explains.
    unattended_s, attended_s : see `attendance`.
    """

    range_V: Pair
    rate_V_s: float
    stop_ramp_V_s: float
    model: TankModel
    lag_s: Pair
    level_gain_V_cm: float
    level_max_cm: float
    rim_margin_cm: float
    levels_age_max_s: float
    status_age_max_s: float
    heartbeat_age_max_s: float
    echo_age_max_s: float
    echo_tolerance_V: float
    echo_mismatch_s: float
    invalid_run_max: int
    refused_run_max: int
    errors_per_s_max: int
    dead_below: float
    dry_run_V: float
    stops_on_dead_pump: bool
    stops_on_lost_lower_level: bool
    bypass_max_s: float
    pumps: PumpPath = STRAIGHT
    unknown_fault_max_s: float = 60.0
    unattended_s: float = 0.0
    attended_s: float = 0.0

    @property
    def max_drives(self) -> Pair:
        """(2,) the largest drive of each pump."""
        return self.pumps.drive((self.range_V[1], self.range_V[1]))


class Belief(NamedTuple):
    """What the control loop estimates at this step.

    level_cm : (4,) estimated levels, None before the first estimate. pump_V : (2,) drives: what the pumps deliver, lag
    included, or what is still under way to the tanks, whichever is more. accommodates : whether the law follows the
    diagnosis. open_share : (2,) see `overshoot.Outlets`. live_cm : (4,) see `live_levels`. law_problem : why the law
    can't hold the outputs; "" if it can. start_problem : why the start phase has failed; "" if it has not.
    possible_cm : (2,) of the lower tanks, see `inflow_watch`; None before the first. is_dry : see `dry_watch`.
    unattended : why nobody watches the run, see `attendance`; "" if somebody does.
    """

    diagnosis: Diagnosis = NO_FAULT
    level_cm: Quad | None = None
    pump_V: Pair = (0.0, 0.0)
    accommodates: bool = False
    open_share: Pair = (1.0, 1.0)
    live_cm: Quad = NONE
    law_problem: str = ""
    start_problem: str = ""
    possible_cm: Pair | None = None
    is_dry: bool = False
    unattended: str = ""


NO_BELIEF = Belief()


class Situation(NamedTuple):
    """The inputs of an interlock.

    level_cm : (4,) of `levels_cm`. pump_V : (2,) the most that a pump may still deliver, as the drive of a nominal
    pump. mismatch_s : how long the applied voltages have differed from the echoed command. open_share : (2,) of the
    lower tanks' outlets. live_cm : (4,) levels of sensors that are not trusted, -inf for others. law_problem,
    start_problem, possible_cm, is_dry, unattended : of the belief.
    """

    inputs: Inputs
    diagnosis: Diagnosis
    level_cm: Quad
    pump_V: Pair
    mismatch_s: float
    open_share: Pair
    live_cm: Quad
    law_problem: str
    start_problem: str
    possible_cm: Pair | None
    is_dry: bool
    unattended: str = ""


class Reaction(Enum):
    """What an active interlock does."""

    TRIP = "trip"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Interlock:
    """A row of the table. detail : numbers for the text, or "".

    shows_rejections : whether frames or lines that were rejected may be the reason, so that the text names them.
    """

    cause: TripCause
    is_active: Callable[[Limits, Situation], bool]
    text: str
    reaction: Reaction = Reaction.TRIP
    may_bypass: bool = False
    detail: Callable[[Situation], str] | None = None
    shows_rejections: bool = False

    def describe(self, situation: Situation) -> str:
        """The text, with its numbers."""
        detail = self.detail(situation) if self.detail is not None else ""
        text = f"{self.text}: {detail}" if detail else self.text
        rejected = situation.inputs.bus.rejection_summary if self.shows_rejections else ""
        return f"{text}; {rejected}" if rejected else text


def levels_cm(limits: Limits, inputs: Inputs, belief: Belief) -> Quad:
    """(4,) level of each tank that the interlocks assume, in cm.

    The reading; the estimate where the newest reading is not valid. Where the diagnosis does not trust the sensor: its
    own level, or that of the sensor as far as it may still be true, whichever is higher.
    """
    k = limits.level_gain_V_cm
    measurement, diagnosis = inputs.measurement, belief.diagnosis
    shown_cm = levels_shown(measurement.level_V, k)
    if measurement.valid == ALL_SENSORS and diagnosis.trusted == ALL_SENSORS:
        return shown_cm
    best = list(shown_cm)
    for channel in range(4):
        if not diagnosis.trusted[channel]:
            if diagnosis.level_V is not None:
                best[channel] = max(diagnosis.level_V[channel] / k, belief.live_cm[channel])
        elif not measurement.valid[channel] and belief.level_cm is not None:
            best[channel] = belief.level_cm[channel]
    h1, h2, h3, h4 = best
    return (h1, h2, h3, h4)


def _is_level_unknown(limits: Limits, s: Situation) -> bool:
    """A trusted sensor must be valid; for a sensor that is not trusted the diagnosis must give a finite level."""
    measurement, diagnosis = s.inputs.measurement, s.diagnosis
    if diagnosis.trusted == ALL_SENSORS:
        return max(measurement.invalid_run) >= limits.invalid_run_max or not all(map(isfinite, measurement.level_V))
    substitute = diagnosis.level_V
    for channel in range(4):
        if not diagnosis.trusted[channel]:
            if substitute is None or not isfinite(substitute[channel]):
                return True
        elif measurement.invalid_run[channel] >= limits.invalid_run_max or not isfinite(measurement.level_V[channel]):
            return True
    return False


def _will_overflow(limits: Limits, s: Situation) -> bool:
    if max(s.level_cm) > limits.level_max_cm:
        return True
    peaks_cm = peak_levels(limits.model, limits.lag_s, s.level_cm, s.pump_V, s.open_share)
    (p1, p2, p3, p4), (t1, t2, t3, t4), margin = peaks_cm, limits.model.height_cm, limits.rim_margin_cm
    return max(p1 - (t1 - margin), p2 - (t2 - margin), p3 - (t3 - margin), p4 - (t4 - margin)) > 0.0


def _describe_levels(s: Situation) -> str:
    """The levels, and which of them are readings that the diagnosis does not trust."""
    text = "levels of {:.2f}, {:.2f}, {:.2f}, {:.2f} cm".format(*s.level_cm)
    shown = [f"{i + 1}" for i in range(4) if s.level_cm[i] == s.live_cm[i]]
    if not shown:
        return text
    return f"{text}; sensor {' and '.join(shown)}, which diagnosis does not trust, may be right"


def _describe_possible(s: Situation) -> str:
    """The level that the inflow would hold with the outlet as it was."""
    return "" if s.possible_cm is None else f"its inflow would hold up to {max(s.possible_cm):.2f} cm"


def _is_high_for_unknown(limits: Limits, s: Situation) -> bool:
    """While a fault is unknown: a reading near the limit, or a level by the model above it, which may be true."""
    diagnosis = s.diagnosis
    if not diagnosis.is_unknown:
        return False
    if max(s.level_cm) > limits.level_max_cm - UNKNOWN_MARGIN_CM:
        return True
    model_V = diagnosis.possible_V
    return model_V is not None and max(model_V) / limits.level_gain_V_cm > limits.level_max_cm


def _is_dry_run(limits: Limits, s: Situation) -> bool:
    """No driven pump delivers water. A pump at rest whose state is unproven does not count as delivering."""
    dead1, dead2 = (left < limits.dead_below for left in s.diagnosis.effectiveness)
    unproven1, unproven2 = s.diagnosis.unproven
    delivers_nothing = (dead1 and (dead2 or unproven2)) or (dead2 and unproven1)
    return (delivers_nothing or s.is_dry) and max(s.inputs.pumps.applied_V) > limits.dry_run_V


INTERLOCKS: tuple[Interlock, ...] = (
    Interlock(
        TripCause.BUS_FAILED,
        lambda _, s: not s.inputs.bus.is_up,
        "the CAN bus is gone",
        detail=lambda s: s.inputs.bus.last_error,
        shows_rejections=True,
    ),
    Interlock(
        TripCause.FOREIGN_COMMAND,
        lambda _, s: s.inputs.bus.foreign_commands > 0,
        "another controller sends pump commands",
    ),
    Interlock(
        TripCause.NODE_TRIPPED,
        lambda _, s: s.inputs.pumps.state is NodeState.TRIPPED,
        "the pump node has tripped",
        shows_rejections=True,
    ),
    Interlock(TripCause.NODE_REBOOTED, lambda _, s: s.inputs.nodes.rebooted, "a node has rebooted"),
    Interlock(
        TripCause.WRONG_CONTRACT,
        lambda _, s: not s.inputs.nodes.contract_matches,
        "a node was built for another DBC",
    ),
    Interlock(
        TripCause.FRAMES_REFUSED,
        lambda m, s: s.inputs.bus.refused_run >= m.refused_run_max,
        "consecutive frames of one identifier are refused",
        shows_rejections=True,
    ),
    Interlock(
        TripCause.ERROR_STORM,
        lambda m, s: s.inputs.bus.errors_per_s >= m.errors_per_s_max,
        "too many error frames",
        may_bypass=True,
        detail=lambda s: f"{s.inputs.bus.errors_per_s} within a second",
        shows_rejections=True,
    ),
    Interlock(
        TripCause.STALE_LEVELS,
        lambda m, s: s.inputs.measurement.age_s > m.levels_age_max_s,
        "levels are too old",
        shows_rejections=True,
    ),
    Interlock(
        TripCause.STALE_STATUS,
        lambda m, s: s.inputs.pumps.age_s > m.status_age_max_s,
        "the pump node's status is too old",
        shows_rejections=True,
    ),
    Interlock(
        TripCause.NODE_LOST,
        lambda m, s: (
            s.inputs.nodes.age_s > m.heartbeat_age_max_s * (LOSSY_AGE_FACTOR if s.inputs.nodes.is_lossy else 1.0)
        ),
        "a node's heartbeat is too old",
        shows_rejections=True,
    ),
    Interlock(
        TripCause.NODE_REBOOTED,
        lambda _, s: s.inputs.pumps.state is NodeState.BOOT,
        "the pump node is booting",
    ),
    Interlock(
        TripCause.ECHO_MISSING,
        lambda m, s: s.inputs.pumps.unechoed_s > m.echo_age_max_s,
        "commands are not echoed",
        shows_rejections=True,
    ),
    Interlock(
        TripCause.ECHO_MISMATCH,
        lambda m, s: s.mismatch_s > m.echo_mismatch_s,
        "the pump node does not apply what it echoes",
        may_bypass=True,
        detail=lambda s: "short of {:.3g} and {:.3g} V".format(*s.inputs.pumps.shortfall_V),
    ),
    Interlock(
        TripCause.CONTROLLER_FAILED,
        lambda _, s: not (isfinite(s.diagnosis.effectiveness[0]) and isfinite(s.diagnosis.effectiveness[1])),
        "the diagnosis gave an effectiveness that is not a number",
    ),
    Interlock(
        TripCause.INVALID_LEVELS,
        _is_level_unknown,
        "a level is out of range or its sensor has failed",
    ),
    Interlock(
        TripCause.SENSORS_LOST,
        lambda _, s: s.diagnosis.trusted.count(False) > 1,
        "more than one level sensor is lost",
    ),
    Interlock(
        TripCause.SENSORS_LOST,
        lambda _, s: s.diagnosis.is_blind,
        "a level has no sensor, and the model can no longer estimate it",
    ),
    Interlock(
        TripCause.HIGH_LEVEL,
        _will_overflow,
        "a tank is about to overflow",
        detail=_describe_levels,
    ),
    Interlock(
        TripCause.PUMP_STUCK_ON,
        lambda _, s: any(s.diagnosis.stuck_on),
        "a pump does not follow its command",
    ),
    Interlock(TripCause.DRY_RUN, _is_dry_run, "the pumps run dry", may_bypass=True),
    Interlock(
        TripCause.ESTIMATOR_DIVERGED,
        lambda _, s: s.diagnosis.is_diverged,
        "the estimates no longer explain the readings",
        may_bypass=True,
    ),
    Interlock(
        TripCause.PUMP_DEAD,
        lambda m, s: m.stops_on_dead_pump and min(s.diagnosis.effectiveness) < m.dead_below,
        "a pump is dead",
        Reaction.STOP,
        may_bypass=True,
    ),
    Interlock(
        TripCause.HIGH_LEVEL,
        lambda m, s: s.possible_cm is not None and max(s.possible_cm) > m.level_max_cm,
        "a lower tank leaks, or it is fuller than its sensor shows",
        Reaction.STOP,
        detail=_describe_possible,
    ),
    Interlock(
        TripCause.HIGH_LEVEL,
        lambda m, s: max(s.diagnosis.hidden_cm) > m.level_max_cm,
        "a lower tank may be nearly full: nothing excludes that its sensor drifts",
        Reaction.STOP,
        detail=lambda s: f"it would hold {max(s.diagnosis.hidden_cm):.2f} cm",
    ),
    Interlock(
        TripCause.HIGH_LEVEL,
        _is_high_for_unknown,
        "something is wrong that no known fault explains, and a level is or may be high",
        Reaction.STOP,
        detail=_describe_levels,
    ),
    Interlock(
        TripCause.UNKNOWN_FAULT,
        lambda m, s: s.diagnosis.unknown_s > m.unknown_fault_max_s,
        "something is wrong that no known fault explains",
        Reaction.STOP,
        may_bypass=True,
        detail=lambda s: f"for {s.diagnosis.unknown_s:.0f} s",
    ),
    Interlock(
        TripCause.NO_STABLE_LAW,
        lambda _, s: bool(s.law_problem),
        "no control law can hold the outputs",
        Reaction.STOP,
        detail=lambda s: s.law_problem,
    ),
    Interlock(
        TripCause.START_FAILED,
        lambda _, s: bool(s.start_problem),
        "the start phase has failed",
        Reaction.STOP,
        detail=lambda s: s.start_problem,
    ),
    Interlock(
        TripCause.SENSORS_LOST,
        lambda m, s: m.stops_on_lost_lower_level and not all(s.diagnosis.trusted[:2]),
        "the level sensor of a lower tank is lost",
        Reaction.STOP,
    ),
    Interlock(
        TripCause.UNATTENDED,
        lambda _, s: bool(s.unattended),
        "nobody watches the run",
        Reaction.STOP,
        detail=lambda s: s.unattended,
    ),
)
"""In the order in which a trip names its cause when several are active."""

_CHECKS = tuple((interlock.is_active, interlock) for interlock in INTERLOCKS)
BYPASSABLE = frozenset(interlock.cause for interlock in INTERLOCKS if interlock.may_bypass)


def first_active(limits: Limits, situation: Situation, bypassed: tuple[TripCause, ...] = ()) -> Interlock | None:
    """The first interlock that is active and not bypassed, or None."""
    for is_active, interlock in _CHECKS:
        if is_active(limits, situation) and interlock.cause not in bypassed:
            return interlock
    return None
