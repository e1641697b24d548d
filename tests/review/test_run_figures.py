"""What the report's figures draw, taken from the figure rather than from its picture."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from hil.review import run_figures
from hil.review.alarms import Injected


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are drawn, in place of their SVG text."""
    figures: list[Figure] = []

    def keep(figure: Figure, _title: str) -> str:
        figures.append(figure)
        return ""

    monkeypatch.setattr(run_figures, "svg", keep)
    return figures


def test_the_plots_of_one_figure_share_the_run_time() -> None:
    _, plots = run_figures.panels(3)
    plots[0].set_xlim(100.0, 200.0)
    assert [plot.get_xlim() for plot in plots] == [(100.0, 200.0)] * 3


def test_an_injected_fault_is_drawn_from_its_onset_to_the_end_of_the_run(drawn: list[Figure]) -> None:
    times_s = np.linspace(0.0, 500.0, 6)
    ticks = {"t_s": times_s, "theta1": np.ones(6), "theta2": np.ones(6)}
    faults = [Injected("pump_effectiveness", 1, left, at_s) for at_s, left in ((200.0, 0.4), (350.0, 0.7))]
    trace: Any = SimpleNamespace(ticks=ticks, injected={1: faults})
    run_figures.actuator_gains(trace)
    injected = drawn[0].axes[0].lines[0]
    assert injected.get_drawstyle() == "steps-post"
    assert list(cast(Any, injected.get_xdata())) == [0.0, 100.0, 200.0, 300.0, 400.0, 500.0]
    assert list(cast(Any, injected.get_ydata())) == [1.0, 1.0, 0.4, 0.4, 0.7, 0.7]


def test_a_pump_that_gives_more_than_its_file_fits_into_the_figure(drawn: list[Figure]) -> None:
    ticks = {"t_s": np.linspace(0.0, 500.0, 6), "theta1": np.full(6, 1.3), "theta2": np.ones(6)}
    trace: Any = SimpleNamespace(ticks=ticks, injected={})
    run_figures.actuator_gains(trace)
    assert drawn[0].axes[0].get_ylim()[1] > 1.3


def test_an_alarm_that_is_reported_again_is_marked_once() -> None:
    """A blockage that grew was marked 18 times, and the words lay on top of each other."""
    events: Any = [
        SimpleNamespace(t_s=t_s, code="alarm", data={"number": number})
        for t_s, number in ((10.0, 1), (15.0, 1), (20.0, 2), (25.0, 1))
    ]
    axes = Figure().subplots()
    run_figures._mark_alarms(axes, events)
    assert sorted(text.xy[0] for text in axes.texts if isinstance(text, Annotation)) == [10.0, 20.0]


def test_a_legend_with_long_names_takes_two_rows() -> None:
    """The names of two runs of one strategy once went beyond the right edge of the figure."""
    figure, (axes,) = run_figures.panels(1)
    for name in ("reference", "reference in force", "compared run, reconfiguration", "this run, reconfiguration"):
        axes.plot([0.0, 1.0], [0.0, 1.0], label=name)
    run_figures.legend(axes)
    figure.canvas.draw()
    legend = axes.get_legend()
    assert legend is not None
    assert legend.get_window_extent().x1 <= figure.bbox.x1
