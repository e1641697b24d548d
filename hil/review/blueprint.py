"""The layout in which a recording opens in the Rerun viewer. Its plots are those of the recorded signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import rerun as rr
import rerun.blueprint as rrb

from hil.edge.record.manifest import RunMode
from hil.edge.record.picture_layout import BACKGROUND, BOUNDS_X, BOUNDS_Y, ROOM
from hil.edge.record.rerun_log import TIMELINE, Series, series
from hil.edge.record.signals import WHITE


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot's title, the range of its values (None: chosen by the viewer), and the corner of its legend."""

    title: str
    range_: tuple[float, float] | None = None
    corner: rrb.Corner2D = rrb.Corner2D.LeftTop


PLOTS: dict[str, Plot] = {
    **{f"levels/tank{tank}": Plot(f"Tank {tank} level [V]", corner=rrb.Corner2D.RightBottom) for tank in (1, 2, 3, 4)},
    **{f"pumps/pump{pump}": Plot(f"Pump {pump} voltage [V]") for pump in (1, 2)},
    "pumps/effectiveness": Plot("Pump effectiveness [1]", (0.0, 2.1), rrb.Corner2D.LeftBottom),
    "diagnosis/test": Plot("Test: largest ratio and limit [1]", (0.0, 100.0)),
    "control/gain_pump1": Plot("Gains of pump 1 [V/cm, 1/s]"),
    "control/gain_pump2": Plot("Gains of pump 2 [V/cm, 1/s]"),
    "control/integral": Plot("Integrals [V s]"),
    "control/iae": Plot("IAE so far [V s]"),
    "control/probe": Plot("Probe: part of the pump voltages [V]"),
    "bench/process_noise": Plot("Process noise, learned [cm/√s]"),
    "bench/age": Plot("Age of frames [s]"),
    "bench/lateness": Plot("Lateness [s]"),
    "bench/accepted": Plot("Frames accepted"),
    "bench/trouble": Plot("Rejected and skipped"),
    "bench/latency": Plot("Newest frame to command [s]"),
    "bench/recorder_queue": Plot("Entries waiting for the recorder"),
    "bench/mode": Plot("Mode, as its number", (-0.5, 6.5)),
}
"""Entity -> plot, in the order in which they are shown. An entity that is not listed comes last, named by itself."""

BEFORE_S, AFTER_S = 30.0, 60.0
"""What the plots show around a moment at which a recording is opened."""

FOLLOWED_S = 120.0
"""What the plots of a run that goes on show."""

SHARED_AXIS = "view/5c0dca6a-e63f-9cf7-f657-2602590474cc/TimeAxis"
"""Where the viewer keeps the time range that linked views share: `GLOBAL_VIEW_ID` of Rerun (re_viewer_context). The SDK
links views, but has no place for the range with which they open."""

PLOT_BACKGROUND = rrb.archetypes.PlotBackground(color=list(BACKGROUND), show_grid=True)
"""Dark in every theme of the viewer: references are white."""

OVERVIEW = ("levels", "pumps")
CONTROL = ("control", "law")
DIAGNOSIS = "diagnosis"


