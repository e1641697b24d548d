"""One phase of an identification experiment: time and levels in, voltages out.

A phase is a list of segments: constant voltages that end by the levels or by time, whichever comes first. The rig may
differ from its file in everything, so no segment trusts a predicted level. An envelope keeps the tanks from their rims
by the levels read: a pump that feeds a tank which is too full stays at 0 V until that tank has fallen by HYSTERESIS_CM.

    lower tank above its top, or it would be with all water of the tank above in it    both pumps at 0 V
    upper tank above its top                                                           the pump that feeds it at 0 V
    lower tank below `low_cm`, in phases that ask for it                               both pumps at least at `lift_V`

The interlocks are above all this and rest on none of it. Why: docs/decisions/0031-experiment.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf, isfinite, nan, sqrt

from hil.core.types import Pair, Quad

HYSTERESIS_CM = 0.5

MAX_RESCALE = 1.25
"""Largest change of a voltage between two segments that aim at a level."""

BOUND_MARGIN_CM = 0.7
"""How far the levels that are aimed at keep from the bound."""

MIN_DETERMINANT = 0.1
"""File's splits whose flows differ less than this can't lift one side alone."""

STILL_CM = 0.1
"""Levels that change by no more than this for `still_s` stand still."""

FALLEN_CM = 1.0
"""A level that falls by this much while its tank is filled: its sensor shows the opposite."""

UNKNOWN: Quad = (nan, nan, nan, nan)


class Until(StrEnum):
    """What ends a segment before its time."""

    TIME = "time"
    FILLED = "filled"  # both lower levels are at `level_cm` or above
    STILL = "still"  # all levels stand still for `still_s`
    ANSWERED = "answered"  # somebody has read the levels
    RISEN = "risen"  # the levels of `tanks` have risen since the rig was empty


@dataclass(frozen=True, slots=True)
class Segment:
    """Voltages for at most max_s. level_cm : for FILLED. still_s : for STILL.

    tanks : (0..3) that are to be read, for ANSWERED (none: those that are full enough); that have to rise, for RISEN.
    aim_cm : when the segment begins, the voltages of the phase are scaled so that both lower levels come near it.
    """

    voltage_V: Pair
    max_s: float
    until: Until = Until.TIME
    level_cm: float = inf
    still_s: float = 0.0
    aim_cm: float = nan
    tanks: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Phase:
    """A phase. name : of its folder. text : what happens in it, for the announcement.

    is_held_out : its record is kept to judge what the others gave. lift_V : (2,) of the envelope's lower end, 0 V for
    none. empties : its first segment must leave all tanks empty, and afterwards every level must rise. lower_top_cm :
    top of the lower tanks in this phase; NaN: that of the envelope.
    """

    name: str
    text: str
    segments: tuple[Segment, ...]
    is_held_out: bool = False
    lift_V: Pair = (0.0, 0.0)
    empties: bool = False
    lower_top_cm: float = nan

    @property
    def max_s(self) -> float:
        """The longest that the phase can take."""
        return sum(segment.max_s for segment in self.segments)

    @property
    def moving_s(self) -> float:
        """The same without what waits for the levels, or for somebody who reads them."""
        waits = (Until.STILL, Until.ANSWERED, Until.RISEN)
        return sum(segment.max_s for segment in self.segments if segment.until not in waits)

    def readings_until(self, segment: int) -> int:
        """How often the levels are read in the segments up to this one, itself included."""
        return sum(one.until is Until.ANSWERED for one in self.segments[: segment + 1])


@dataclass(frozen=True, slots=True)
class Envelope:
    """Between which levels the experiment moves.

    top_cm : (4,) for each tank. bound_cm : for a lower tank with all water of the tank above in it. share : (2,) rise
    of a lower tank for 1 cm of the tank above. low_cm : of the lower tanks. empty_cm : an empty tank reads less than
    this above or below 0 cm. rise_cm : (4,) by how much each level must rise when the rig is filled. flows : (2, 2) by
    the file, into the left and the right pair of tanks, per volt of pumps 1 and 2.
    """

    top_cm: Quad
    bound_cm: float
    share: Pair
    low_cm: float
    empty_cm: float = 1.5
    rise_cm: Quad = (0.3, 0.3, 0.05, 0.05)
    flows: tuple[Pair, Pair] = ((1.0, 0.0), (0.0, 1.0))


@dataclass(frozen=True, slots=True)
class PhaseState:
    """Where a phase is.

    since_s : when the segment began. held, lifted : (2,) pumps held back, (2,) lower tanks that are too low. still_cm,
    still_since_s : levels, and since when they have not moved from there. empty_cm : levels read before filling.
    risen : (4,) tanks whose levels have risen since. factor : (2,) of all voltages, see `Segment.aim_cm`.
    problem : why the phase must stop; "" if it need not.
    """

    segment: int = 0
    since_s: float = 0.0
    held: tuple[bool, bool] = (False, False)
    lifted: tuple[bool, bool] = (False, False)
    still_cm: Quad = UNKNOWN
    still_since_s: float = 0.0
    empty_cm: Quad = UNKNOWN
    is_over: bool = False
    problem: str = ""
    voltage_V: Pair = (0.0, 0.0)
    factor: Pair = (1.0, 1.0)
    risen: tuple[bool, bool, bool, bool] = (False, False, False, False)


def advance(
    phase: Phase, envelope: Envelope, state: PhaseState, t_s: float, level_cm: Quad, *, answered: int = 0
) -> PhaseState:
    """The state at t_s, s since the phase began, with the voltages for the next step. Levels must be finite.

    answered : how often somebody has read the levels in this phase.
    """
    if state.is_over or state.problem:
        return replace(state, voltage_V=(0.0, 0.0))
    if isfinite(phase.lower_top_cm):
        envelope = replace(envelope, top_cm=(phase.lower_top_cm, phase.lower_top_cm, *envelope.top_cm[2:]))
    state = _with_stillness(_with_risen(envelope, state, level_cm), t_s, level_cm)
    state = replace(state, problem=_falls(envelope, state, level_cm))
    while not (state.is_over or state.problem) and _ends(phase, state, t_s, level_cm, answered):
        state = _next_segment(phase, envelope, state, t_s, level_cm)
    if state.is_over or state.problem:
        return replace(state, voltage_V=(0.0, 0.0))
    held, lifted = _held(envelope, state.held, level_cm), _lifted(envelope, state.lifted, level_cm)
    v1, v2 = (f * voltage for f, voltage in zip(state.factor, phase.segments[state.segment].voltage_V, strict=True))
    if any(lifted):
        v1, v2 = max(v1, phase.lift_V[0]), max(v2, phase.lift_V[1])
    voltage = (0.0 if held[0] else v1, 0.0 if held[1] else v2)
    return replace(state, held=held, lifted=lifted, voltage_V=voltage)


def _with_stillness(state: PhaseState, t_s: float, level_cm: Quad) -> PhaseState:
    moved = max(abs(now - then) for now, then in zip(level_cm, state.still_cm, strict=True))
    return state if moved <= STILL_CM else replace(state, still_cm=level_cm, still_since_s=t_s)


def _with_risen(envelope: Envelope, state: PhaseState, level_cm: Quad) -> PhaseState:
    first, second, third, fourth = (
        was or h - empty >= rise
        for was, h, empty, rise in zip(state.risen, level_cm, state.empty_cm, envelope.rise_cm, strict=True)
    )
    return replace(state, risen=(first, second, third, fourth))


def _ends(phase: Phase, state: PhaseState, t_s: float, level_cm: Quad, answered: int) -> bool:
    segment = phase.segments[state.segment]
    elapsed_s = t_s - state.since_s
    if elapsed_s >= segment.max_s - 1e-6:
        return True
    if segment.until is Until.FILLED:
        return min(level_cm[0], level_cm[1]) >= segment.level_cm
    if segment.until is Until.STILL:
        return min(elapsed_s, t_s - state.still_since_s) >= segment.still_s - 1e-6
    if segment.until is Until.RISEN:
        return all(state.risen[tank] for tank in segment.tanks)
    return segment.until is Until.ANSWERED and answered >= phase.readings_until(state.segment)


def _next_segment(phase: Phase, envelope: Envelope, state: PhaseState, t_s: float, level_cm: Quad) -> PhaseState:
    ended, number = phase.segments[state.segment], state.segment + 1
    if phase.empties and state.segment == 0:
        is_still = t_s - state.still_since_s >= ended.still_s - 1e-6
        state = replace(state, empty_cm=level_cm, problem=_not_empty(envelope, level_cm, is_still=is_still))
    is_over = number == len(phase.segments)
    if is_over and phase.empties and not state.problem:
        state = replace(state, problem=_not_risen(state.risen))
    factor = state.factor if is_over else _rescaled(envelope, phase.segments[number], state.factor, level_cm)
    return replace(state, segment=number, since_s=t_s, is_over=is_over, factor=factor)


def _rescaled(envelope: Envelope, segment: Segment, factor: Pair, level_cm: Quad) -> Pair:
    """The factors of the voltages for lower levels of aim_cm, or as high as all water above them allows.

    Levels at rest go with the square of the flow into both tanks of a side. Which pump gives how much of it is known
    from the file only, so the factors come near in several segments. Where the file's splits leave no choice, both
    voltages change alike.
    """
    if not isfinite(segment.aim_cm):
        return factor
    h1, h2, h3, h4 = level_cm
    sides = ((h1, h1 + envelope.share[0] * h3), (h2, h2 + envelope.share[1] * h4))
    wanted = [
        sqrt(min(segment.aim_cm / max(h, 0.1), (envelope.bound_cm - BOUND_MARGIN_CM) / max(total, 0.1)))
        for h, total in sides
    ]
    (m11, m12), (m21, m22) = envelope.flows
    v1, v2 = (f * voltage for f, voltage in zip(factor, segment.voltage_V, strict=True))
    flow1, flow2 = wanted[0] * (m11 * v1 + m12 * v2), wanted[1] * (m21 * v1 + m22 * v2)
    det = m11 * m22 - m12 * m21
    ratios = [min(wanted), min(wanted)]
    if abs(det) > MIN_DETERMINANT * (m11 * m22 + m12 * m21) and min(v1, v2) > 0.0:
        ratios = [(m22 * flow1 - m12 * flow2) / det / v1, (m11 * flow2 - m21 * flow1) / det / v2]
    first, second = (
        was * min(max(ratio, 1.0 / MAX_RESCALE), MAX_RESCALE) for was, ratio in zip(factor, ratios, strict=True)
    )
    return first, second


def _not_empty(envelope: Envelope, level_cm: Quad, *, is_still: bool) -> str:
    """Why the rig can't be filled now; "" if it can."""
    if not is_still:
        return "with the pumps at 0 V the levels do not come to rest: is a tank being filled, or a sensor loose?"
    wrong = [f"tank {i + 1} reads {h:.2f} cm" for i, h in enumerate(level_cm) if not abs(h) <= envelope.empty_cm]
    if not wrong:
        return ""
    return (
        f"the levels stand still with the pumps at 0 V, and {' and '.join(wrong)}: if the tank is empty, the sensor's "
        "gain or offset in the rig file is wrong (hil calibrate); if it is not, open its outlet"
    )


