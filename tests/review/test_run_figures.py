"""Properties of the report's figures that no picture is compared for."""

from hil.review.run_figures import panels


def test_the_plots_of_one_figure_share_the_run_time() -> None:
    _, plots = panels(3)
    plots[0].set_xlim(100.0, 200.0)
    assert [plot.get_xlim() for plot in plots] == [(100.0, 200.0)] * 3
