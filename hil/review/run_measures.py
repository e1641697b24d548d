"""Measures that the key figures of a run and the rows of a campaign have in common.

The integral of a window's absolute error is exact for levels that are linear between two steps and references that
are held from one step to the next. So a reference step that falls on a window's border belongs to the window it opens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.edge.record.manifest import Window
from hil.review.alarms import Injected
from hil.review.ticks import Floats

RESERVOIR_LOW = "reservoir_low"
DRY_RUN_S = 2.0
"""How long pumps may run after the reservoir level is low."""


def absolute_error_integral(
    times_s: Floats, reference: Floats, level: Floats, from_s: float, to_s: float, hold_s: float
) -> tuple[float, float]:
    """Integral of |reference - level| over [from_s, to_s], and the seconds of it that the samples cover.

    times_s, reference, level : (n,), times ascending. The reference is held from its sample to the next; the level is
    linear between samples and held for `hold_s` after the last. Units: those of the level, times s.
    """
    known = np.isfinite(times_s) & np.isfinite(reference) & np.isfinite(level)
    times_s, reference, level = times_s[known], reference[known], level[known]
    if len(times_s) == 0:
        return 0.0, 0.0
    edges_s = np.append(times_s, times_s[-1] + hold_s)
    levels = np.append(level, level[-1])
    start_s = np.clip(edges_s[:-1], from_s, to_s)
    end_s = np.clip(edges_s[1:], from_s, to_s)
    span_s = end_s - start_s
    first = reference - np.interp(start_s, edges_s, levels)
    last = reference - np.interp(end_s, edges_s, levels)
    size = np.abs(first) + np.abs(last)
    crosses = first * last < 0.0
    # a straight error that changes sign is two triangles; otherwise it is a trapezoid
    triangles = (first**2 + last**2) / np.where(crosses, size, 1.0)
    mean = 0.5 * np.where(crosses, triangles, size)
    return float(np.sum(mean * span_s)), float(np.sum(span_s))


def after_fault_window(faults: Sequence[Injected], windows: Sequence[Window]) -> Window:
    """From the first fault's onset to the end of its window; without a window, to the end of the run."""
    at_s = faults[0].at_s
    to_s = min((window.to_s for window in windows if window.from_s <= at_s < window.to_s), default=math.inf)
    return Window("after_fault", at_s, to_s)


def dry_run(times_s: Floats, applied_V: Floats, faults: Sequence[Injected]) -> bool:
    """Whether a pump was still driven `DRY_RUN_S` after the reservoir level was low. applied_V : (n, 2)."""
    is_driven = (applied_V > 0.0).any(axis=1)
    dry = [fault for fault in faults if fault.kind == RESERVOIR_LOW]
    return any(bool((is_driven & (_seconds_there(fault, times_s) > DRY_RUN_S)).any()) for fault in dry)


def _seconds_there(fault: Injected, times_s: Floats) -> Floats:
    """For how long a fault has been there without a pause, at each time; -inf while it is away."""
    run_s = times_s - fault.at_s
    there_s = run_s if fault.period_s is None else run_s % fault.period_s
    is_there = (run_s >= 0.0) & (times_s < fault.until_s)
    if fault.period_s is not None:
        is_there &= there_s < fault.duty * fault.period_s
    return np.where(is_there, there_s, -np.inf)
