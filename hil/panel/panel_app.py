"""The panel's application: draws what the run says, and turns keys and clicks into requests."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Horizontal, Vertical
from textual.widgets import Static

from hil.panel.alarm_widget import AlarmPage
from hil.panel.console_page import ConsolePage
from hil.panel.dialogs import HelpDialog
from hil.panel.drawn_pages import EventPage, TankWidget, TrendPage
from hil.panel.emulator_client import EmulatorClient
from hil.panel.operator_app import OperatorApp
from hil.panel.run_connection import RunConnection
from hil.panel.run_messages import ShownEvent, ShownRun, ShownState
from hil.panel.run_record_end import end_of_run
from hil.panel.status_lines import status_lines

REFRESH_S = 0.5
ALARM_S = 2
HERE_S = 10.0
"""At most so often an attended run is told that keys are pressed; more often if it asks for an operator sooner."""
BREAKPOINT = 120
"""Columns from which all pages are shown at once."""
PAGES = {
    "1": ("alarm-page", "Alarms"),
    "2": ("trend-page", "Trends"),
    "3": ("event-page", "Events"),
    "4": ("console-page", "Emul"),
}
KEYS = (
    ("r", "reference", "Ref", "References"),
    ("m", "manual", "Man", "Manual"),
    ("a", "auto", "Auto", "Auto"),
    ("h", "hold", "Hold", "Hold"),
    ("b", "bypass", "Byp", "Bypass"),
    ("c", "clear", "Clear", "Clear trip"),
    ("n", "note", "Note", "Note"),
    ("p", "mark", "Mark", "Mark"),
    ("?", "help", "Help", "Help"),
    ("q", "quit", "", "Leave"),
)
"""Key, action, and its word in a small and in a large window; a key without a word is left out."""
ALARM_KEYS = (("k", "ack"), ("K", "ack_all"), ("s", "shelve"))


class PanelApp(OperatorApp):
    """The panel of one run.

    find : path of the run's socket; raises HilError while there is none. clock : seconds, monotonic. emulator : for its
    console. parent : the run's process if that has started the panel; the panel ends when it does.
    """

    CSS_PATH = "panel.tcss"
    TITLE = "hil panel"
    ENABLE_COMMAND_PALETTE = False
    HORIZONTAL_BREAKPOINTS = [(0, "-small"), (BREAKPOINT, "-large")]  # noqa: RUF012 - as in App
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+x,f8", "stop_run", "Stop the run", priority=True),
        Binding("ctrl+q", "quit", "Leave", priority=True),
        Binding("ctrl+c", "say_keys", "", priority=True, show=False),
        *(Binding("question_mark" if key == "?" else key, action, word) for key, action, _, word in KEYS),
        *(Binding(key, action) for key, action in ALARM_KEYS),
        *(Binding(key, f"page('{page}')", word) for key, (page, word) in PAGES.items()),
    ]

    def __init__(
        self,
        find: Callable[[], Path],
        clock: Callable[[], float] = time.monotonic,
        emulator: EmulatorClient | None = None,
        parent: int | None = None,
    ) -> None:
        super().__init__()
        self.connection = RunConnection(find, self)
        self._clock, self._emulator, self._starter = clock, emulator, parent
        self._shown_lines = Text()
        self._here_at_s = -math.inf

    def compose(self) -> ComposeResult:
        """Status, tanks, pages, the last answer, keys."""
        yield Static(id="status")
        with Horizontal(id="body"):
            yield TankWidget(self.view, id="tanks")
            with Vertical(id="side"):
                yield Static(self._tabs("alarm-page"), id="tabs")
                with Container(id="pages"):
                    yield TrendPage(self.view, id="trend-page", classes="page")
                    yield AlarmPage(id="alarm-page", classes="page -chosen")
                    yield EventPage(self.view, id="event-page", classes="page")
                    if self._emulator is not None:
                        yield ConsolePage(self._emulator, id="console-page", classes="page")
        yield Static(id="message", markup=False)
        with Horizontal(id="bottom"):
            yield Static("[@click=app.stop_run] ■ STOP Ctrl+X [/]", id="stop")
            yield Static(id="keys")

    async def on_event(self, event: events.Event) -> None:
        """Whoever presses a key, clicks or pastes is at the bench; all else is textual's."""
        if isinstance(event, (events.Key, events.MouseDown, events.Paste)) and not event.is_forwarded:
            self._say_here()
        await super().on_event(event)

    def _say_here(self) -> None:
        """Tell a run that asks for an operator; any other run would only get a longer record."""
        attended_s, now_s = self.view.run.attended_s, self._clock()
        if not attended_s > 0.0 or not self.connection.is_open:
            return
        if now_s - self._here_at_s >= min(HERE_S, attended_s / 3.0):
            self._here_at_s = now_s
            self.run_worker(self.connection.request({"do": "here"}), group="here")

    def on_mount(self) -> None:
        """Begin to follow the run."""
        self.run_worker(self.connection.follow(), name="connection", exit_on_error=True)
        self.set_interval(REFRESH_S, self.refresh_status)
        self.refresh_status()

    def on_resize(self, event: events.Resize) -> None:
        """The status lines have the width of the screen, and the keys the words that fit."""
        is_large = event.size.width >= BREAKPOINT
        words = [(key, action, large if is_large else small) for key, action, small, large in KEYS]
        shown = [f"[@click=app.{action}][b #ffd75f]{key}[/] {word}[/]" for key, action, word in words if word]
        self.screen_stack[0].query_one("#keys", Static).update(" " + ("  " if is_large else " ").join(shown))
        self.refresh_status()

    # what the run says

    def on_run(self, run: ShownRun) -> None:
        """The connection is there. What was being asked of the run before is not asked of another one."""
        said = "? shows keys and signs."
        if self.view.is_another(run) and self.close_dialogs():
            said = f"Another run: {run.scenario} in {run.folder}. The dialog was closed."
        self.view.connected(run)
        self.process.note(run.pid)
        self.screen_stack[0].query_one(EventPage).on_resize()
        self.say(said)
        self.refresh_status()

    def on_state(self, state: ShownState) -> None:
        """Draw a state."""
        has_grown = self.view.received(state, self._clock())
        screen = self.screen_stack[0]
        screen.query_one(AlarmPage).show(state.alarms)
        screen.query_one("#tanks").refresh()
        if has_grown:
            screen.query_one("#trend-page").refresh()
        self.refresh_status()

    def on_run_event(self, event: ShownEvent) -> None:
        """Write an event."""
        self.view.events.append(event)
        if event.code == "end":
            self.view.ended = event.text
            self.say(f"Run ended: {event.text}. Waiting for the next run; q leaves.")
        self.screen_stack[0].query_one(EventPage).add(event)

    def on_lost(self, reason: str) -> None:
        """Say so; and how the run ended, when its record has it."""
        if reason != self.view.lost and not self.view.ended:
            alive = " The run goes on, Ctrl+X stops it." if self.process.is_alive else ""
            self.say(f"{reason}.{alive} The panel connects as soon as it can.")
        self.view.lost = reason
        if not self.view.ended and self.view.run.folder and not self.process.is_alive:
            self.view.ended = end_of_run(Path(self.view.run.folder))
            if self.view.ended:
                self.say(f"Run ended: {self.view.ended}. Waiting for the next run; q leaves.")
        self.refresh_status()

    def refresh_status(self) -> None:
        """Draw the two lines at the top, and dim what is old."""
        if self._starter is not None and os.getppid() != self._starter:
            signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # the terminal is the shell's again
            signal.alarm(ALARM_S)  # ends this process if its terminal is gone, too
            self.exit(
                return_code=1, message="hil panel: the run's process is gone; the pump node goes to 0 V by itself"
            )
            return
        if not self.screen_stack:  # the panel closes: its screens are gone before its timers
            return
        screen = self.screen_stack[0]
        now_s = self._clock()
        screen.set_class(self.view.is_old(now_s), "-old")
        lines = status_lines(self.view, self.size.width, now_s)
        for status in screen.query("#status").results(Static):
            if lines != self._shown_lines:  # a terminal far away is sent nothing that it has already
                status.update(lines)
                self._shown_lines = lines

    def action_help(self) -> None:
        """Keys and signs."""
        self.push_screen(HelpDialog())

    def action_page(self, chosen: str) -> None:
        """Show a page; in a large window all are there, but the console takes the place of the events."""
        if not self.query(f"#{chosen}"):
            self.say(
                "The emulator's console: start the panel with --emulator PATH, the path of firmware-sim's --control."
            )
            return
        for page in self.query(".page"):
            page.set_class(page.id == chosen, "-chosen")
        self.screen.set_class(chosen == "console-page", "-console")
        self.query_one("#tabs", Static).update(self._tabs(chosen))
        for first in list(self.query(f"#{chosen} OptionList, #{chosen} RichLog"))[:1]:
            first.focus()

    def _tabs(self, chosen: str) -> str:
        tabs = []
        for key, (page, word) in PAGES.items():
            if page == "console-page" and self._emulator is None:
                continue
            style = "reverse" if page == chosen else "not reverse"
            tabs.append(f"[@click=app.page('{page}')][{style}]{key} {word}[/][/]")
        return " ".join(tabs)
