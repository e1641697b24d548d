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
    table = page.table(HEADS, map(line, trials), numeric=frozenset(range(2, len(HEADS) - 1)))
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
            number(robust.distance, 2), f"{robust.spread:.0%}",
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
    for trial in trials:
        y = value(trial)
        if y is None or trial.noise_V is None or not math.isfinite(y):
            continue
        x = 1e3 * trial.noise_V
        color = ORANGE if trial.candidate.is_present else GREY if trial.objection else BLUE
        axes.plot(x, y, "o", color=color, ms=5.5)
        if trial.is_chosen:
            axes.plot(x, y, "o", color=INK, ms=12, mfc="none", mew=1.6)
        axes.annotate(trial.candidate.label[:18], (x, y), xytext=(6, 4), textcoords="offset points", fontsize=7.5)
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.12)


def _legend(axes: Axes) -> None:
    for color, name in ((ORANGE, "present"), (BLUE, "possible"), (GREY, "with an objection")):
        axes.plot([], [], "o", color=color, ms=5.5, label=name)
    axes.plot([], [], "o", color=INK, ms=9, mfc="none", mew=1.6, label="chosen")
    axes.legend(frameon=False, fontsize=8.5, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.1)
