"""Figures of an identification's report as SVG text: records and predictions, residuals, and intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from hil.core.identification.improvement import row_noise_V
from hil.core.identification.parameters import RigModel
from hil.core.identification.result import FittedParameter, Prediction
from hil.review.identification_words import half_width, number
from hil.review.run_figures import BLUE, GREY, INK, ORANGE, PALE, RED, panels, svg, thin

Floats = NDArray[np.float64]
Group = Sequence[FittedParameter]

PALE_ORANGE = "#f0d3c4"
COLORS, PALES = (BLUE, ORANGE, BLUE, ORANGE), (PALE, PALE_ORANGE, PALE, PALE_ORANGE)
MAX_LAG_S, LAGS = 60.0, 240
WIDE_IN, MAX_POINTS = 11.8, 3000
LOWER, UPPER = (0, 1), (2, 3)


@dataclass(frozen=True, eq=False)
class _Placed:
    """A record on the common time axis of all records, one after the other. time_s : (n,). points : of a curve."""

    prediction: Prediction
    time_s: Floats
    points: int


def readings(predictions: Sequence[Prediction]) -> str:
    """Readings of the sensors and their prediction, lower and upper tanks, over the pumps' voltages, of all records."""
    placed = _placed(predictions)
    figure, rows = _wide_panels([1.0, 1.0, 0.7])
    for axes, tanks in zip(rows, (LOWER, UPPER), strict=False):
        for tank in tanks:
            _draw(axes, placed, lambda one, tank=tank: one.reading_V[:, tank], _measured(tank))  # type: ignore[misc]
            _draw(axes, placed, lambda one, tank=tank: one.predicted_V[:, tank], _predicted(tank))  # type: ignore[misc]
        axes.set_ylabel("reading [V]")
    for pump, color in enumerate((BLUE, ORANGE)):
        look = {"color": color, "lw": 1.0, "drawstyle": "steps-post", "label": f"pump {pump + 1}"}
        _draw(rows[2], placed, lambda one, pump=pump: one.voltage_V[:, pump], look)  # type: ignore[misc]
    rows[2].set_ylabel("voltage [V]")
    _finish(rows, placed)
    return svg(figure, "Readings and prediction")


def levels(predictions: Sequence[Prediction], model: RigModel) -> str:
    """Levels: what the identified sensors make of the readings, and the prediction."""
    placed = _placed(predictions)
    figure, rows = _wide_panels([1.0, 1.0])
    for axes, tanks in zip(rows, (LOWER, UPPER), strict=True):
        for tank in tanks:
            gain, offset_V = model.sensors.gain_V_cm[tank], model.sensors.offset_V[tank]
            _draw(
                axes,
                placed,
                lambda one, i=tank, g=gain, o=offset_V: (one.reading_V[:, i] - o) / g,  # type: ignore[misc]
                _measured(tank),
            )
            _draw(axes, placed, lambda one, tank=tank: one.level_cm[:, tank], _predicted(tank))  # type: ignore[misc]
        axes.set_ylabel("level [cm]")
    _finish(rows, placed)
    return svg(figure, "Levels and prediction")


def residuals(predictions: Sequence[Prediction]) -> str:
    """Reading less prediction, a panel for each sensor, with the band of 95 % of its noise."""
    placed = _placed(predictions)
    figure, rows = _wide_panels([0.7] * 4)
    for tank, axes in enumerate(rows):
        look = {"color": BLUE, "lw": 0.6}
        _draw(axes, placed, lambda one, tank=tank: one.residuals[:, tank] * 1e3, look)  # type: ignore[misc]
        noise_V = row_noise_V(predictions, tank)
        band_mV = 1.96e3 * noise_V if np.isfinite(noise_V) else 0.0
        axes.axhspan(-band_mV, band_mV, color=ORANGE, alpha=0.2, lw=0, zorder=3)
        is_empty = not any(np.isfinite(one.residuals[:, tank]).any() for one in predictions)
        _sensor_panel(axes, tank, "[mV]", is_empty=is_empty)
    _finish(rows, placed)
    return svg(figure, "Residuals")


def _placed(predictions: Sequence[Prediction]) -> list[_Placed]:
    """Records one after the other, with a little time between them."""
    durations = [float(one.time_s[-1] - one.time_s[0]) for one in predictions]
    gap_s, begin_s = 0.01 * sum(durations), 0.0
    found = []
    for one, duration_s in zip(predictions, durations, strict=True):
        points = max(150, round(MAX_POINTS * duration_s / sum(durations)))
        found.append(_Placed(one, one.time_s - one.time_s[0] + begin_s, points))
        begin_s += duration_s + gap_s
    return found


