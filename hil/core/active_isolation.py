"""Active isolation: a small movement of both pumps that tells apart what looks the same at rest.

At rest, under integral action, a slow leak or blockage of a lower tank and a slow drift of its sensor give the same
readings and the same voltages. Their time constants differ, T = A/a sqrt(2 h/g), because a drift hides another level.
So while the diagnosis asks which of the two it is (`Diagnosis.open_question`), both pumps move up by `voltage_V` for
`move_s`, then hold the levels that they have reached for `hold_s`, and move down by `voltage_V` for `move_s`. This is
the probe. Most of what it tells comes from the time in which the levels are away from where they were: hence the hold.

waiting   a question is open; the probe begins when it has been open for `after_s` without a change of the reference,
          when the two explanations put the level so far apart that a movement can tell, and when there is room: see
          `reason_to_wait`
moving    the offset is added to what the control law asks for. The law does not act on the movement of the levels that
          the offset causes by the model (`deviation_cm`), and so does not cancel it; it acts on everything else
settling  the offset is zero, and the expected movement dies away with the time constants of the tanks: no bump

The movement ends at once when the question is answered, the reference changes, the loop no longer controls, a level
moves further than all water of the movement could move it, or a level or a pump comes near a limit. Interlocks take
no notice of a probe. Why: docs/decisions/0027-active-isolation.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isfinite

from hil.core.interlocks import Belief, Limits, levels_cm
from hil.core.tanks import LinearModel, linearise, pump_matrix
from hil.core.types import Diagnosis, Event, Inputs, Mode, OpenQuestion, Pair, Quad, Severity

PUMP_ROOM_V = 0.2
"""What is left between a moving pump and the limits of its range."""

LEVEL_ROOM_CM = 0.5
"""The movement begins only if the highest level stays so far below the level that trips; it ends at half of that."""

MIN_LEVEL_CM = 0.25
"""Lowest level of a tank during the movement: below it sensors and model say little."""

MIN_APART_CM = 0.3
"""Explanations that put the level closer together can't be told apart by one movement."""

AGAIN_APART = 1.5
"""A question is asked again sooner when they are so many times as far apart as at the last movement."""

SETTLED_CM = 0.005
"""A smaller expected movement of the levels is no longer subtracted."""

MIN_EFFECT = 1e-4
"""Least effect of a pump on its own lower tank, cm/(V s), that is divided by."""

MIN_EFFECTIVENESS = 0.5
"""A pump with less moves too little."""

GONE_S = 3.0
"""A question that is open again within this time was not answered."""

TOLERANCE_S = 1e-6
"""For comparing times, against rounding of floats."""

NONE = (0.0, 0.0, 0.0, 0.0)
REST = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ProbeConfig:
    """Settings of the probe. voltage_V, move_s : of the movement up and of that down. hold_s : between the two.

    after_s : how long a question must be open. again_s : time from one movement to the next about the same alarm, if
    the explanations have not come much further apart.
    """

    is_allowed: bool = False
    voltage_V: float = 0.3
    move_s: float = 30.0
    hold_s: float = 60.0
    after_s: float = 10.0
    again_s: float = 300.0

    @property
    def total_s(self) -> float:
        """Length of the whole movement."""
        return 2.0 * self.move_s + self.hold_s


NO_PROBE = ProbeConfig()


@dataclass(frozen=True, slots=True)
class Occasion:
    """What one step knows besides the probe's state.

    raw_V : (2,) what law and probe ask for. reference_s, next_reference_s : run times of the last and the next change
    of the reference. end_s : of the run.
    """

    mode: Mode
    inputs: Inputs
    belief: Belief
    raw_V: Pair
    reference_s: float = -inf
    next_reference_s: float = inf
    end_s: float = inf


