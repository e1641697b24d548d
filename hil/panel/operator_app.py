"""What the operator can ask of a run: keys and clicks become forms, questions and requests, and answers are shown."""

from __future__ import annotations

from textual.app import App
from textual.widgets import Static

from hil.edge.control.run_process import RunProcess
from hil.panel.alarm_widget import AlarmPage
from hil.panel.dialogs import EntryDialog, QuestionDialog
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
from hil.panel.run_messages import RunAnswer
from hil.panel.run_view import RunView

STOP_ANSWER_S = 1.0


class OperatorApp(App[None]):
    """An application with the actions of the operator. `connection` is set by who makes it."""

    connection: RunConnection

    def __init__(self) -> None:
        super().__init__()
        self.view = RunView()
        self.process = RunProcess()

    def say(self, text: str, kind: str = "") -> None:
        """Write the line above the keys. kind : accepted, refused or nothing."""
        for line in self.screen_stack[0].query("#message").results(Static):
            line.set_classes(f"-{kind}" if kind else "")
            line.update(f" {text}")

    def close_dialogs(self) -> bool:
        """Close them without a request; whether there were any."""
        had = len(self.screen_stack) > 1
        while len(self.screen_stack) > 1:
            self.pop_screen()
        return had

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
        self.close_dialogs()
        self.say("■ STOP is being sent …", "refused")
        answer = await self.connection.request({"do": "stop"}, STOP_ANSWER_S)
        if answer.is_ok:
            self.say(f"■ STOP accepted: {answer.text or 'both pumps ramp down to 0 V'}", "accepted")
        elif not self.connection.is_open and self.view.ended:
            self.say(f"The run has ended already: {self.view.ended}.")
        elif self.process.terminate():
            self.say("■ STOP by SIGTERM, as the run did not answer: it ramps down and ends.", "accepted")
        else:
            self.say(f"✖ STOP FAILED: {answer.text}. Use the emergency switch of the pumps.", "refused")

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
