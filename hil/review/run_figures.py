"""The report's figures as SVG text: the paper's figures 2 to 5, the upper tanks, and the loop's timing.

The same record gives the same bytes: fixed hash salt, no date. Text stays text: sharp, small, searchable.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil.review.alarms import Injected
from hil.review.ticks import Floats, LoggedEvent, Ticks

INK, GREY, RULE, PALE = "#22303c", "#7b8794", "#dfe4e8", "#c3d4e3"
BLUE, ORANGE = "#1f6fb2", "#cc5a24"
RED = "#b3261e"

_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "fourtank-hil",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.5,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "lines.linewidth": 1.5,
    "lines.solid_joinstyle": "round",
    "path.simplify_threshold": 0.3,
}
_WIDTH_IN, _HEIGHT_IN = 5.8, 2.75
_MAX_POINTS = 1500
_LEGEND_LETTERS = 85
"""So many fit above the axes in one row, with the lines beside them."""


@dataclass(frozen=True, eq=False)
class Trace:
    """A run as the figures need it. injected : pump -> its injected losses, by time."""

    name: str
    color: str
    ticks: Ticks
    outputs_V: Floats
    events: Sequence[LoggedEvent]
    injected: dict[int, tuple[Injected, ...]]


def style() -> AbstractContextManager[None]:
    """The look of all figures; draw them inside of it."""
    return mpl.rc_context(_STYLE)


def thin(times_s: Floats, values: Floats, max_points: int = _MAX_POINTS) -> tuple[Floats, Floats]:
    """At most about `max_points` points of a series: the lowest and the highest of every bunch, so that peaks stay."""
    if len(times_s) <= max_points:
        return times_s, values
    bunch = -(-len(times_s) // (max_points // 2))
    starts = np.arange(0, len(values), bunch)
    keep = {0, len(values) - 1}
    for start in starts:
        part = values[start : start + bunch]
        if np.isfinite(part).any():
            keep.update((int(start + np.nanargmin(part)), int(start + np.nanargmax(part))))
        else:
            keep.add(int(start))
    chosen = np.array(sorted(keep))
    return times_s[chosen], values[chosen]


def actuator_gains(trace: Trace) -> str:
    """Figure 2: the effectiveness of each pump, as diagnosed, over the injected one."""
    figure, (axes,) = panels(1)
    times_s = trace.ticks["t_s"]
    for pump, faults in sorted(trace.injected.items()):
        shares = _shares_left(faults, times_s)
        axes.step(
            *thin(times_s, shares),
            where="post",
            color=GREY,
            lw=3.2,
            alpha=0.45,
            label="injected" if pump == 1 else None,
        )
    for pump, color, dashes in ((1, BLUE, ()), (2, ORANGE, (4, 2.5))):
        axes.plot(
            *thin(times_s, trace.ticks[f"theta{pump}"]), color=color, dashes=dashes, label=f"pump {pump}, diagnosed"
        )
    most = max(float(np.max(trace.ticks[f"theta{pump}"], initial=1.0)) for pump in (1, 2))
    axes.set_ylim(-0.03, 1.12 * most)
    label_axes(axes, "share of the gain [1]")
    legend(axes)
    return svg(figure, "Actuator gains")


def _shares_left(faults: Sequence[Injected], times_s: Floats) -> Floats:
    """Effectiveness that a pump's faults leave at each time, (n,); of those that are there, the last one counts."""
    shares = np.ones(len(times_s))
    for fault in faults:
        run_s = times_s - fault.at_s
        is_there = (run_s >= 0.0) & (times_s < fault.until_s)
        if fault.period_s is not None:
            is_there &= run_s % fault.period_s < fault.duty * fault.period_s
        grown = 1.0 if fault.ramp_s == 0.0 else np.minimum(run_s / fault.ramp_s, 1.0)
        shares = np.where(is_there, 1.0 + (fault.value - 1.0) * grown, shares)
    return shares


def output(number: int, traces: Sequence[Trace]) -> str:
    """Figures 3 and 4: one output with its reference, each strategy a line."""
    figure, (axes,) = panels(1)
    first = traces[0].ticks
    axes.plot(*held(first["t_s"], first[f"r{number}_V"]), color=GREY, dashes=(4, 2), lw=1.2, label="reference")
    target = first[f"target{number}_V"]
    if not np.allclose(target, first[f"r{number}_V"], equal_nan=True, atol=1e-4):
        axes.plot(*held(first["t_s"], target), color=INK, lw=1.0, dashes=(1, 1.5), label="reference in force")
    for trace in reversed(traces):
        axes.plot(*thin(trace.ticks["t_s"], trace.outputs_V[:, number - 1]), color=trace.color, label=trace.name)
    _mark_alarms(axes, traces[0].events)
    label_axes(axes, f"output {number} [V]")
    legend(axes)
    return svg(figure, f"Output {number}")


def commands(traces: Sequence[Trace]) -> str:
    """Figure 5: the command signals, a panel for each strategy."""
    figure, rows = panels(len(traces))
    for axes, trace in zip(rows, traces, strict=True):
        times_s = trace.ticks["t_s"]
        for pump, color in ((1, BLUE), (2, ORANGE)):
            axes.plot(*thin(times_s, trace.ticks[f"v{pump}_V"]), color=color, lw=1.2, label=f"pump {pump}")
        axes.set_ylim(-0.3, 10.6)
        axes.set_yticks([0, 2.5, 5, 7.5, 10], ["0", "2.5", "5", "7.5", "10"])
        axes.set_title(trace.name, fontsize=9.5, loc="right", color=INK)
        label_axes(axes, "command [V]", is_last=axes is rows[-1])
        legend(axes)
    return svg(figure, "Command signals")


