"""The emulator's console: the kinds of faults, what was injected, and the emulator's answers."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.widgets import OptionList, Static
from textual.widgets.option_list import Option

from hil.core.fault_kinds import FaultKind
from hil.panel.dialogs import EntryDialog
from hil.panel.emulator_client import COMPONENTS, INSTANCES, EmulatorClient, end_command, inject_command, value_words
from hil.panel.entry_forms import EntryField, EntryForm, EntryRequest

KINDS = tuple(FaultKind)
ANSWERS = 5
HINT = "Enter inject  e end  E end all"


class ConsolePage(Vertical):
    """List of kinds; Enter opens the form of the chosen one."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("e", "end", "End the faults of this part"),
        Binding("E", "end_all", "End all faults"),
    ]

    def __init__(self, emulator: EmulatorClient, *, id: str, classes: str) -> None:  # noqa: A002 - textual's word
        super().__init__(id=id, classes=classes)
        self._emulator = emulator
        self._answers: deque[Text] = deque(maxlen=ANSWERS)

    def compose(self) -> ComposeResult:
        """Hints, kinds, answers."""
        yield Static("Emulator: inject a fault", classes="page-title")
        yield OptionList(*(Option(f"{kind.acts_on:<9} {kind}") for kind in KINDS), id="kind-list", markup=False)
        yield Static(id="emulator-answers", markup=False)
        yield Static(HINT, classes="hint")

    def focus_list(self) -> None:
        """Give the keyboard to the list."""
        self.query_one(OptionList).focus()

    @property
    def chosen(self) -> FaultKind:
        """The kind under the cursor."""
        return KINDS[self.query_one(OptionList).highlighted or 0]

    async def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Enter, or a click: open the form."""
        event.stop()
        kind = self.chosen
        component = COMPONENTS[kind.acts_on]
        self.run_worker(self._open_form(kind, component), group="emulator")

    async def _open_form(self, kind: FaultKind, component: str) -> None:
        """Ask the emulator what values the kind takes, and open the form."""
        answer = await self._emulator.command(f"failure help {component}")
        if not answer.startswith("ok"):
            self._show("", answer)
            return

        def entered(request: EntryRequest | None) -> None:
            if request is not None:
                self.run_worker(self._send(str(request.request["line"])), group="emulator")

        self.app.push_screen(EntryDialog(fault_form(kind, value_words(kind, answer))), entered)

    def action_end(self) -> None:
        """End the faults of what the chosen kind acts on."""
        self.run_worker(self._send(end_command(self.chosen)), group="emulator")

    def action_end_all(self) -> None:
        """End every fault."""
        self.run_worker(self._end_all(), group="emulator")

    async def _end_all(self) -> None:
        for component in COMPONENTS.values():
            await self._send(f"failure {component} ok")

    async def _send(self, line: str) -> None:
        self._show(line, await self._emulator.command(line))

    def _show(self, line: str, answer: str) -> None:
        """Write command and answer."""
        sign, style = ("✓", "#5fd7af") if answer.startswith("ok") else ("✖", "bold #ff8787")
        text = Text.assemble(
            (f"{sign} ", style), line.removeprefix("failure "), ("  " if line else ""), (answer, style)
        )
        self._answers.append(text)
        self.query_one("#emulator-answers", Static).update(Text("\n").join(self._answers))


def fault_form(kind: FaultKind, values: str) -> EntryForm:
    """The form of a kind. values : what the emulator says of its value, "" when it takes none."""
    highest, (words, _, growth) = INSTANCES[kind.acts_on], values.partition(";")
    fields = {
        "-i": EntryField("target", "1", f"{kind.acts_on} 1 to {highest}; 0 for all"),
        "-v": EntryField("value", "", words),
        "-r": EntryField("ramp s", "", "grows to its value in that time; empty: at once"),
        "-t": EntryField("ends s", "", "after so many seconds; empty: stays"),
    }
    taken = {"-i": highest > 1, "-v": bool(words), "-r": bool(growth), "-t": True}
    options = [option for option in fields if taken[option]]

    def check(typed: Sequence[str]) -> EntryRequest:
        return EntryRequest({"line": inject_command(kind, dict(zip(options, typed, strict=True)))})

    return EntryForm(f"Inject {kind}", tuple(fields[option] for option in options), check)