def _falls(envelope: Envelope, state: PhaseState, level_cm: Quad) -> str:
    """Which sensor falls while its tank is filled from empty; "" if none does."""
    del envelope
    if not isfinite(state.empty_cm[0]):
        return ""
    fallen = [f"{i + 1}" for i, h in enumerate(level_cm) if h < state.empty_cm[i] - FALLEN_CM]
    if not fallen:
        return ""
    what = f"sensor {' and '.join(fallen)} reads less than when the tank was empty"
    return f"{what}: does its reading fall with the level? (sensors.gain_V_cm, hil calibrate)"


def _not_risen(risen: tuple[bool, bool, bool, bool]) -> str:
    """Which level has not risen when the rig was filled; "" if all have."""
    low = [f"{i + 1}" for i in range(4) if not risen[i]]
    if not low:
        return ""
    return (
        f"the level of tank {' and '.join(low)} has not risen while the rig was filled: pump, hose, valve, reservoir "
        "or the level sensor"
    )


def _held(envelope: Envelope, held: tuple[bool, bool], level_cm: Quad) -> tuple[bool, bool]:
    """Which pumps must stay at 0 V. A pump that is held is released HYSTERESIS_CM further down."""
    margins = [HYSTERESIS_CM if one else 0.0 for one in held]
    h1, h2, h3, h4 = level_cm
    t1, t2, t3, t4 = envelope.top_cm
    s3, s4 = envelope.share
    over_cm = max(h1 - t1, h2 - t2, h1 + s3 * h3 - envelope.bound_cm, h2 + s4 * h4 - envelope.bound_cm)
    return max(over_cm, h4 - t4) > -margins[0], max(over_cm, h3 - t3) > -margins[1]


def _lifted(envelope: Envelope, lifted: tuple[bool, bool], level_cm: Quad) -> tuple[bool, bool]:
    """Which lower tanks are too low."""
    first, second = (level_cm[i] < envelope.low_cm + (HYSTERESIS_CM if lifted[i] else 0.0) for i in range(2))
    return first, second
