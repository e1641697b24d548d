"""Faults that grow: when they are large enough to matter, and how long after that they have their name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hil.core.fault_kinds import FaultKind
from hil.core.types import Pair
from hil.review.alarms import Injected, Judgement

MATTERS = 0.05
"""Size of a fault that matters: share of a gain or outlet, change of a split; of a sensor, share of SENSOR_SPAN_V."""

SENSOR_SPAN_V = 5.0
PROMPT_S = 60.0
"""A fault should have its name within this time after it began to matter."""


@dataclass(frozen=True, slots=True)
class GrowthFigures:
    """How a run with growing faults was judged; None where no fault grows to MATTERS.

    grown_s : run time at which the last fault began to matter. named_s : time from then until all were named rightly,
    negative if earlier; None also where they were never, or something else was named.
    """

    grown_s: float | None = None
    named_s: float | None = None


def figures(faults: Sequence[Injected], verdict: Judgement, valve_split: Pair) -> GrowthFigures:
    """Figures of the faults of the process. valve_split : (2,) the splits from which valves move."""
    reached = [_matters_from(fault, valve_split) for fault in faults]
    times_s = [at_s for at_s in reached if at_s is not None]
    if not times_s or len(times_s) < len(reached):
        return GrowthFigures()
    grown_s = max(times_s)
    answers = [answer for answer in verdict.answers if answer is not None]
    isolated_s = [answer.isolated_s for answer in answers if answer.isolated_s is not None and answer.flips == 0]
    is_named = verdict.is_right and len(isolated_s) == len(faults)
    return GrowthFigures(grown_s, max(isolated_s) - grown_s if is_named else None)


def _matters_from(fault: Injected, valve_split: Pair) -> float | None:
    """Run time at which a growing fault reaches MATTERS; None for one that does not grow, or not as far."""
    full = _full_size(fault, valve_split)
    ramp_s = 1.0 if fault.kind == FaultKind.SENSOR_DRIFT else fault.ramp_s
    is_enough = full > 0.0 and (full >= MATTERS or fault.kind == FaultKind.SENSOR_DRIFT)
    return fault.at_s + ramp_s * MATTERS / full if ramp_s > 0.0 and is_enough else None


def _full_size(fault: Injected, valve_split: Pair) -> float:
    """What a fault grows to; of a sensor drift, what it grows by in a second."""
    if fault.kind == FaultKind.PUMP_EFFECTIVENESS:
        return abs(1.0 - fault.value)
    if fault.kind == FaultKind.VALVE_SPLIT and fault.target in (1, 2):
        return abs(fault.value - valve_split[fault.target - 1])
    if fault.kind in (FaultKind.SENSOR_BIAS, FaultKind.SENSOR_DRIFT):
        return abs(fault.value) / SENSOR_SPAN_V
    return abs(fault.value) if fault.kind in (FaultKind.LEAK, FaultKind.OUTLET_BLOCK) else 0.0