@dataclass(frozen=True, slots=True)
class ProbeState:
    """State of the probe between two steps.

    offset_V : (2,) added to what the law asks for. deviation_cm : (4,) movement of the levels that the offset has
    caused by the model. question : that is open, since open_s; seen_s : when it was last seen. begun_s : of the
    movement, inf while there is none; alarm, apart_cm, start_cm : the alarm that it is about, `apart_cm` of the
    question and (4,) levels when it began. linear : model of the levels, None when they have settled. ended : the
    alarms that were probed, with run time of the end and `apart_cm` of the last movement. told : the reason to wait
    that was reported.
    """

    offset_V: Pair = REST
    deviation_cm: Quad = NONE
    question: OpenQuestion | None = None
    open_s: float = inf
    seen_s: float = -inf
    begun_s: float = inf
    alarm: int = 0
    apart_cm: float = 0.0
    start_cm: Quad = NONE
    linear: LinearModel | None = None
    ended: tuple[tuple[int, float, float], ...] = ()
    told: str = ""

    @property
    def is_moving(self) -> bool:
        """Whether the pumps move for the probe."""
        return isfinite(self.begun_s)

    @property
    def is_at_rest(self) -> bool:
        """Whether there is nothing to move, to follow or to ask, until a question is open."""
        return self.question is None and self.linear is None and not self.is_moving


Step = tuple[ProbeState, tuple[Event, ...]]
IDLE = ProbeState()


def step(config: ProbeConfig, limits: Limits, probe: ProbeState, at: Occasion, t_s: float, period_s: float) -> Step:
    """One step: the offset and the expected movement for the next one, and the events that announce both ends."""
    if has_nothing_to_do(config, probe, at.belief.diagnosis):
        return probe, ()
    probe = _follow(_ask(probe, at.belief.diagnosis, t_s), at, period_s)
    if probe.is_moving:
        reason = _reason_to_end(config, limits, probe, at, t_s)
        if reason:
            return _end(probe, reason, t_s)
        return replace(probe, offset_V=_offset(config, probe, t_s - probe.begun_s)), ()
    if probe.question is None or probe.seen_s != t_s or not at.mode.is_controlling:
        return probe, ()
    if t_s < max(probe.open_s, at.reference_s) + config.after_s - TOLERANCE_S:
        return probe, ()
    if probe.question.apart_cm < MIN_APART_CM or _is_too_soon(config, probe, probe.question, at, t_s):
        return probe, ()
    reason = reason_to_wait(config, limits, probe.question, at, t_s)
    if reason:
        return _wait(probe, probe.question, reason)
    return _begin(config, limits, probe, probe.question, at, t_s)


def has_nothing_to_do(config: ProbeConfig, probe: ProbeState, diagnosis: Diagnosis) -> bool:
    """Whether a step would change nothing: no probe is allowed, or none is under way and no question is open."""
    return not config.is_allowed or (probe.is_at_rest and diagnosis.open_question is None)


def reason_to_wait(config: ProbeConfig, limits: Limits, question: OpenQuestion, at: Occasion, t_s: float) -> str:
    """Why a movement would not be safe or of use now; "" when it may begin.

    The levels may rise or fall as if all water of the movement came or stayed away and the outlets did not react: this
    bound holds for every explanation that is still possible.
    """
    diagnosis, belief = at.belief.diagnosis, at.belief
    if at.next_reference_s - t_s < config.total_s or at.end_s - t_s < config.move_s:
        return "the reference changes soon, or the run ends"
    is_failed = min(diagnosis.effectiveness) < MIN_EFFECTIVENESS or not all(at.inputs.measurement.valid)
    if is_failed or _is_in_doubt(diagnosis) or _lost_sensors(diagnosis, question.tank):
        return "a pump or a sensor is in doubt"
    if belief.possible_cm is not None and max(belief.possible_cm) > -inf:
        return "a lower tank may be fuller than its sensor shows"
    low_V, high_V = limits.range_V
    reach_V = config.voltage_V + PUMP_ROOM_V
    if min(at.raw_V) - reach_V < low_V or max(at.raw_V) + reach_V > high_V:
        return "a pump is near the limit of its range"
    rises = rise_cm(limits, config)
    (h1, h2, h3, h4), (hidden1, hidden2) = levels_cm(limits, at.inputs, belief), diagnosis.hidden_cm
    seen = (max(h1, hidden1), max(h2, hidden2), h3, h4)
    if any(h + rise > limits.level_max_cm - LEVEL_ROOM_CM for h, rise in zip(seen, rises, strict=True)):
        return "a level is too high"
    if any(h - rise < MIN_LEVEL_CM for h, rise in zip(_lowest_cm(limits, at), rises, strict=True)):
        return "a level is too low"
    return ""


