"""Figures of several runs laid over each other, as SVG text: one colour for each run in all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from hil.compare.compared_run import ComparedRun
from hil.edge.record.record_errors import RunFolderError
from hil.review.kpi import level_gain, output_levels
from hil.review.run_figures import GREY, INK, RED, held, label_axes, legend, panels, svg, thin
from hil.review.ticks import Floats

COLORS = ("#1f6fb2", "#cc5a24", "#2f7d4f", "#8a4fae", "#b08a00", "#0f8b8d", "#a8326b", "#5f6c78")
"""Told apart also by most who see colours differently; after the last, they come again with dashes."""

DASHES = ((), (5, 2), (2, 2), (7, 2, 2, 2))
FIRST_WIDTH = 2.6
"""Of the first run, in points: it is seen beneath the others where they are the same."""

MARK_HEIGHT = 0.035
"""Of the marks of alarms and trips, as a share of the axes."""

MAX_NAMED = 12
"""Runs in a legend."""


@dataclass(frozen=True, slots=True)
class OverlaidFigure:
    """A figure with its words."""

    title: str
    caption: str
    svg: str


def overlaid_figures(runs: Sequence[ComparedRun]) -> list[OverlaidFigure]:
    """All figures, for the runs that have control steps; none without any. Draw them inside `run_figures.style()`."""
    drawn = [run for run in runs if len(run.ticks)]
    if not drawn:
        return []
    figures = [
        _outputs(drawn, output, "Reference of the first run dashed; alarms and trips of each run marked below.")
        for output in (1, 2)
    ]
    figures += [_columns(drawn, f"v{pump}_V", f"Pump {pump}", "command [V]", "Commanded voltage.") for pump in (1, 2)]
    for pump in (1, 2):
        text = "Effectiveness as diagnosed: 1 is nominal, 0 is dead."
        figures.append(_columns(drawn, f"theta{pump}", f"Pump {pump}, effectiveness", "share of the gain [1]", text))
    for tank in (1, 2, 3, 4):
        text = "Level signal as estimated."
        figures.append(_columns(drawn, f"h{tank}_est_V", f"Tank {tank}", f"estimated level {tank} [V]", text))
    for output in (1, 2):
        text = "Integral of the absolute error so far, as the controller counts it."
        figures.append(
            _columns(drawn, f"iae{output}_Vs", f"Error of output {output}", f"IAE {output} so far [V s]", text)
        )
    return figures


def _outputs(runs: Sequence[ComparedRun], output: int, caption: str) -> OverlaidFigure:
    def curve(run: ComparedRun) -> Floats:
        return _outputs_of(run)[:, output - 1]

    def reference(axes: Axes) -> None:
        first = runs[0]
        axes.plot(
            *held(first.times_s, first.ticks[f"r{output}_V"]), color=GREY, dashes=(4, 2), lw=1.2, label="reference"
        )

    title = f"Output {output}"
    return OverlaidFigure(title, caption, _drawn(runs, curve, f"output {output} [V]", title, reference))


def _outputs_of(run: ComparedRun) -> Floats:
    try:
        return output_levels(run.ticks, level_gain(run.manifest.plan.settings))
    except (RunFolderError, KeyError):
        return np.full((len(run.ticks), 2), np.nan)


def _columns(runs: Sequence[ComparedRun], column: str, title: str, quantity: str, caption: str) -> OverlaidFigure:
    low = -0.03 if column.startswith("theta") else None
    return OverlaidFigure(title, caption, _drawn(runs, lambda run: run.ticks.get(column), quantity, title, low=low))


def _drawn(
    runs: Sequence[ComparedRun],
    curve: Callable[[ComparedRun], Floats],
    quantity: str,
    title: str,
    before: Callable[[Axes], None] | None = None,
    low: float | None = None,
) -> str:
    """The figure as SVG. before : draws beneath the runs. low : lower end of a share's axis, which ends above 1."""
    figure, (axes,) = panels(1)
    if before is not None:
        before(axes)
    for place, run in enumerate(runs):
        values = curve(run)
        if np.isfinite(values).any():
            color, dashes = look(place)
            axes.plot(
                *thin(run.times_s, values), color=color, dashes=dashes, lw=1.2 if place else FIRST_WIDTH,
                label=run.name if place < MAX_NAMED else None,
            )  # fmt: skip
    if len(runs) > MAX_NAMED:
        axes.plot([], [], color=INK, lw=0.0, label=f"and {len(runs) - MAX_NAMED} more")
    if low is not None:
        axes.set_ylim(low, max(axes.get_ylim()[1], 1.12))
    _mark(axes, runs)
    label_axes(axes, quantity)
    if any(run.zero_s for run in runs):
        axes.set_xlabel("time from the common moment [s]")
    legend(axes)
    return svg(figure, title)


def look(place: int) -> tuple[str, tuple[int, ...]]:
    """Colour and dashes of the run in this place, counted from 0."""
    return COLORS[place % len(COLORS)], DASHES[place // len(COLORS) % len(DASHES)]


def _mark(axes: Axes, runs: Sequence[ComparedRun]) -> None:
    """Short marks above the time axis, a row for each run: first reports of alarms in its colour, trips in red."""
    for place, run in enumerate(runs[:MAX_NAMED]):
        color, _ = look(place)
        numbers = {e.data.get("number", e.t_s): e.t_s for e in reversed(run.events) if e.code == "alarm"}
        trips = {event.t_s for event in run.events if event.code == "trip"}
        low = MARK_HEIGHT * place
        for times_s, ink in ((set(numbers.values()), color), (trips, RED)):
            for t_s in sorted(times_s):
                axes.axvline(t_s - run.zero_s, low, low + MARK_HEIGHT, color=ink, lw=2.2)
