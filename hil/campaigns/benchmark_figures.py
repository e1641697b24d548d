"""The figures of a benchmark's report: who is how far behind, and the error against the noise of the commands."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil.campaigns.contests import Entrant
from hil.campaigns.standing import Overall, Standing
from hil.review.run_figures import BLUE, GREY, INK, ORANGE, RED, svg

COLORS = (BLUE, ORANGE, "#2f7d4f", "#8250a8", "#b08800", "#0f8b8d", RED, "#7b8794", "#6b4226", "#d1478c")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
WIDTH_IN = 5.8


class Looks:
    """A colour for each law and a mark for each detector, the same in all figures."""

    def __init__(self, entrants: Sequence[Entrant]) -> None:
        self._laws = list(dict.fromkeys(one.law for one in entrants))
        self._detectors = list(dict.fromkeys(one.detector for one in entrants))

    def color(self, entrant: Entrant) -> str:
        """Of the law."""
        return COLORS[self._laws.index(entrant.law) % len(COLORS)]

    def marker(self, entrant: Entrant) -> str:
        """Of the detector."""
        return MARKERS[self._detectors.index(entrant.detector) % len(MARKERS)]


def overall_ratios(overall: Sequence[Overall], looks: Looks) -> str:
    """The geometric mean of the ratios of each entrant with its interval, the best at the top."""
    entries = [(one.entrant, one.ratio) for one in sorted(overall, key=lambda one: one.ratio.value)]
    return _intervals(entries, looks, "ratio of IAE to the best, geometric mean", "All windows")


def course_ratios(standings: Sequence[Standing], looks: Looks) -> str:
    """The ratio of each entrant on one course."""
    entries = [(one.entrant, one.ratio) for one in sorted(standings, key=lambda one: one.ratio.value)]
    return _intervals(entries, looks, "ratio of IAE to the best: median, 95 %", standings[0].course.name)


def error_and_noise(standings: Sequence[Standing], looks: Looks) -> str:
    """IAE of both outputs against the noise of the command; whoever has less of both is better."""
    figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
    axes = figure.subplots()
    known = [(one, sum(one.iae_Vs), one.noise_V) for one in standings if None not in one.iae_Vs and one.noise_V]  # type: ignore[arg-type]
    for one, iae_Vs, noise_V in known:
        axes.plot(1e3 * noise_V, iae_Vs, looks.marker(one.entrant), color=looks.color(one.entrant), ms=7, alpha=0.85)
    front = _front([(1e3 * noise_V, iae_Vs) for _, iae_Vs, noise_V in known])
    axes.plot(*zip(*front, strict=True), color=GREY, lw=1.0, dashes=(4, 2), zorder=0) if len(front) > 1 else None
    axes.set_xscale("log")
    axes.set_yscale("log")
    _plain_ticks(axes)
    axes.set_xlabel("sigma(v) at rest [mV]")
    axes.set_ylabel("IAE, both outputs [V s]")
    _key(axes, [one.entrant for one, _, _ in known], looks)
    return svg(figure, f"Error and noise, {standings[0].course.name}")


def _intervals(entries: Sequence[tuple[Entrant, object]], looks: Looks, quantity: str, title: str) -> str:
    from hil.campaigns.standing import Interval

    figure = Figure(figsize=(WIDTH_IN, 0.9 + 0.26 * len(entries)), layout="constrained")
    axes = figure.subplots()
    shown = [one for _, one in entries if isinstance(one, Interval)]
    finite = [
        value for one in shown for value in (one.value, one.low, one.high) if math.isfinite(value) and value > 0.0
    ]
    high = 1.25 * max([1.5, *finite])
    for place, ((entrant, _), one) in enumerate(zip(entries, shown, strict=True)):
        color = looks.color(entrant)
        low, top = (min(max(value, 1e-3), high) for value in (one.low, one.high))
        axes.plot([low, top], [place, place], color=color, lw=2.2, alpha=0.45, solid_capstyle="butt")
        if math.isfinite(one.value):
            axes.plot(one.value, place, looks.marker(entrant), color=color, ms=5.5)
        else:
            axes.annotate("half of the runs or more did not end", (high, place), ha="right", va="center", color=RED)
    axes.axvline(1.0, color=INK, lw=0.8)
    axes.set_xscale("log")
    axes.set_xlim(min([0.9, *finite]) * 0.95, high * 1.05)
    _plain_ticks(axes, only_x=True)
    axes.set_yticks(range(len(entries)), [entrant.name for entrant, _ in entries])
    axes.invert_yaxis()
    axes.tick_params(axis="y", labelsize=8)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(quantity)
    return svg(figure, title)


def _front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Those that nobody beats in both."""
    front: list[tuple[float, float]] = []
    for noise, iae in sorted(points):
        if not front or iae < front[-1][1]:
            front.append((noise, iae))
    return front


def _plain_ticks(axes: Axes, *, only_x: bool = False) -> None:
    """1, 2, 5, 10 in place of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in (axes.xaxis,) if only_x else (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def _key(axes: Axes, entrants: Sequence[Entrant], looks: Looks) -> None:
    """Colours are laws, marks are detectors."""
    for law in dict.fromkeys(one.law for one in entrants):
        first = next(one for one in entrants if one.law == law)
        axes.plot([], [], "o", color=looks.color(first), label=law)
    detectors = list(dict.fromkeys(one.detector for one in entrants))
    for detector in detectors if len(detectors) > 1 else ():
        first = next(one for one in entrants if one.detector == detector)
        axes.plot([], [], looks.marker(first), color=GREY, mfc="none", label=detector)
    if entrants:
        axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.2)
