"""The layout in which a recording opens in the Rerun viewer."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from hil.edge.record.rerun_log import TIMELINE


def blueprint(duration_s: float | None = None) -> rrb.Blueprint:
    """Tabs: overview (opens first), control, bench, run card.

    duration_s : length of the run as planned; the plots then open on the whole of it. None: around the cursor.
    """
    layout = _Layout(duration_s)
    card = rrb.TextDocumentView(origin="/card", name="Run card")
    return rrb.Blueprint(
        rrb.Tabs(layout.overview(), layout.control(), layout.bench(), card, active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        auto_views=False,
    )


class _Layout:
    """Makes the views with one time axis."""

    def __init__(self, duration_s: float | None) -> None:
        self._axis = None
        if duration_s is not None:
            span = rr.TimeRange(
                start=rr.TimeRangeBoundary.absolute(seconds=0.0), end=rr.TimeRangeBoundary.absolute(seconds=duration_s)
            )
            self._axis = rrb.TimeAxis(view_range=span)

    def plot(
        self,
        name: str,
        *entities: str,
        range_: tuple[float, float] | None = None,
        corner: rrb.Corner2D = rrb.Corner2D.LeftTop,
    ) -> rrb.TimeSeriesView:
        """A plot of the given entities' series."""
        return rrb.TimeSeriesView(
            origin="/",
            contents=[f"/{entity}" for entity in entities],
            name=name,
            axis_x=self._axis,
            axis_y=None if range_ is None else rrb.ScalarAxis(range=range_),
            plot_legend=rrb.PlotLegend(corner=corner),
        )

    def overview(self) -> rrb.Vertical:
        """Levels, pump voltages, effectiveness, states and log on one sheet."""
        levels = [self.plot(f"Tank {tank} level [V]", f"levels/tank{tank}") for tank in (1, 2, 3, 4)]
        pumps = [self.plot(f"Pump {pump} voltage [V]", f"pumps/pump{pump}") for pump in (1, 2)]
        effectiveness = self.plot(
            "Pump effectiveness [1]", "pumps/effectiveness", range_=(0.0, 1.1), corner=rrb.Corner2D.LeftBottom
        )
        states = rrb.StateTimelineView(
            origin="/states", contents=["/states/**"], name="Mode and faults", time_view=self._axis
        )
        log = rrb.TextLogView(origin="/log", name="Log")
        return rrb.Vertical(
            rrb.Horizontal(levels[0], levels[1]),
            rrb.Horizontal(levels[2], levels[3], effectiveness),
            rrb.Horizontal(*pumps),
            rrb.Horizontal(states, log),
            row_shares=[2.6, 2, 2.2, 2.5],
            name="Overview",
        )

    def control(self) -> rrb.Vertical:
        """What the control law works with."""
        return rrb.Vertical(
            rrb.Horizontal(
                self.plot("Gains of pump 1 [V/cm, 1/s]", "control/gain_pump1"),
                self.plot("Gains of pump 2 [V/cm, 1/s]", "control/gain_pump2"),
            ),
            rrb.Horizontal(
                self.plot("Integrals [V s]", "control/integral"), self.plot("IAE so far [V s]", "control/iae")
            ),
            name="Control",
        )

    def bench(self) -> rrb.Vertical:
        """How the loop and the bus fare."""
        return rrb.Vertical(
            rrb.Horizontal(
                self.plot("Age of what was heard [s]", "bench/age"), self.plot("Lateness [s]", "bench/lateness")
            ),
            rrb.Horizontal(
                self.plot("Frames accepted", "bench/accepted"), self.plot("Rejected and skipped", "bench/trouble")
            ),
            self.plot("Mode, as its number", "bench/mode", range_=(-0.5, 6.5)),
            row_shares=[2, 2, 1],
            name="Bench",
        )
