"""The report of a tuning: the trade-off as figures, the candidates as a table, the choice marked."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil.campaigns.benchmark_table import DASH, number
from hil.campaigns.tuning_choice import RULE, Trial
from hil.review import page
from hil.review.run_figures import BLUE, GREY, INK, ORANGE, style, svg

HEADS = (
    "candidate", "", "step IAE [V s]", "loss IAE [V s]", "overshoot [mV]", "sigma(v) [mV]", "gain margin",
    "gain down to", "delay margin [s]", "distance", "stable when off by", "score", "objection",
)  # fmt: skip


PLOT_PT, LETTER_PT = (350.0, 120.0), 4.0
"""About the size of one of the two plots of a figure, and the width of a letter beside a point, in points."""


def render(rig: str, law: str, trials: Sequence[Trial]) -> str:
    """The page's HTML. rig : name of its file."""
    chosen = next((trial for trial in trials if trial.is_chosen), None)
    facts = [
        ("rig", rig),
        ("law", law),
        ("candidates", str(len(trials))),
        ("chosen", DASH if chosen is None else chosen.candidate.label),
    ]
    with style():
        figures = page.figure(trade_off(trials), "Trade-off", "down and to the left is better; a ring: chosen") + (
            page.figure(margins(trials), "Robustness", "of the loop with gains kept; a ring: chosen")
            if any(trial.robustness for trial in trials)
            else ""
        )
    heads = [head.replace("V s", "V\u00a0s") for head in HEADS]
    table = page.table(heads, map(line, trials), numeric=frozenset(range(2, len(HEADS) - 1)))
    body = (
        f"<header><h1>Tuning of {page.escape(law)}</h1>{page.facts(facts)}</header>\n"
        f'<div class="figures">{figures}</div>\n'
        + page.section("Candidates", f'<div class="named">{table}</div>' + page.paragraphs([RULE]))
        + page.section("Options of the chosen one", "" if chosen is None else page.bullets(options_of(chosen)))
    )
    return page.document(f"Tuning of {law}, {rig}", body)


def line(trial: Trial) -> list[str]:
    """A candidate as a line of the table."""
    robust = trial.robustness
    margins = (
        [DASH] * 5
        if robust is None
        else [
            number(robust.gain_up, 3), number(robust.gain_down, 2), number(robust.delay_s, 2),
            number(robust.distance, 2), f"{100.0 * robust.spread:g} %",
        ]
    )  # fmt: skip
    return [
        trial.candidate.label,
        "chosen" if trial.is_chosen else "",
        number(trial.step_iae_Vs, 3),
        number(trial.loss_iae_Vs, 3),
        number(trial.overshoot_V, 2, 1e3),
        number(trial.noise_V, 3, 1e3),
        *margins,
        number(trial.score, 3),
        trial.objection,
    ]


def options_of(trial: Trial) -> list[str]:
    """The options of a candidate, as a settings file has them."""
    return [f"{key} = {value}" for key, value in trial.candidate.values.items()]


def trade_off(trials: Sequence[Trial]) -> str:
    """Step IAE and loss IAE against the noise of the command."""
    figure = Figure(figsize=(5.8, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, name, value in (
        (upper, "step IAE [V s]", lambda trial: trial.step_iae_Vs),
        (lower, "loss IAE [V s]", lambda trial: trial.loss_iae_Vs),
    ):
        _points(axes, trials, value)
        axes.set_ylabel(name)
    lower.set_xlabel("sigma(v) at rest [mV]")
    _legend(upper)
    return svg(figure, "Trade-off")


def margins(trials: Sequence[Trial]) -> str:
    """Gain and delay margin against the noise of the command."""
    figure = Figure(figsize=(5.8, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    _points(upper, trials, lambda trial: None if trial.robustness is None else trial.robustness.gain_up)
    _points(lower, trials, lambda trial: None if trial.robustness is None else trial.robustness.delay_s)
    upper.set_ylabel("gain margin")
    lower.set_ylabel("delay margin [s]")
    lower.set_xlabel("sigma(v) at rest [mV]")
    return svg(figure, "Robustness")


def _points(axes: Axes, trials: Sequence[Trial], value: Callable[[Trial], float | None]) -> None:
    shown = [
        (trial, 1e3 * trial.noise_V, y)
        for trial in trials
        if (y := value(trial)) is not None and trial.noise_V is not None and math.isfinite(y)
    ]
    for trial, x, y in shown:
        color = ORANGE if trial.candidate.is_present else GREY if trial.objection else BLUE
        axes.plot(x, y, "o", color=color, ms=5.5)
        if trial.is_chosen:
            axes.plot(x, y, "o", color=INK, ms=12, mfc="none", mew=1.6)
    axes.margins(x=0.12, y=0.25)
    axes.set_ylim(bottom=0.0)
    named = [(trial.candidate.label[:18], x, y) for trial, x, y in shown if not trial.candidate.is_present]
    spots = _spots(axes, named, [(x, y) for _, x, y in shown])
    for (name, x, y), spot in zip(named, spots, strict=True):
        axes.annotate(name, (x, y), xytext=spot, textcoords="offset points", fontsize=7.5)


def _spots(
    axes: Axes, named: Sequence[tuple[str, float, float]], points: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Where each name stands beside its point, in points: the first place that no other name or point takes."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()

    def place(x: float, y: float) -> tuple[float, float]:
        return PLOT_PT[0] * (x - left) / (right - left), PLOT_PT[1] * (y - bottom) / (top - bottom)

    taken = [(px - 4.0, py - 4.0, px + 4.0, py + 4.0) for px, py in (place(x, y) for x, y in points)]
    spots = []
    for name, x, y in named:
        px, py = place(x, y)
        width = LETTER_PT * len(name)
        sides = ((dx, dy) for dy in (4.0, -11.0, 13.0, -20.0, 22.0, -29.0) for dx in (6.0, -6.0 - width, -width / 2.0))
        boxes = [((dx, dy), (px + dx, py + dy, px + dx + width, py + dy + 8.0)) for dx, dy in sides]
        inside = [one for one in boxes if one[1][0] > 0.0 and one[1][2] < PLOT_PT[0] and 0.0 < one[1][1] < PLOT_PT[1]]
        spot, box = next((one for one in inside if not any(_overlap(one[1], other) for other in taken)), boxes[0])
        taken.append(box)
        spots.append(spot)
    return spots


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _legend(axes: Axes) -> None:
    for color, name in ((ORANGE, "present"), (BLUE, "possible"), (GREY, "with an objection")):
        axes.plot([], [], "o", color=color, ms=5.5, label=name)
    axes.plot([], [], "o", color=INK, ms=9, mfc="none", mew=1.6, label="chosen")
    axes.legend(frameon=False, fontsize=8.5, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.1)