def upper_tanks(trace: Trace, gain_V_cm: float) -> str:
    """The levels of tanks 3 and 4 in cm: measured, and the true ones or the estimates."""
    figure, (axes,) = panels(1)
    times_s = trace.ticks["t_s"]
    for tank, color, pale in ((3, BLUE, PALE), (4, ORANGE, "#f0d3c4")):
        axes.plot(*thin(times_s, trace.ticks[f"h{tank}_V"] / gain_V_cm), color=pale, lw=0.8)
        has_truth = trace.ticks.has_truth
        kind = "true" if has_truth else "estimated"
        known = trace.ticks[f"true_h{tank}_cm"] if has_truth else trace.ticks[f"h{tank}_est_V"] / gain_V_cm
        axes.plot(*thin(times_s, known), color=color, label=f"tank {tank}, {kind}")
    axes.plot([], [], color=GREY, alpha=0.5, lw=0.8, label="measured (pale)")
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    label_axes(axes, "level [cm]")
    legend(axes)
    return svg(figure, "Upper tanks")


def error_so_far(traces: Sequence[Trace]) -> str:
    """How the integrals of the absolute error grow, as the controller counts them: output 1 full, output 2 dashed."""
    figure, (axes,) = panels(1)
    for trace in reversed(traces):
        for number, dashes in ((1, ()), (2, (4, 2))):
            sums = thin(trace.ticks["t_s"], trace.ticks[f"iae{number}_Vs"])
            axes.plot(*sums, color=trace.color, dashes=dashes, label=trace.name if number == 1 else None)
    axes.set_ylim(bottom=0.0)
    label_axes(axes, "IAE so far [V s]")
    legend(axes)
    return svg(figure, "Integral of the absolute error")


def lateness(trace: Trace) -> str:
    """How late the steps began: a histogram with a logarithmic count, so that rare late steps are visible."""
    figure, (axes,) = panels(1)
    late_ms = trace.ticks["lateness_s"] * 1e3
    late_ms = late_ms[np.isfinite(late_ms)]
    if len(late_ms):
        axes.hist(late_ms, bins=60, color=BLUE, alpha=0.85, log=True)
        if late_ms.max() > 0.0:
            at_ms = float(np.quantile(late_ms, 0.99))
            axes.axvline(at_ms, color=ORANGE, lw=1.2)
            axes.annotate(
                f"99 %: {at_ms:.3g} ms", (at_ms, 0.93), xycoords=("data", "axes fraction"),
                xytext=(5, 0), textcoords="offset points", color=ORANGE,
            )  # fmt: skip
    axes.set_xlabel("lateness of a step [ms]")
    axes.set_ylabel("steps")
    return svg(figure, "Lateness of the steps")


def panels(count: int) -> tuple[Figure, list[Axes]]:
    """A figure of the page's width with `count` axes beneath each other."""
    height_in = _HEIGHT_IN if count == 1 else 0.4 + 2.0 * count
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    grid = figure.subplots(count, 1, sharex=True, squeeze=False)
    return figure, list(grid[:, 0])


def label_axes(axes: Axes, quantity: str, *, is_last: bool = True) -> None:
    """Name the quantity, and the time beneath the last axes."""
    axes.set_ylabel(quantity)
    if is_last:
        axes.set_xlabel("run time [s]")
    axes.margins(x=0.01)


def legend(axes: Axes) -> None:
    """The legend above the axes, in two columns where it is long."""
    handles, names = axes.get_legend_handles_labels()
    is_long = sum(map(len, names)) + 6 * len(names) > _LEGEND_LETTERS
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2 if is_long else len(handles), frameon=False, fontsize=8.5,
        handlelength=1.6, columnspacing=1.3, borderaxespad=0.1,
    )  # fmt: skip


def _mark_alarms(axes: Axes, events: Sequence[LoggedEvent]) -> None:
    """Mark the first report of every alarm, and every trip: an alarm on a fault that grows is reported many times."""
    numbers = {event.data.get("number", event.t_s): event.t_s for event in reversed(events) if event.code == "alarm"}
    trips = {event.t_s for event in events if event.code == "trip"}
    for code, color, times_s in (("alarm", ORANGE, set(numbers.values())), ("trip", RED, trips)):
        for t_s in sorted(times_s):
            axes.axvline(t_s, color=color, lw=0.9, alpha=0.6)
            axes.annotate(
                code, (t_s, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -9),
                textcoords="offset points", color=color, fontsize=8,
            )  # fmt: skip


def held(times_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """A held signal as a line: the corners only."""
    change = np.flatnonzero(np.diff(values)) + 1
    at = np.concatenate(([0], np.repeat(change, 2), [len(values) - 1])) if len(values) else np.empty(0, dtype=int)
    times, held = times_s[at], values[at].copy()
    held[1:-1:2] = values[change - 1] if len(change) else held[1:-1:2]
    return times, held


def svg(figure: Figure, title: str) -> str:
    """The figure as an <svg> element for a page: no prolog, no metadata, no reference to anything outside."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    body = text.getvalue()
    body = body[body.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r' xmlns(:\w+)?="[^"]*"', "", body).replace("xlink:href", "href")
    body = re.sub(r' (width|height)="[\d.]+pt"', "", body, count=2)
    return body.replace("<svg", f'<svg role="img" aria-label="{title}"', 1)