def rise_cm(limits: Limits, config: ProbeConfig) -> Quad:
    """(4,) how far each level rises if nothing leaves of what both pumps give more in `move_s`: an upper bound, in cm.

    Into a lower tank come its own pump's share and, through the tank above, the other pump's.
    """
    model = limits.model
    per_V = pump_matrix(model).sum(axis=1).tolist()
    flows = (per_V[0] + per_V[2], per_V[1] + per_V[3], per_V[2], per_V[3])
    h1, h2, h3, h4 = (
        flow * config.voltage_V * config.move_s / area for flow, area in zip(flows, model.area_cm2, strict=True)
    )
    return h1, h2, h3, h4


def _ask(probe: ProbeState, diagnosis: Diagnosis, t_s: float) -> ProbeState:
    """Note which question is open, and since when."""
    question = diagnosis.open_question
    if question is None:
        return replace(probe, question=None, open_s=inf) if t_s - probe.seen_s > GONE_S else probe
    if probe.question is None or probe.question.alarm != question.alarm:
        return replace(probe, question=question, open_s=t_s, seen_s=t_s, told="")
    return replace(probe, question=question, seen_s=t_s)


def _follow(probe: ProbeState, at: Occasion, period_s: float) -> ProbeState:
    """Move the expected deviation of the levels on by one period."""
    linear = probe.linear
    if linear is None:
        return probe
    if not at.mode.is_controlling:
        return replace(probe, deviation_cm=NONE, linear=None)
    theta1, theta2 = at.belief.diagnosis.effectiveness
    drive = (theta1 * probe.offset_V[0], theta2 * probe.offset_V[1])
    moved = linear.A @ probe.deviation_cm + linear.B @ drive
    d1, d2, d3, d4 = (d + period_s * rate for d, rate in zip(probe.deviation_cm, moved.tolist(), strict=True))
    if not probe.is_moving and max(abs(d1), abs(d2), abs(d3), abs(d4)) < SETTLED_CM:
        return replace(probe, deviation_cm=NONE, linear=None)
    return replace(probe, deviation_cm=(d1, d2, d3, d4))


def _is_too_soon(config: ProbeConfig, probe: ProbeState, question: OpenQuestion, at: Occasion, t_s: float) -> bool:
    """Whether a movement about this alarm has ended a short time ago, and nothing is known that makes another urgent.

    A drift that has been declared is reviewed by one movement; a question that nothing has answered is asked again.
    """
    is_declared = not at.belief.diagnosis.trusted[question.tank - 1]
    for alarm, ended_s, apart_cm in probe.ended:
        if alarm == question.alarm:
            is_much_further = question.apart_cm >= AGAIN_APART * apart_cm and not is_declared
            return t_s < ended_s + config.again_s - TOLERANCE_S and not is_much_further
    return False


def _offset(config: ProbeConfig, probe: ProbeState, since_s: float) -> Pair:
    """(2,) V. During the hold: the offsets that keep the deviations of the lower tanks as they are."""
    most_V = config.voltage_V
    if since_s < config.move_s - TOLERANCE_S or probe.linear is None:
        return most_V, most_V
    if since_s >= config.move_s + config.hold_s - TOLERANCE_S:
        return -most_V, -most_V
    A, B = probe.linear.A, probe.linear.B
    v1, v2 = (
        min(max(-float(A[tank] @ probe.deviation_cm) / max(float(B[tank, tank]), MIN_EFFECT), -most_V), most_V)
        for tank in (0, 1)
    )
    return v1, v2


