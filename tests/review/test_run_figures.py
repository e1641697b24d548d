"""What the report's figures draw, taken from the figure rather than from its picture."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.figure import Figure

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
