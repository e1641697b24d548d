"""The panel's application: draws what the run says, and turns keys and clicks into requests."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Horizontal, Vertical
from textual.widgets import Static

from hil.panel.alarm_widget import AlarmPage
from hil.panel.dialogs import EntryDialog, HelpDialog, QuestionDialog
from hil.panel.drawn_pages import EventPage, TankWidget, TrendPage
from hil.panel.entry_forms import (
    EntryForm,
    EntryRequest,
    bypass_form,
    manual_form,
    mark_form,
    note_form,
    reference_form,
    shelve_form,
)
from hil.panel.run_connection import RunConnection
from hil.panel.run_messages import RunAnswer, ShownEvent, ShownRun, ShownState
from hil.panel.run_view import RunView
from hil.panel.status_lines import status_lines

REFRESH_S = 0.5
PAGES = {"1": ("alarm-page", "Alarms"), "2": ("trend-page", "Trends"), "3": ("event-page", "Events")}
KEYS = (
    ("r", "reference", "Ref"),
    ("m", "manual", "Man"),
    ("a", "auto", "Auto"),
    ("h", "hold", "Hold"),
    ("b", "bypass", "Byp"),
    ("c", "clear", "Clr"),
    ("n", "note", "Note"),
    ("p", "mark", "Mark"),
    ("k", "ack", "Ack"),
    ("s", "shelve", "Shlv"),
    ("?", "help", "Help"),
)


class PanelApp(App[None]):
    """The panel of one run. find : path of the run's socket, None while there is none. clock : seconds, monotonic."""

    CSS_PATH = "panel.tcss"
    TITLE = "hil panel"
    ENABLE_COMMAND_PALETTE = False
    HORIZONTAL_BREAKPOINTS = [(0, "-small"), (120, "-large")]  # noqa: RUF012 - as in App
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+x,f8", "stop_run", "Stop the run", priority=True),
        Binding("ctrl+q", "quit", "Leave", priority=True),
        Binding("ctrl+c", "say_keys", "", priority=True, show=False),
        Binding("q", "quit", "Leave"),
        *(Binding("question_mark" if key == "?" else key, action, word) for key, action, word in KEYS),
        Binding("K", "ack_all", "Acknowledge all"),
        *(Binding(key, f"page('{page}')", word) for key, (page, word) in PAGES.items()),
    ]

    def __init__(
        self,
        find: Callable[[], Path | None],
        clock: Callable[[], float] = time.monotonic,
        how_it_ended: Callable[[ShownRun], str] = lambda _run: "",
    ) -> None:
        super().__init__()
        self.view = RunView()
        self.connection = RunConnection(find, self)
        self._clock, self._how_it_ended = clock, how_it_ended
        self._is_stop_asked = False

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
        yield Static(id="message", markup=False)
        with Horizontal(id="bottom"):
            yield Static("[@click=app.stop_run] ■ STOP Ctrl+X [/]", id="stop")
            words = " ".join(f"[@click=app.{action}][b #ffd75f]{key}[/] {word}[/]" for key, action, word in KEYS)
            yield Static(f" {words}", id="keys")

    def on_mount(self) -> None:
        """Begin to follow the run."""
        self.run_worker(self.connection.follow(), name="connection", exit_on_error=True)
        self.set_interval(REFRESH_S, self.refresh_status)
        self.refresh_status()

    def on_resize(self) -> None:
        """The status lines have the width of the screen."""
        self.refresh_status()

    # what the run says

    def on_run(self, run: ShownRun) -> None:
        """The connection is there."""
        self.view.connected(run)
        self._is_stop_asked = False
        self.refresh_status()

    def on_state(self, state: ShownState) -> None:
        """Draw a state."""
        self.view.received(state, self._clock())
        screen = self.screen_stack[0]
        screen.query_one(AlarmPage).show(state.alarms)
        screen.query_one("#tanks").refresh()
        screen.query_one("#trend-page").refresh()
        self.refresh_status()

    def on_run_event(self, event: ShownEvent) -> None:
        """Write an event."""
        self.view.events.append(event)
        self.screen_stack[0].query_one(EventPage).add(event)

    def on_lost(self, reason: str) -> None:
        """Say so; when the run has ended, say how."""
        self.view.lost = reason
        ended = self._how_it_ended(self.view.run) if self.view.run.folder else ""
        if ended and not self.view.ended:
            self.say(f"The run has ended: {ended}. q leaves the panel; it connects to the next run by itself.")
        self.view.ended = ended
        self.refresh_status()

    def refresh_status(self) -> None:
        """Draw the two lines at the top, and dim what is old."""
        screen = self.screen_stack[0]
        now_s = self._clock()
        screen.set_class(self.view.is_old(now_s), "-old")
        for status in screen.query("#status").results(Static):
            status.update(status_lines(self.view, self.size.width, now_s))

    def say(self, text: str, kind: str = "") -> None:
        """Write the line above the keys. kind : accepted, refused or nothing."""
        for line in self.screen_stack[0].query("#message").results(Static):
            line.set_classes(f"-{kind}" if kind else "")
            line.update(f" {text}")

    # requests

    async def ask(self, request: EntryRequest) -> RunAnswer:
        """Send a request and show its answer."""
        answer = await self.connection.request(request.request)
        sign, kind = ("✓ accepted", "accepted") if answer.is_ok else ("✖ refused", "refused")
        self.say(f"{sign}: {answer.text}", kind)
        return answer

    def send(self, request: EntryRequest) -> None:
        """Ask first when the request moves water; then send it."""
        if not request.question:
            self.run_worker(self.ask(request), group="request")
            return

        def confirmed(is_yes: bool | None) -> None:
            if is_yes:
                self.run_worker(self.ask(request), group="request")
            else:
                self.say("Not sent.")

        self.push_screen(QuestionDialog(request.question), confirmed)

    def enter(self, form: EntryForm) -> None:
        """Open a form, and send what comes out of it."""

        def entered(request: EntryRequest | None) -> None:
            if request is not None:
                self.send(request)

        self.push_screen(EntryDialog(form), entered)

    async def action_stop_run(self) -> None:
        """Stop the run: no question, in every dialog."""
        while len(self.screen_stack) > 1:
            self.pop_screen()
        self.say("■ STOP is being sent …", "refused")
        answer = await self.connection.request({"do": "stop"})
        if answer.is_ok:
            self.say(f"■ STOP accepted: {answer.text or 'both pumps ramp down to 0 V'}", "accepted")
        else:
            self.say(f"✖ STOP failed: {answer.text}. Use the emergency switch of the pumps.", "refused")

    def action_say_keys(self) -> None:
        """Ctrl+C is no key of the panel: say which are."""
        self.say("Ctrl+X stops the run; Ctrl+Q leaves the panel, and the run goes on.")

    def action_reference(self) -> None:
        """New references."""
        self.enter(reference_form(self.view.run, self.view.state))

    def action_manual(self) -> None:
        """Voltages by hand."""
        self.enter(manual_form(self.view.run, self.view.state))

    def action_auto(self) -> None:
        """Back to the control law."""
        self.send(EntryRequest({"do": "auto"}, "Give the pumps back to the control law?"))

    def action_hold(self) -> None:
        """Hold the scenario's clock, or let it go on."""
        if self.view.state.is_held:
            self.send(EntryRequest({"do": "resume"}, "Resume the scenario? Its references and requests come again."))
        else:
            self.send(EntryRequest({"do": "hold"}))

    def action_bypass(self) -> None:
        """Leave an interlock out."""
        self.enter(bypass_form(self.view.run))

    def action_clear(self) -> None:
        """Clear a trip."""
        self.send(EntryRequest({"do": "clear"}, "Clear the trip? The rig arms again, and the pumps may move."))

    def action_note(self) -> None:
        """A note."""
        self.enter(note_form())

    def action_mark(self) -> None:
        """A mark."""
        self.enter(mark_form())

    def action_ack(self) -> None:
        """Acknowledge the chosen alarm."""
        alarm = self.query_one(AlarmPage).chosen
        if alarm is None:
            self.say("There is no alarm to acknowledge.")
        else:
            self.send(EntryRequest({"do": "ack", "alarm": alarm.key}))

    def action_ack_all(self) -> None:
        """Acknowledge every alarm."""
        self.send(EntryRequest({"do": "ack", "alarm": "all"}))

    def action_shelve(self) -> None:
        """Shelve the chosen alarm."""
        alarm = self.query_one(AlarmPage).chosen
        if alarm is None:
            self.say("There is no alarm to shelve.")
        else:
            self.enter(shelve_form(alarm))

    def action_help(self) -> None:
        """Keys and signs."""
        self.push_screen(HelpDialog())

    def action_page(self, chosen: str) -> None:
        """Show a page; in a large window all but the console are there anyway."""
        for page in self.query(".page"):
            page.set_class(page.id == chosen, "-chosen")
        self.query_one("#tabs", Static).update(self._tabs(chosen))
        self.query_one(f"#{chosen}").focus()

    def _tabs(self, chosen: str) -> str:
        tabs = []
        for key, (page, word) in PAGES.items():
            style = "reverse" if page == chosen else "not reverse"
            tabs.append(f"[@click=app.page('{page}')][{style}] {key} {word} [/][/]")
        return " ".join(tabs)