def _begin(
    config: ProbeConfig, limits: Limits, probe: ProbeState, question: OpenQuestion, at: Occasion, t_s: float
) -> Step:
    levels = at.belief.level_cm or levels_cm(limits, at.inputs, at.belief)
    h1, h2, h3, h4 = (max(h, MIN_LEVEL_CM) for h in levels)
    text = (
        f"probe: both pumps move by +{config.voltage_V:g} V for {config.move_s:g} s, hold the levels for "
        f"{config.hold_s:g} s, then move by -{config.voltage_V:g} V for {config.move_s:g} s, to tell a drift of sensor "
        f"{question.tank} from a leak or blockage of tank {question.tank}"
    )
    data: dict[str, object] = {
        "state": "begin",
        "alarm": question.alarm,
        "tank": question.tank,
        "voltage_V": config.voltage_V,
        "move_s": config.move_s,
        "hold_s": config.hold_s,
    }
    new = replace(
        probe,
        offset_V=(config.voltage_V, config.voltage_V),
        begun_s=t_s,
        alarm=question.alarm,
        apart_cm=question.apart_cm,
        start_cm=levels,
        linear=linearise(limits.model, (h1, h2, h3, h4)),
        told="",
    )
    return new, (Event(Severity.WARNING, "probe", text, data),)


def _wait(probe: ProbeState, question: OpenQuestion, reason: str) -> Step:
    """Report once why there is no movement yet."""
    if probe.told == reason:
        return probe, ()
    data: dict[str, object] = {"state": "wait", "alarm": question.alarm, "tank": question.tank, "reason": reason}
    text = f"no probe for tank {question.tank} yet: {reason}"
    return replace(probe, told=reason), (Event(Severity.INFO, "probe", text, data),)


def _end(probe: ProbeState, reason: str, t_s: float) -> Step:
    lasted_s = t_s - probe.begun_s
    data: dict[str, object] = {"state": "end", "alarm": probe.alarm, "reason": reason, "lasted_s": lasted_s}
    event = Event(Severity.INFO, "probe", f"probe ended after {lasted_s:.1f} s: {reason}", data)
    others = (entry for entry in probe.ended if entry[0] != probe.alarm)
    ended = (*others, (probe.alarm, t_s, probe.apart_cm))
    return replace(probe, offset_V=REST, begun_s=inf, ended=ended), (event,)


def _reason_to_end(config: ProbeConfig, limits: Limits, probe: ProbeState, at: Occasion, t_s: float) -> str:
    """Why the movement ends at this step; "" while it goes on."""
    if not at.mode.is_controlling:
        return "the loop no longer controls"
    if probe.question is None or probe.question.alarm != probe.alarm:
        return "the question is answered"
    if t_s - probe.begun_s >= config.total_s - TOLERANCE_S:
        return "complete"
    if at.reference_s > probe.begun_s:
        return "the reference changes"
    diagnosis = at.belief.diagnosis
    if _is_in_doubt(diagnosis) or _lost_sensors(diagnosis, probe.question.tank):
        return "a pump or a sensor is in doubt"
    low_V, high_V = limits.range_V
    if min(at.raw_V) < low_V or max(at.raw_V) > high_V:
        return "a pump is at the limit of its range"
    if max(levels_cm(limits, at.inputs, at.belief)) > limits.level_max_cm - 0.5 * LEVEL_ROOM_CM:
        return "a level is near the level that trips"
    if min(_lowest_cm(limits, at)) < 0.5 * MIN_LEVEL_CM:
        return "a level is too low"
    levels, most = at.belief.level_cm or probe.start_cm, rise_cm(limits, config)
    moved = (abs(h - start) > move for h, start, move in zip(levels, probe.start_cm, most, strict=True))
    return "a level moves too far" if any(moved) else ""


def _is_in_doubt(diagnosis: Diagnosis) -> bool:
    """Whether a pump may not follow or not deliver, or a level is not known."""
    return any(diagnosis.stuck_on) or any(diagnosis.unproven) or diagnosis.is_blind or diagnosis.is_diverged


def _lost_sensors(diagnosis: Diagnosis, tank: int) -> bool:
    """Whether any sensor but that of the tank in question is not trusted."""
    return any(not trusted for number, trusted in enumerate(diagnosis.trusted, 1) if number != tank)


def _lowest_cm(limits: Limits, at: Occasion) -> Quad:
    """(4,) the lower of what sensors and model say."""
    seen = levels_cm(limits, at.inputs, at.belief)
    h1, h2, h3, h4 = (min(pair) for pair in zip(seen, at.belief.level_cm or seen, strict=True))
    return h1, h2, h3, h4
