"""Widgets that draw the run: the tanks, the trends, the event log."""

from __future__ import annotations

import math

from rich.text import Text
from textual.app import ComposeResult, RenderResult
from textual.containers import Vertical
from textual.widget import Widget
from textual.widgets import RichLog, Static

from hil.panel.run_messages import ShownEvent
from hil.panel.run_view import TREND_S, RunView
from hil.panel.tank_drawing import tank_picture
from hil.panel.trend_drawing import trend_chart

SEVERITY = {
    "ERROR": ("✖", "bold #ff8787"),
    "WARN": ("▲", "bold #ffd75f"),
    "INFO": ("·", "#9aa0a6"),
}


class TankWidget(Widget):
    """The four tanks and the pumps."""

    def __init__(self, view: RunView, *, id: str) -> None:  # noqa: A002 - textual's word
        super().__init__(id=id)
        self._view = view

    def render(self) -> RenderResult:
        """The picture for the room that there is."""
        size = self.content_size
        return tank_picture(self._view.run, self._view.state, size.width, size.height)


class TrendPage(Widget):
    """Charts of the last minutes, one below the other."""

    def __init__(self, view: RunView, *, id: str, classes: str) -> None:  # noqa: A002 - textual's word
        super().__init__(id=id, classes=classes)
        self._view = view

    def render(self) -> RenderResult:
        """Four charts in the room that there is."""
        size, trends = self.content_size, self._view.trends()
        height = max((size.height - 1) // len(trends), 2)
        charts = [trend_chart(trend, size.width, height, TREND_S) for trend in trends]
        minutes = f"last {TREND_S / 60:g} min   ┄ reference"
        return Text("\n").join([*charts, Text(minutes, "#9aa0a6")])


class EventPage(Vertical):
    """The event log; the newest line is the lowest."""

    def __init__(self, view: RunView, *, id: str, classes: str) -> None:  # noqa: A002 - textual's word
        super().__init__(id=id, classes=classes)
        self._view = view

    def compose(self) -> ComposeResult:
        """The log."""
        yield Static("Events", classes="page-title")
        yield RichLog(id="event-log", wrap=True, min_width=10, max_lines=500)

    def add(self, event: ShownEvent) -> None:
        """Write a line."""
        self.query_one(RichLog).write(event_line(event), expand=True)

    def on_resize(self) -> None:
        """Wrap all lines again."""
        log = self.query_one(RichLog)
        log.clear()
        for event in self._view.events:
            log.write(event_line(event), expand=True)


def event_line(event: ShownEvent) -> Text:
    """Time, severity, text."""
    sign, style = SEVERITY.get(event.severity, SEVERITY["INFO"])
    time = f"{event.t_s:7.1f} " if math.isfinite(event.t_s) else "      - "
    return Text.assemble((time, "#9aa0a6"), (f"{sign} ", style), event.text or event.code)
