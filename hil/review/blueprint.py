"""The layout in which a recording opens in the Rerun viewer."""

from __future__ import annotations

import rerun.blueprint as rrb

from hil.edge.rerun_log import TIMELINE


def blueprint() -> rrb.Blueprint:
    """Tabs: overview (opens first), control, bench, run card."""
    tabs = rrb.Tabs(
        _overview(), _control(), _bench(), rrb.TextDocumentView(origin="/card", name="Run card"), active_tab=0
    )
    return rrb.Blueprint(
        tabs,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        auto_views=False,
    )


def _plot(name: str, *entities: str, range_: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
    axis = None if range_ is None else rrb.ScalarAxis(range=range_)
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"/{entity}" for entity in entities],
        name=name,
        axis_y=axis,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightBottom),
    )


def _overview() -> rrb.Vertical:
    levels = [_plot(f"Tank {tank} level [V]", f"levels/tank{tank}") for tank in (1, 2, 3, 4)]
    pumps = [_plot(f"Pump {pump} voltage [V]", f"pumps/pump{pump}") for pump in (1, 2)]
    effectiveness = _plot("Pump effectiveness [1]", "pumps/effectiveness", range_=(0.0, 1.1))
    states = rrb.StateTimelineView(origin="/states", contents=["/states/**"], name="Mode and faults")
    log = rrb.TextLogView(origin="/log", name="Log")
    return rrb.Vertical(
        rrb.Horizontal(levels[0], levels[1]),
        rrb.Horizontal(levels[2], levels[3], effectiveness),
        rrb.Horizontal(*pumps),
        rrb.Horizontal(states, log),
        row_shares=[3, 2, 2, 2],
        name="Overview",
    )


def _control() -> rrb.Vertical:
    return rrb.Vertical(
        rrb.Horizontal(
            _plot("Gains of pump 1 [V/cm, 1/s]", "control/gain_pump1"),
            _plot("Gains of pump 2 [V/cm, 1/s]", "control/gain_pump2"),
        ),
        rrb.Horizontal(_plot("Integrals [V s]", "control/integral"), _plot("IAE so far [V s]", "control/iae")),
        name="Control",
    )


def _bench() -> rrb.Vertical:
    return rrb.Vertical(
        rrb.Horizontal(_plot("Age of what was heard [s]", "bench/age"), _plot("Lateness [s]", "bench/lateness")),
        rrb.Horizontal(_plot("Frames accepted", "bench/accepted"), _plot("Rejected and skipped", "bench/trouble")),
        _plot("Mode, as its number", "bench/mode", range_=(-0.5, 5.5)),
        row_shares=[2, 2, 1],
        name="Bench",
    )