def _draw(axes: Axes, placed: Sequence[_Placed], of: Callable[[Prediction], Floats], look: Mapping[str, Any]) -> None:
    """One curve over all records, interrupted between them."""
    for place, one in enumerate(placed):
        mine = dict(look) if place == 0 else {**look, "label": None}
        axes.plot(*thin(one.time_s, of(one.prediction), one.points), **mine)


def _measured(tank: int) -> Mapping[str, Any]:
    return {"color": PALES[tank], "lw": 2.4, "label": f"tank {tank + 1}, measured"}


def _predicted(tank: int) -> Mapping[str, Any]:
    return {"color": COLORS[tank], "lw": 1.0, "label": "predicted"}


def _finish(rows: Sequence[Axes], placed: Sequence[_Placed]) -> None:
    """Shade what was held out, name the records, and label the time."""
    for axes in rows:
        axes.margins(x=0.01)
        if axes.get_legend_handles_labels()[0]:
            _legend(axes)
        for one in placed:
            if one.prediction.is_held_out:
                axes.axvspan(one.time_s[0], one.time_s[-1], color=GREY, alpha=0.12, lw=0)
    for one in placed:
        rows[-1].annotate(
            plain(one.prediction.name), (one.time_s[0], 0.0), xycoords=("data", "axes fraction"), xytext=(1, 3),
            textcoords="offset points", fontsize=7.0, color=GREY,
        )  # fmt: skip
    rows[-1].set_xlabel("time, records one after the other [s]")


def plain(name: str) -> str:
    """A name for a figure, in which a pair of $ would begin a formula; what can't be printed is replaced."""
    shown = "".join(letter if letter.isprintable() else "?" for letter in name)
    return shown.replace("$", r"\$")


