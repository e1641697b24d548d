"""The figures of a campaign's report: delays of detection and isolation for each class of faults."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

from hil.campaigns.row import Row
from hil.review.run_figures import BLUE, INK, ORANGE, panels, svg

BINS = 40
MARKS_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
MIN_DELAY_S = 0.05
"""Delays below this, and none at all, fall into the first bin."""


def delays(label: str, rows: Sequence[Row], bound_s: float | None) -> str:
    """Histogram of the delays of detection and isolation over a logarithmic time, with the detection bound."""
    detected = _known(row.detection_s for row in rows)
    isolated = _known(row.isolation_s for row in rows)
    figure, (axes,) = panels(1)
    both = np.concatenate((detected, isolated))
    edges = np.geomspace(MIN_DELAY_S, max(10.0, 1.05 * both.max() if len(both) else 10.0), BINS + 1)
    for values, color, name in ((detected, BLUE, "detected"), (isolated, ORANGE, "isolated")):
        if len(values):
            axes.hist(values, bins=edges.tolist(), color=color, alpha=0.6, label=f"{name} ({len(values)})")
    if bound_s is not None:
        axes.axvline(max(bound_s, MIN_DELAY_S), color=INK, lw=1.2, dashes=(4, 2), label=f"bound {bound_s:.2g} s")
    axes.set_xscale("log")
    marks = [mark for mark in MARKS_S if mark <= edges[-1]]
    axes.set_xticks(marks, [f"{mark:g}" for mark in marks])
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("time since the onset [s]")
    axes.set_ylabel("runs")
    if len(both) or bound_s is not None:
        axes.legend(frameon=False, fontsize=8.5, loc="upper right")
    return svg(figure, f"Delays: {label}")


def _known(values: object) -> np.ndarray:
    return np.array([max(value, MIN_DELAY_S) for value in values if value is not None])  # type: ignore[attr-defined]
