"""Page of the recorded signals: the columns of ticks.csv and the curves in Rerun, from their table."""

from __future__ import annotations

from hil.edge.record.signals import markdown_table


def signals_page() -> str:
    """The whole page."""
    return (
        "# Recorded signals\n\nEach control step is one row of `ticks.csv` with these columns. `run.rrd` has the same "
        "values for the Rerun viewer.\n\n"
        "A level signal is k times the level, with one k for all four tanks: the gain of the sensors if they all have "
        "the same positive one, otherwise 0.5 V/cm. Without an offset it is the reading; `can.log` has the readings. "
        "The gains K belong to the *drive* of a pump, the voltage at which a pump without dead zone and curve would "
        "give the same flow; all other pump columns are voltages.\n\n" + markdown_table()
    )
