"""Page of the recorded signals: the columns of ticks.csv and the curves in Rerun, from their table."""

from __future__ import annotations

from hil.edge.record.signals import markdown_table


def signals_page() -> str:
    """The whole page."""
    return (
        "# Recorded signals\n\nEach control step is one row of `ticks.csv` with these columns. `run.rrd` has the same "
        "values for the Rerun viewer.\n\n" + markdown_table()
    )
