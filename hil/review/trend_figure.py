"""The trend of parameters over runs, as a picture."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from hil.review import run_figures

Point = tuple[float, float, float]
"""Hours since the first run; move in per cent; its standard deviation in per cent."""

PANELS = (("gains", ("k1", "k2")), ("splits", ("gamma1", "gamma2")), ("outlets", ("a1", "a2", "a3", "a4")))
COLORS = (run_figures.BLUE, run_figures.ORANGE, "#3a7d44", "#7b4fa3")
WIDTH_IN, HEIGHT_IN, DPI = 7.0, 6.0, 130


def trend_png(points: Mapping[str, Sequence[Point]]) -> bytes:
    """A panel for gains, splits and outlets, with bars of two standard deviations. points : by parameter."""
    with run_figures.style():
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
        axes = figure.subplots(len(PANELS), sharex=True)
        for panel, (title, names) in zip(axes, PANELS, strict=True):
            panel.axhline(0.0, color=run_figures.GREY, linewidth=0.8)
            for name, color in zip(names, COLORS, strict=False):
                if points.get(name):
                    hours, moves, sds = zip(*points[name], strict=True)
                    panel.errorbar(hours, moves, [2.0 * sd for sd in sds], fmt="o-", color=color, label=name, capsize=2)
            panel.set_ylabel(f"{title}: moved [%]")
            if any(points.get(name) for name in names):
                panel.legend(loc="best", frameon=False, ncols=len(names))
        axes[-1].set_xlabel("hours since the first run")
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=DPI, metadata={"Software": None})
    return out.getvalue()