def blueprint(
    mode: RunMode,
    duration_s: float | None = None,
    shown: Sequence[str] = (),
    *,
    has_picture: bool = False,
    tab: str = "Overview",
    at_s: float | None = None,
) -> rrb.Blueprint:
    """Tabs: overview (opens first), tanks, control, bench, run card. Entities of any other name are in bench.

    mode, shown : of the run, which decide the plots. duration_s : length of the run as planned; the plots then open
    on the whole of it. None: around the cursor. has_picture : whether the recording has the picture of the tanks.
    tab : the one that is open at first, by name. at_s : a moment; the plots then open around it. A layout can't
    place the time cursor.
    """
    begin_s, end_s = (0.0, duration_s) if at_s is None else (at_s - BEFORE_S, at_s + AFTER_S)
    layout = _Layout(series(mode, shown), begin_s, end_s)
    return _tabs(layout, tab, has_picture, rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"))


def live_blueprint(mode: RunMode, shown: Sequence[str] = (), *, has_picture: bool = False) -> rrb.Blueprint:
    """The layout of a run that goes on: it follows the newest step, with the plots of the last minutes."""
    layout = _Layout(series(mode, shown), 0.0, None)
    layout.follow()
    return _tabs(
        layout, "Tanks", has_picture, rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following")
    )


def _tabs(layout: _Layout, tab: str, has_picture: bool, time_panel: rrb.TimePanel) -> rrb.Blueprint:
    card = rrb.TextDocumentView(origin="/card", name="Run card")
    tanks = [layout.tanks()] if has_picture else []
    sheets: list[rrb.Container | rrb.View] = [
        layout.overview(),
        *tanks,
        layout.diagnosis(),
        layout.control(),
        layout.bench(),
        card,
    ]
    opened = next((place for place, sheet in enumerate(sheets) if sheet.name == tab), 0)
    return LinkedBlueprint(
        layout.axis,
        rrb.Tabs(*sheets, active_tab=opened),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time_panel,
        auto_views=False,
    )


class LinkedBlueprint(rrb.Blueprint):
    """A layout whose plots share one time range: who zooms or moves one of them does so with all.

    axis : the range with which they open. The other arguments are those of `rrb.Blueprint`.
    """

    def __init__(self, axis: rrb.TimeAxis, *parts: rrb.BlueprintPart, auto_views: bool) -> None:
        super().__init__(*parts, auto_views=auto_views)
        self._shared = axis

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        super()._log_to_stream(stream)
        stream.log(SHARED_AXIS, self._shared)


class _Layout:
    """Makes the views with one time axis, from begin_s to end_s; end_s None: around the cursor."""

    def __init__(self, drawn: Sequence[Series], begin_s: float, end_s: float | None) -> None:
        names = [one.entity for one in drawn]
        self._entities = [entity for entity in PLOTS if entity in names]
        self._entities += [entity for entity in names if entity not in PLOTS]
        self._in_white = {
            one.entity for one in drawn if any(signal.curve and signal.curve.color == WHITE for signal in one.signals)
        }
        self.axis = linked_axis(None)
        if end_s is not None and isfinite(end_s):
            start, end = (rr.TimeRangeBoundary.absolute(seconds=at_s) for at_s in (begin_s, end_s))
            self.axis = linked_axis(rr.TimeRange(start=start, end=end))

    def follow(self) -> None:
        """Let the time axis end at the time cursor."""
        begin = rr.TimeRangeBoundary.cursor_relative(seconds=-FOLLOWED_S)
        self.axis = linked_axis(rr.TimeRange(start=begin, end=rr.TimeRangeBoundary.cursor_relative()))

    def overview(self) -> rrb.Vertical:
        """Levels, pump voltages, effectiveness, states and log on one sheet."""
        mine = [entity for entity in self._entities if _room(entity) in OVERVIEW]
        first = (
            ("levels/tank1", "levels/tank2"),
            ("levels/tank3", "levels/tank4", "pumps/effectiveness"),
            ("pumps/pump1", "pumps/pump2"),
        )
        shown = {entity for row in first for entity in row}
        more = _rows([entity for entity in mine if entity not in shown])
        states = rrb.StateTimelineView(
            origin="/states", contents=["/states/**"], name="Mode and faults", time_view=self.axis
        )
        log = rrb.TextLogView(origin="/log", name="Log")
        return rrb.Vertical(
            *(self._row(row) for row in (*first, *more)),
            rrb.Horizontal(states, log),
            row_shares=[2.6, 2, 2.2, *(2.0 for _ in more), 2.5],
            name="Overview",
        )

    def tanks(self) -> rrb.Horizontal:
        """The picture of the tanks, with the outputs, states and log beside it."""
        picture = rrb.Spatial2DView(
            origin=f"/{ROOM}",
            name="Tanks",
            background=list(BACKGROUND),
            visual_bounds=rrb.VisualBounds2D(x_range=list(BOUNDS_X), y_range=list(BOUNDS_Y)),
        )
        states = rrb.StateTimelineView(
            origin="/states", contents=["/states/**"], name="Mode and faults", time_view=self.axis
        )
        log = rrb.TextLogView(origin="/log", name="Log")
        plots = [self._plot(entity) for entity in ("levels/tank1", "levels/tank2")]
        beside = rrb.Vertical(*plots, states, log, row_shares=[2, 2, 2.2, 2.2])
        return rrb.Horizontal(picture, beside, column_shares=[3, 2], name="Tanks")

    def diagnosis(self) -> rrb.Vertical:
        """The test beside its limit, candidates, and what was found, each with a band of one standard deviation."""
        room = f"/{DIAGNOSIS}"
        candidates = rrb.StateTimelineView(
            origin=room, contents=[f"{room}/candidates", "/states/alarm"], name="Candidates", time_view=self.axis
        )
        sizes = self._band(f"{room}/sizes/**", "Sizes of faults, as reported", (0.0, 1.0))
        effectiveness = self._band(f"{room}/effectiveness/**", "Pump effectiveness [1], band as last reported")
        levels = [self._band(f"{room}/levels/tank{tank}", f"Tank {tank}: estimate [V]") for tank in (1, 2, 3, 4)]
        return rrb.Vertical(
            self._plot("diagnosis/test"),
            candidates,
            rrb.Horizontal(effectiveness, sizes),
            rrb.Horizontal(*levels),
            row_shares=[2.5, 1.6, 2.2, 2.2],
            name="Diagnosis",
        )

    def _band(self, contents: str, title: str, range_: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin="/",
            contents=[contents],
            name=title,
            axis_x=self.axis,
            axis_y=None if range_ is None else rrb.ScalarAxis(range=range_),
            background=PLOT_BACKGROUND,
        )

    def control(self) -> rrb.Grid:
        """What the control law works with."""
        return self._sheet("Control", [entity for entity in self._entities if _room(entity) in CONTROL])

    def bench(self) -> rrb.Grid:
        """Timing of the loop, frames on the bus, and all that has no sheet of its own."""
        return self._sheet("Bench", [e for e in self._entities if _room(e) not in (*OVERVIEW, *CONTROL, DIAGNOSIS)])

    def _sheet(self, name: str, entities: Sequence[str]) -> rrb.Grid:
        """Two plots a row, with as few parts as possible: each costs some 3 kB of every recording."""
        return rrb.Grid(*(self._plot(entity, is_plain=True) for entity in entities), grid_columns=2, name=name)

    def _row(self, entities: Sequence[str]) -> rrb.Horizontal:
        return rrb.Horizontal(*(self._plot(entity) for entity in entities))

    def _plot(self, entity: str, is_plain: bool = False) -> rrb.TimeSeriesView:
        """is_plain : with the viewer's own background, if it draws nothing in white, and place of the legend."""
        plot = PLOTS.get(entity, Plot(entity))
        is_dark = not is_plain or entity in self._in_white
        return rrb.TimeSeriesView(
            origin="/",
            contents=[f"/{entity}"],
            name=plot.title,
            axis_x=self.axis,
            axis_y=None if plot.range_ is None else rrb.ScalarAxis(range=plot.range_),
            plot_legend=None if is_plain else rrb.PlotLegend(corner=plot.corner),
            background=PLOT_BACKGROUND if is_dark else None,
        )


def linked_axis(span: rr.TimeRange | None) -> rrb.TimeAxis:
    """The time axis of each view; one that can't be linked opens on the same range."""
    return rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal, view_range=span)


def _room(entity: str) -> str:
    return entity.partition("/")[0]


def _rows(entities: Sequence[str]) -> list[Sequence[str]]:
    """Two plots a row."""
    return [entities[at : at + 2] for at in range(0, len(entities), 2)]