def _wide_panels(heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Panels as wide as the page. heights : of each, as a share."""
    figure = Figure(figsize=(WIDE_IN, 0.5 + 2.1 * sum(heights)), layout="constrained")
    grid = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=list(heights))
    return figure, list(grid[:, 0])


def held_out(before: Prediction, after: Prediction) -> str:
    """A held-out record: readings, and what the old file and the identified one predict. A panel for each sensor."""
    figure, rows = panels(4)
    for tank, axes in enumerate(rows):
        axes.plot(*thin(after.time_s, after.reading_V[:, tank]), color=PALE, lw=2.6, label="measured")
        axes.plot(*thin(before.time_s, before.predicted_V[:, tank]), color=ORANGE, lw=1.2, ls="--", label="old file")
        axes.plot(*thin(after.time_s, after.predicted_V[:, tank]), color=BLUE, lw=1.1, label="identified")
        _sensor_panel(axes, tank, "reading [V]", is_empty=not np.isfinite(after.reading_V[:, tank]).any())
    _legend(rows[0])
    rows[-1].set_xlabel("time [s]")
    return svg(figure, "Prediction of a held-out record")


def autocorrelation(predictions: Sequence[Prediction]) -> str:
    """Autocorrelation of the residuals of all records together, with the band of 95 % for white noise."""
    figure, rows = panels(2)
    for axes, tanks in zip(rows, (LOWER, UPPER), strict=True):
        for tank in tanks:
            lag_s, share, count = _correlation(predictions, tank)
            if count:
                axes.plot(lag_s[1:], share[1:], color=COLORS[tank], lw=1.2, label=f"sensor {tank + 1}")
                bound = 1.96 / np.sqrt(count)
                axes.axhspan(-bound, bound, color=GREY, alpha=0.2, lw=0)
        axes.set_ylim(min(-0.2, axes.get_ylim()[0]), max(0.4, axes.get_ylim()[1]))
        axes.set_ylabel("correlation [1]")
        _legend(axes)
    rows[-1].set_xlabel("lag [s]")
    return svg(figure, "Autocorrelation of the residuals")


def intervals(parameters: Sequence[FittedParameter]) -> str:
    """Values and 95 % intervals in % of the old value, of those whose old value is not zero; "" if there are none.

    The times, which are known less well, have a panel of their own.
    """
    shown = [one for one in parameters if one.was != 0.0 and one.status != "fixed"]
    groups = [[one for one in shown if (one.unit == "s") == is_time] for is_time in (False, True)]
    figure, rows = _interval_panels([group for group in groups if group])
    for axes, group in rows:
        for place, one in enumerate(group):
            scale = 100.0 / one.was
            half = half_width(one) * abs(scale)
            text = f"{one.value * scale - 100.0:+.2f} % ± {half:.2g} %"
            _interval(axes, place, [one.value * scale, one.low * scale, one.high * scale], one.status, text)
        _name_rows(axes, [one.name for one in group], 100.0, "% of the old value")
    return svg(figure, "Intervals beside old values") if rows else ""


def new_values(parameters: Sequence[FittedParameter]) -> str:
    """The same, in their units, of parameters that were zero in the old file: a panel for each unit."""
    shown = [one for one in parameters if one.was == 0.0 and one.status != "fixed"]
    units = list(dict.fromkeys(one.unit for one in shown))
    figure, rows = _interval_panels([[one for one in shown if one.unit == unit] for unit in units])
    for (axes, group), unit in zip(rows, units, strict=True):
        for place, one in enumerate(group):
            half = half_width(one)
            text = f"{number(one.value, half)} ± {number(half, half)}"
            _interval(axes, place, [one.value, one.low, one.high], one.status, text)
        _name_rows(axes, [one.name for one in group], 0.0, "share [1]" if unit == "1" else f"[{unit}]")
    return svg(figure, "New values") if rows else ""


def _interval_panels(groups: Sequence[Group]) -> tuple[Figure, list[tuple[Axes, Group]]]:
    """A panel for each group, as high as it has rows."""
    counts = [len(group) for group in groups]
    figure = Figure(figsize=(5.8, 0.2 + 0.62 * len(counts) + 0.24 * sum(counts)), layout="constrained")
    if not groups:
        return figure, []
    grid = figure.subplots(len(counts), 1, squeeze=False, height_ratios=[0.6 + count for count in counts])
    return figure, list(zip(grid[:, 0], groups, strict=True))


def _interval(axes: Axes, place: int, value_and_ends: Sequence[float], status: str, text: str) -> None:
    value, low, high = value_and_ends
    if status != "identified":
        axes.axhline(place, color=RED, lw=1.4, ls=(0, (2, 2)), alpha=0.7)
        axes.plot([value], [place], marker="x", color=RED, ms=5, ls="none")
        text = "not identifiable"
    else:
        axes.plot([low, high], [place, place], color=BLUE, lw=2.4, solid_capstyle="butt")
        axes.plot([value], [place], marker="o", color=BLUE, ms=4.0, ls="none")
    axes.annotate(
        text, (1.01, place), xycoords=("axes fraction", "data"), va="center", fontsize=8.0,
        color=INK if status == "identified" else RED, annotation_clip=False,
    )  # fmt: skip


def _name_rows(axes: Axes, names: Sequence[str], reference: float, quantity: str) -> None:
    axes.axvline(reference, color=INK, lw=1.0)
    axes.margins(x=0.08)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlabel(quantity)
    axes.xaxis.set_major_locator(MaxNLocator(6))


def _sensor_panel(axes: Axes, tank: int, quantity: str, *, is_empty: bool) -> None:
    axes.set_title(f"sensor {tank + 1}", fontsize=9.5, loc="right", color=INK)
    axes.set_ylabel(quantity)
    axes.margins(x=0.01)
    if is_empty:
        axes.annotate("no readings", (0.5, 0.5), xycoords="axes fraction", ha="center", color=GREY)


def _legend(axes: Axes) -> None:
    handles, names = axes.get_legend_handles_labels()
    if handles:
        axes.legend(
            handles, names, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(handles), frameon=False,
            fontsize=8.0, handlelength=1.4, columnspacing=1.1, borderaxespad=0.1,
        )  # fmt: skip


def _correlation(predictions: Sequence[Prediction], tank: int) -> tuple[Floats, Floats, int]:
    """Lags, autocorrelation, and the number of residuals that it is from; missing residuals count as none."""
    step_s = float(np.median(np.concatenate([np.diff(one.time_s) for one in predictions])))
    most = max(1, ceil(MAX_LAG_S / step_s))
    lags = np.unique(np.round(np.linspace(0, most, min(most, LAGS) + 1)).astype(int))
    sums, count = np.zeros(len(lags)), 0
    for one in predictions:
        residual = one.residuals[:, tank]
        known = np.isfinite(residual)
        if not known.any():
            continue
        centred = np.where(known, residual - np.mean(residual[known]), 0.0)
        count += int(known.sum())
        sums += [float(centred[: len(centred) - lag] @ centred[lag:]) if lag < len(centred) else 0.0 for lag in lags]
    share = sums / sums[0] if sums[0] > 0.0 else sums
    return lags * step_s, share, count
