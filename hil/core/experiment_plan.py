"""The phases of an identification experiment, and the envelope that they move in.

Voltages come from the rig file, as multiples of those that hold the lower levels in the middle of the envelope; the
levels that they give may be anything, see `hil.core.experiment`. Times and amplitudes were chosen by D-optimality,
docs/decisions/0031-experiment.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count
from math import inf, nan, sqrt

from hil.core.counted import counted
from hil.core.experiment import Envelope, Phase, Segment, Until
from hil.core.pumps import PumpPath
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Pair

TOP_SHARE, MIDDLE_SHARE, LOW_SHARE = 0.8, 0.5, 0.1
"""Shares of `safety.level_max_cm`: top of the envelope, levels around which the rig moves, and lower end."""

MAX_EMPTYING_S = 300.0
STILL_S, MIN_STILL_S = 8.0, 2.0
MIN_FILLING_S = 10.0
"""However short the experiment."""

RULER_READINGS = 10
"""How often levels are read by a ruler. What each number gives: docs/decisions/0041-levels-by-a-ruler.md."""

RULER_RANGE = (0.86, 0.8)
"""Shares of `safety.level_max_cm` between which levels are read: the higher, the less a millimetre counts."""

RULER_TOP_SHARE = 0.92
"""Top of the lower tanks while their levels are read."""

ALL_TANKS = (0, 1, 2, 3)

STANDING_S, MAX_STANDING_S = 10.0, (50.0, 15.0)
"""How long levels must stand still before they are read, and the longest wait for that: at first, and later."""

MAX_READING_S = 300.0
"""How long the rig waits for somebody to read the levels, each time."""

MAX_RISING_S = 6.0
"""How long a pump runs at its highest voltage for an upper level that has not risen before."""

RULER = "ruler"

SPREAD, GOLDEN = 0.03, 0.6180339887498949
"""By how much voltages differ from one segment to the next, as a share; the golden ratio spreads them evenly."""

BASIC_S, FULL_S = 700.0, 1160.0
"""Longest experiment, without emptying the tanks and without a ruler."""


@dataclass(frozen=True, slots=True)
class PlanSpec:
    """What a plan is made for. level_max_cm : that trips. rim_margin_cm : that the bound keeps from the rim.

    is_full : for the full structure. readings : how often the levels are read by a ruler, in a phase of their own; 0:
    no such phase. time_scale : of all hold times.
    """

    model: TankModel
    pumps: PumpPath
    operating_drives: Pair
    level_max_cm: float
    rim_margin_cm: float
    is_full: bool = False
    readings: int = 0
    time_scale: float = 1.0

    @property
    def base_drives(self) -> Pair:
        """(2,) drives that hold the higher lower level in the middle, by the file."""
        model, middle_cm = self.model, MIDDLE_SHARE * self.level_max_cm
        levels_cm = equilibrium(model, self.operating_drives)
        ratio = min(sqrt((middle_cm + model.datum_cm[i]) / (levels_cm[i] + model.datum_cm[i])) for i in (0, 1))
        return ratio * self.operating_drives[0], ratio * self.operating_drives[1]


def envelope(spec: PlanSpec) -> Envelope:
    """The envelope of a rig."""
    A1, A2, A3, A4 = spec.model.area_cm2
    top_cm = TOP_SHARE * spec.level_max_cm
    return Envelope(
        top_cm=(top_cm, top_cm, top_cm, top_cm),
        bound_cm=min(min(spec.model.height_cm) - 2.0 * spec.rim_margin_cm, spec.level_max_cm),
        share=(A3 / A1, A4 / A2),
        low_cm=LOW_SHARE * spec.level_max_cm,
        flows=_flows(spec.model),
    )


def _flows(model: TankModel) -> tuple[Pair, Pair]:
    """(2, 2) flow into both tanks of the left and of the right side, for 1 V of each pump."""
    (k1, k2), (gamma1, gamma2) = model.pump_gain_cm3_Vs, model.valve_split
    return (gamma1 * k1, (1.0 - gamma2) * k2), ((1.0 - gamma1) * k1, gamma2 * k2)


def plan(spec: PlanSpec) -> tuple[Phase, ...]:
    """The phases in their order."""
    phases = [_fill(spec), _steps(spec), _drain(spec)]
    if spec.is_full:
        phases += [_stairs(spec, 0), _stairs(spec, 1), _fast(spec)]
    binary_count, held_out_count = (12, 20) if spec.is_full else (8, 12)
    phases.append(_binary(spec, "binary", "a binary sequence on both pumps", binary_count, 20.0, (0.1, 1.9), start=1))
    if spec.readings:
        phases.append(_ruler(spec))
    text = "another binary sequence, which judges the result"
    phases.append(_binary(spec, "held_out", text, held_out_count, 8.0, (0.5, 1.5), start=40))
    return _spread(phases, spec.pumps)


def _at(
    spec: PlanSpec, first: float, second: float, max_s: float, until: Until = Until.TIME, level_cm: float = inf
) -> Segment:
    """A segment with multiples of the base drives."""
    base1, base2 = spec.base_drives
    return Segment(_voltage(spec, (first * base1, second * base2)), max_s * spec.time_scale, until, level_cm)


def _spread(phases: list[Phase], pumps: PumpPath) -> tuple[Phase, ...]:
    """The phases with voltages that differ a little from one segment to the next.

    The node rounds the voltages that it reports, by as much each time for the same one: with three voltages in an
    experiment all gains would be wrong by some 0.005 %, with many it averages out.
    """
    low_V, high_V = pumps.range_V
    number = count()

    def near(voltage_V: float) -> float:
        return min(max(voltage_V * _near_one(next(number)), low_V), high_V)

    return tuple(
        replace(
            phase,
            segments=tuple(
                replace(one, voltage_V=(near(one.voltage_V[0]), near(one.voltage_V[1]))) for one in phase.segments
            ),
        )
        if phase.name != RULER
        else phase
        for phase in phases
    )


def _near_one(index: int) -> float:
    """A number within SPREAD of 1, another one for each index."""
    return 1.0 + SPREAD * (2.0 * ((index + 1) * GOLDEN % 1.0) - 1.0)


def _voltage(spec: PlanSpec, drives: Pair) -> Pair:
    return spec.pumps.within_range(0, drives[0]), spec.pumps.within_range(1, drives[1])


def _fill(spec: PlanSpec) -> Phase:
    """Both pumps fill all tanks.

    An upper tank whose outlet lies below its zero stays empty at small flows: then its pump runs at its highest voltage
    for some seconds, before the level sensor is called wrong.
    """
    high_V = spec.pumps.range_V[1]
    middle_cm = MIDDLE_SHARE * spec.level_max_cm
    segments = (
        Segment((0.0, 0.0), MAX_EMPTYING_S, Until.STILL, still_s=max(STILL_S * spec.time_scale, MIN_STILL_S)),
        _at(spec, 1.4, 1.4, max(60.0, MIN_FILLING_S / spec.time_scale), Until.FILLED, level_cm=middle_cm),
        _at(spec, 1.0, 1.0, 25.0),
        Segment((high_V, 0.0), MAX_RISING_S, Until.RISEN, tanks=(3,)),
        Segment((0.0, high_V), MAX_RISING_S, Until.RISEN, tanks=(2,)),
    )
    text = "pumps at 0 V until the tanks are empty, then both pumps fill them"
    return Phase("fill", text, segments, empties=True)


def _steps(spec: PlanSpec) -> Phase:
    pairs = ((1.5, 1.0), (0.5, 1.0), (1.0, 1.5), (1.0, 0.5), (1.4, 1.4), (0.6, 0.6))
    return Phase("steps", "steps of each pump, then of both", tuple(_at(spec, *pair, 28.0) for pair in pairs))


def _drain(spec: PlanSpec) -> Phase:
    segments = (
        _at(spec, 1.8, 0.0, 30.0),
        _at(spec, 0.0, 0.0, 25.0),
        _at(spec, 0.0, 1.8, 30.0),
        _at(spec, 0.0, 0.0, 25.0),
        _at(spec, 1.4, 1.4, 35.0),
        _at(spec, 0.0, 0.0, 40.0),
    )
    return Phase("drain", "each pump fills its tanks and they drain, then both", segments)


def _stairs(spec: PlanSpec, pump: int) -> Phase:
    """One pump over its whole range, the other at rest: its dead zone and its curve."""
    low_V, high_V = spec.pumps.range_V
    shares = (0.03, 0.06, 0.09, 0.12, 0.16, 0.22, 0.3, 0.4, 0.55, 0.75, 1.0, 0.5)
    segments = []
    for share in shares:
        voltage = low_V + share * (high_V - low_V)
        pair = (voltage, 0.0) if pump == 0 else (0.0, voltage)
        segments.append(Segment(pair, 10.0 * spec.time_scale))
    return Phase(f"stairs_{pump + 1}", f"pump {pump + 1} over its whole range in stairs", tuple(segments))


def _fast(spec: PlanSpec) -> Phase:
    """Short pulses: lag and delay."""
    return _binary(spec, "fast", "a fast binary sequence on both pumps", 40, 2.0, (0.0, 2.2), start=20)


def _ruler(spec: PlanSpec) -> Phase:
    """Both lower levels come near the top and are read at several heights.

    All tanks are read at first, then those that are full enough for a millimetre to be little.
    """
    standing_s = max(STANDING_S * spec.time_scale, MIN_STILL_S)
    base_V = _at(spec, 1.2, 1.2, 1.0).voltage_V
    first_cm = RULER_RANGE[0] * spec.level_max_cm
    segments = [_at(spec, 1.2, 1.2, 30.0), *[Segment(base_V, 35.0 * spec.time_scale, aim_cm=first_cm)] * 3]
    for number, share in enumerate(ruler_shares(spec.readings)):
        is_first = number == 0
        wait_s = MAX_STANDING_S[0 if is_first else 1] * spec.time_scale
        aim_cm = nan if is_first else share * spec.level_max_cm
        segments += [
            Segment(base_V, wait_s, Until.STILL, still_s=standing_s, aim_cm=aim_cm),
            Segment(base_V, MAX_READING_S, Until.ANSWERED, tanks=ALL_TANKS if is_first else ()),
        ]
    text = f"high levels at constant voltages; somebody reads them by a ruler, {counted(spec.readings, 'time')}"
    return Phase(RULER, text, tuple(segments), lower_top_cm=RULER_TOP_SHARE * spec.level_max_cm)


def ruler_shares(readings: int) -> tuple[float, ...]:
    """Shares of `safety.level_max_cm` at which levels are read, (readings,).

    Each reading is at another height, so that it is a new one. The golden ratio spreads them evenly, with steps below
    two thirds of the range, so that the levels soon stand still.
    """
    high, low = RULER_RANGE
    return tuple(high - (high - low) * (number * GOLDEN % 1.0) for number in range(readings))


def _binary(spec: PlanSpec, name: str, text: str, bits: int, clock_s: float, shares: Pair, *, start: int) -> Phase:
    low, high = shares
    first, second = binary_sequence(bits, start), binary_sequence(bits, start + 31)
    segments = tuple(
        _at(spec, high if one else low, high if other else low, clock_s)
        for one, other in zip(first, second, strict=True)
    )
    return Phase(
        name,
        text,
        segments,
        is_held_out=name == "held_out",
        lift_V=_voltage(spec, (1.3 * spec.base_drives[0], 1.3 * spec.base_drives[1])),
    )


def binary_sequence(length: int, start: int) -> tuple[bool, ...]:
    """Bits of a maximum-length sequence of 63, x^6 + x^5 + 1, from one of its places on."""
    register, bits = 0b111111, []
    for index in range(start % 63 + length):
        bit = register & 1
        register = register >> 1 | (register ^ register >> 1) << 5 & 0b100000
        if index >= start % 63:
            bits.append(bool(bit))
    return tuple(bits)
