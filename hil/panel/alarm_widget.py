"""The alarm list: one row for each alarm, by priority; cause and action of the chosen one below."""

from __future__ import annotations

import math

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import OptionList, Static
from textual.widgets.option_list import Option

from hil.panel.run_messages import ShownAlarm
from hil.panel.status_lines import duration

PRIORITY = {
    "high": ("H▲", "bold white on #af0000"),
    "medium": ("M◆", "bold black on #ffd75f"),
    "low": ("L●", "bold black on #87d7ff"),
}
STATE = {"active": ("!", "bold"), "returned": ("↩", "bold"), "acknowledged": ("✓", ""), "shelved": ("z", "dim")}


class AlarmPage(Vertical):
    """The list with the details of the chosen alarm."""

    def __init__(self, *, id: str, classes: str) -> None:  # noqa: A002 - textual's word
        super().__init__(id=id, classes=classes)
        self._alarms: tuple[ShownAlarm, ...] = ()

    def compose(self) -> ComposeResult:
        """List and details."""
        yield Static("Alarms", classes="page-title")
        yield OptionList(id="alarm-list", markup=False)
        yield Static("No alarm.", id="alarm-detail", markup=False)
        yield Static("k ack  K all  s shelve", classes="hint")

    @property
    def chosen(self) -> ShownAlarm | None:
        """The alarm under the cursor; the first when none is chosen."""
        row = self.query_one("#alarm-list", OptionList).highlighted
        if row is not None and row < len(self._alarms):
            return self._alarms[row]
        return self._alarms[0] if self._alarms else None

    def show(self, alarms: tuple[ShownAlarm, ...]) -> None:
        """Show these alarms; the cursor stays on its alarm."""
        if alarms == self._alarms:
            return
        chosen = self.chosen
        is_same_list = [(one.key, *_row_words(one)) for one in alarms] == [
            (one.key, *_row_words(one)) for one in self._alarms
        ]
        self._alarms = alarms
        if not is_same_list:
            rows = self.query_one("#alarm-list", OptionList)
            rows.clear_options()
            rows.add_options([Option(alarm_row(alarm)) for alarm in alarms])
            key = chosen.key if chosen is not None else ""
            if alarms:
                rows.highlighted = next((i for i, alarm in enumerate(alarms) if alarm.key == key), 0)
        self._show_detail()

    def on_option_list_option_highlighted(self) -> None:
        """Another alarm is chosen."""
        self._show_detail()

    def _show_detail(self) -> None:
        alarm = self.chosen
        self.query_one("#alarm-detail", Static).update(alarm_detail(alarm) if alarm is not None else Text("No alarm."))


def _row_words(alarm: ShownAlarm) -> tuple[str, str, str, int]:
    return alarm.priority, alarm.state, alarm.title, alarm.count


def alarm_row(alarm: ShownAlarm) -> Text:
    """Priority, state, title."""
    sign, style = PRIORITY.get(alarm.priority, PRIORITY["low"])
    state, state_style = STATE.get(alarm.state, STATE["active"])
    row = Text.assemble((sign, style), f" {state} ")
    row.append(alarm.title, state_style)
    if alarm.count > 1:
        row.append(f" ×{alarm.count}")
    return row


def alarm_detail(alarm: ShownAlarm) -> Text:
    """State, times, cause and action."""
    words = {"returned": "over, not acknowledged", "active": "not acknowledged"}.get(alarm.state, alarm.state)
    text = Text.assemble((alarm.title, "bold"))
    text.append(f"\n{alarm.priority} priority, {words}")
    if alarm.state == "shelved" and math.isfinite(alarm.shelved_s):
        text.append(f" for {duration(alarm.shelved_s)}")
    if math.isfinite(alarm.since_s):
        text.append(f", since {alarm.since_s:.1f} s")
    if math.isfinite(alarm.respond_s):
        text.append(f", respond within {duration(alarm.respond_s)}")
    if alarm.cause:
        text.append("\nCause: ", "bold").append(alarm.cause)
    if alarm.action:
        text.append("\nDo: ", "bold").append(alarm.action)
    return text
