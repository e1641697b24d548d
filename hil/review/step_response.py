"""How an output follows its reference in a window of a run: settling time, overshoot, largest distance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hil.edge.record.manifest import Window
from hil.review.ticks import Floats, Ticks

Known = tuple[float | None, float | None] | None
"""Outputs 1, 2; None where the run ended before the window."""

SETTLED_V = 0.02
"""An output has settled from when on it stays within this distance of its reference."""

TIME_TOLERANCE_S = 1e-6
SAME_V = 1e-9


@dataclass(frozen=True, slots=True)
class StepResponse:
    """One output in a window.

    step_V : change of its reference from just before the window to the window's end. settling_s : from the first change
    of either reference in the window (without one, from the window's beginning) until the output stays within
    `SETTLED_V` of its reference up to the window's end; None if it is outside there. overshoot_V : farthest beyond the
    last reference, in the direction of the step, None without a step. overshoot_at_s : when that was, None if it did
    not overshoot. peak_V : largest distance from the reference.
    """

    step_V: float
    settling_s: float | None
    overshoot_V: float | None
    overshoot_at_s: float | None
    peak_V: float


def step_responses(
    times_s: Floats, reference_V: Floats, output_V: Floats, window: Window, period_s: float
) -> tuple[StepResponse, StepResponse] | None:
    """Both outputs in a window; None if the samples end before the window does.

    times_s : (n,), ascending. reference_V, output_V : (n, 2); rows that are not finite are left out.
    """
    known = np.isfinite(times_s) & np.isfinite(reference_V).all(axis=1) & np.isfinite(output_V).all(axis=1)
    times_s, reference_V, output_V = times_s[known], reference_V[known], output_V[known]
    first = int(np.searchsorted(times_s, window.from_s - TIME_TOLERANCE_S))
    end = int(np.searchsorted(times_s, window.to_s - TIME_TOLERANCE_S))
    if end - first < 2 or times_s[-1] < window.to_s - period_s - TIME_TOLERANCE_S:
        return None
    part, before = slice(first, end), max(first - 1, 0)
    # the row before the window first: a step at the window's border is a change of the window
    steps_V = np.abs(np.diff(np.vstack([reference_V[before], reference_V[part]]), axis=0))
    changed = np.flatnonzero((steps_V > SAME_V).any(axis=1))
    since = int(changed[0]) if len(changed) else 0
    one, two = (
        _response(times_s[part], reference_V[part, i], output_V[part, i], float(reference_V[before, i]), since)
        for i in (0, 1)
    )
    return one, two


def response_figures(
    ticks: Ticks, output_V: Floats, windows: Sequence[Window], period_s: float, gain_V_cm: float
) -> dict[str, dict[str, Known]]:
    """Settling times and overshoots of all windows, by the names that they have in `kpi.json`. output_V : (n, 2)."""
    reference_V = ticks.stack("r1_V", "r2_V")
    found = {window.name: step_responses(ticks["t_s"], reference_V, output_V, window, period_s) for window in windows}

    def figure(of: Callable[[StepResponse], float | None]) -> dict[str, Known]:
        return {name: None if pair is None else (of(pair[0]), of(pair[1])) for name, pair in found.items()}

    return {
        "settling_s": figure(lambda one: None if one.settling_s is None else round(one.settling_s, 9)),
        "overshoot_cm": figure(lambda one: None if one.overshoot_V is None else one.overshoot_V / gain_V_cm),
        "overshoot_at_s": figure(lambda one: one.overshoot_at_s),
    }


def _response(times_s: Floats, reference_V: Floats, output_V: Floats, before_V: float, since: int) -> StepResponse:
    """One output. before_V : its reference before the window. since : row from which it has to settle."""
    last_V = float(reference_V[-1])
    step_V = last_V - before_V
    distance_V = np.abs(output_V - reference_V)
    outside = np.flatnonzero(distance_V[since:] > SETTLED_V)
    settled = since + int(outside[-1]) + 1 if len(outside) else since
    settling_s = float(times_s[settled] - times_s[since]) if settled < len(times_s) else None
    overshoot_V, at_s = None, None
    if abs(step_V) > SAME_V:
        beyond_V = (output_V - last_V) * np.sign(step_V)
        farthest = int(np.argmax(beyond_V[since:])) + since
        overshoot_V = max(float(beyond_V[farthest]), 0.0)
        at_s = float(times_s[farthest]) if overshoot_V > 0.0 else None
    return StepResponse(step_V, settling_s, overshoot_V, at_s, float(distance_V.max()))
