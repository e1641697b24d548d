"""Dialogs of the panel: entry of a form, a question before water moves, help. The stop key works in each of them."""

from __future__ import annotations

from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Label, Static

from hil.panel.entry_forms import EntryError, EntryForm, EntryRequest

STOP_LINE = "[@click=app.stop_run][b on #af0000] ■ STOP: Ctrl+X [/][/] works here, too"


class QuestionDialog(ModalScreen[bool]):
    """Asks before something moves water. y is yes; Enter is no at first, so that one too many does no harm."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "yes", "Yes"),
        Binding("n,escape", "no", "No"),
    ]
    AUTO_FOCUS = "#no"

    def __init__(self, question: str) -> None:
        super().__init__()
        self._question = question

    def compose(self) -> ComposeResult:
        """The question and two buttons."""
        with Vertical(classes="dialog"):
            yield Label("Confirm", classes="title")
            yield Static(Content(self._question), classes="question")
            with Horizontal(classes="buttons"):
                yield Button("Yes (y)", id="yes", variant="warning")
                yield Button("No (Esc)", id="no")
            yield Static(STOP_LINE, classes="stop-line")

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """A click, or Enter on a button."""
        self.dismiss(event.button.id == "yes")

    def action_yes(self) -> None:
        """Yes."""
        self.dismiss(True)

    def action_no(self) -> None:
        """No."""
        self.dismiss(False)


class OrderedInput(Input):
    """A field in which keys that come together, as over a slow line, act in the order in which they were typed.

    In textual's own, letters are entered at once, while keys such as backspace first pass through other queues.
    """

    async def _on_key(self, event: events.Key) -> None:
        bound = [] if event.is_printable else self._bindings.key_to_bindings.get(event.key, [])
        if bound and event.key != "enter":
            event.stop()
            event.prevent_default()
            await self.run_action(bound[0].action)
        else:
            await super()._on_key(event)


class EntryDialog(ModalScreen[EntryRequest | None]):
    """A form. Enter goes to the next field, and in the last one checks; what is wrong is said and nothing is sent."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "cancel", "Cancel")]

    def __init__(self, form: EntryForm) -> None:
        super().__init__()
        self._form = form

    def compose(self) -> ComposeResult:
        """The fields with their limits."""
        with Vertical(classes="dialog"):
            yield Label(self._form.title, classes="title", markup=False)
            for index, field in enumerate(self._form.fields):
                with Horizontal(classes="field"):
                    yield Label(field.label, classes="label")
                    yield OrderedInput(field.value, id=f"field{index}", compact=True)
                if field.allowed:
                    yield Label(field.allowed, classes="allowed", markup=False)
            yield Static("", id="complaint", markup=False)
            with Horizontal(classes="buttons"):
                yield Button("Continue (Enter)", id="go", variant="primary")
                yield Button("Cancel (Esc)", id="cancel")
            yield Static(STOP_LINE, classes="stop-line")

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Enter in a field."""
        inputs = list(self.query(Input))
        index = inputs.index(event.input)
        if index + 1 < len(inputs):
            inputs[index + 1].focus()
        else:
            self._check()

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """A click, or Enter on a button."""
        if event.button.id == "go":
            self._check()
        else:
            self.dismiss(None)

    def action_cancel(self) -> None:
        """Leave without a request."""
        self.dismiss(None)

    def _check(self) -> None:
        try:
            entry = self._form.check([field.value for field in self.query(Input)])
        except EntryError as error:
            self.query_one("#complaint", Static).update(f"✖ {error}")
            return
        self.dismiss(entry)


HELP = """\
[b]Keys[/b]
[b]Ctrl+X[/b] or [b]F8[/b]  stop: both pumps ramp down to 0 V, the run ends;
               without a question, in every dialog
[b]Ctrl+Q[/b] or [b]q[/b]   leave the panel; the run goes on
[b]1[/b] … [b]4[/b]  alarms, trends, events, emulator    [b]Tab[/b]  next list
[b]r[/b]  references      [b]m[/b]  manual voltages    [b]a[/b]  automatic control
[b]h[/b]  hold or resume the scenario's clock    [b]b[/b]  bypass an interlock
[b]c[/b]  clear a trip    [b]n[/b]  note for the record   [b]p[/b]  mark this moment
[b]k[/b]  acknowledge the chosen alarm   [b]K[/b]  all   [b]s[/b]  shelve it

[b]Signs[/b]
◀ reference   ◁ where it goes   ╌ level that trips   ! level near it
? and ▒▒▒  sensor not trusted: the level shown is estimated
▶ pump runs   ■ pump at rest   ▼ effectiveness below 0.95
Alarms: H M L priority, ! active, ↩ over but not acknowledged,
        ✓ acknowledged, z shelved
"""


class HelpDialog(ModalScreen[None]):
    """Keys and signs."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,question_mark,q,enter", "close", "Close")]

    def compose(self) -> ComposeResult:
        """The text."""
        with Vertical(classes="dialog wide"):
            yield Static(HELP)
            yield Static(STOP_LINE + "     Esc closes this help", classes="stop-line")

    def action_close(self) -> None:
        """Back to the panel."""
        self.dismiss(None)
