"""A replay as one HTML file: recorded and replayed commands over each other, their difference, alarms, doubts."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from hil.replay.alarm_difference import in_words
from hil.replay.replay_run import ReplayResult
from hil.review import page
from hil.review.alarms import Finding
from hil.review.run_figures import BLUE, GREY, INK, ORANGE, RED, panels, style, svg, thin
from hil.review.ticks import Floats


def replay_page(result: ReplayResult) -> str:
    """The whole page."""
    verdict = page.badge("complete" if result.is_same else "failed", "same" if result.is_same else "differs")
    if result.comparison is None:
        verdict = page.badge("stopped", "what if")
    head = f"<header><h1>Replay of {page.escape(str(result.where))}{verdict}</h1>"
    head += page.paragraphs(result.summary) + "</header>\n"
    with style():
        figures = page.figure(_commands(result), "Commands", _caption(result), is_wide=True)
    rows = [
        (_said(result.recorded_alarms or (), at), _said(result.replayed_alarms, at))
        for at in range(max(len(result.recorded_alarms or ()), len(result.replayed_alarms)))
    ]
    alarms = page.table(result.columns, rows) if rows else ""
    body = head + f'<div class="figures">{figures}</div>' + page.section("Alarms", alarms)
    return page.document(
        f"Replay of {result.where.name}", body + page.section("Not exact", page.bullets(result.doubts))
    )


def _caption(result: ReplayResult) -> str:
    text = f"Grey: recorded, in colour: {result.columns[1]}, on the recorded frames. Below: their difference."
    text += " Vertical lines: alarms, those of the record dashed." if result.replayed_alarms else ""
    return text + (" The red line is the first difference." if result.comparison and result.comparison.first else "")


def _commands(result: ReplayResult) -> str:
    """Both commands, a panel for each pump, and their differences."""
    times_s, recorded_V, replayed_V = _voltages(result)
    figure, (first, second, third) = panels(3)
    for axes, pump, color in ((first, 0, BLUE), (second, 1, ORANGE)):
        was, now = "reference" if result.reference_version else "recorded", result.columns[1]
        axes.plot(*thin(times_s, recorded_V[:, pump]), color=GREY, lw=3.2, alpha=0.45, label=was)
        axes.plot(*thin(times_s, replayed_V[:, pump]), color=color, lw=1.2, label=now)
        axes.set_ylabel(f"pump {pump + 1} [V]")
        third.plot(*thin(times_s, replayed_V[:, pump] - recorded_V[:, pump]), color=color, label=f"pump {pump + 1}")
    third.set_ylabel("difference [V]")
    third.set_xlabel("run time [s]")
    for axes in (first, second, third):
        axes.margins(x=0.01)
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, fontsize=8.5)
        _mark(axes, result)
    return svg(figure, "Recorded and replayed commands")


def _voltages(result: ReplayResult) -> tuple[Floats, Floats, Floats]:
    """Run times (n,), recorded and replayed commands (n, 2) of the steps in control; NaN where nothing was sent."""
    known = [at for at, t_s in enumerate(result.step_s) if t_s == t_s]
    times_s = np.array([result.step_s[at] for at in known])
    both = [
        np.array([result.volts(payloads[at]) for at in known]).reshape(-1, 2)
        for payloads in (result.expected, result.replayed.payloads)
    ]
    return times_s, both[0], both[1]


def _mark(axes: Axes, result: ReplayResult) -> None:
    """The first difference, and first reports of alarms: recorded ones dashed."""
    first = None if result.comparison is None else result.comparison.first
    if first is not None and first.t_s is not None:
        axes.axvline(first.t_s, color=RED, lw=1.1)
    for findings, dashes in ((result.recorded_alarms or (), (4, 3)), (result.replayed_alarms, ())):
        for one in findings:
            if one.detected_s is not None:
                axes.axvline(one.detected_s, color=INK, lw=0.8, alpha=0.5, dashes=dashes)


def _said(findings: tuple[Finding, ...], at: int) -> str:
    return in_words(findings[at]) if at < len(findings) else ""
