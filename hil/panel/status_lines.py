"""The two lines at the top of the panel: what the run does, what it waits for, and how the connection is."""

from __future__ import annotations

import math

from rich.text import Text

from hil.panel.run_view import RunView

MODES = {
    "RUNNING": ("▶", "bold black on #5fd7af"),
    "DEGRADED": ("◆", "bold black on #ffd75f"),
    "MANUAL": ("M", "bold black on #87d7ff"),
    "STOPPING": ("▼", "bold black on #ffaf5f"),
    "TRIPPED": ("✖", "bold white on #af0000"),
}
OTHER_MODE = ("○", "bold black on #bcbcbc")
ALERT = "bold white on #af0000"
WARNING = "bold black on #ffd75f"
SOFT = "#9aa0a6"


def status_lines(view: RunView, width: int, now_s: float) -> Text:
    """Two lines of `width` columns."""
    return Text("\n").join([_run_line(view, width), _condition_line(view, width, now_s)])


def _run_line(view: RunView, width: int) -> Text:
    """Mode, time, scenario, what comes next."""
    run, state = view.run, view.state
    sign, style = MODES.get(state.mode, OTHER_MODE)
    left = Text.assemble((f" {sign} {state.mode} ", style), " ")
    if state.is_held:
        left.append(" HELD ", WARNING)
        left.append(" ")
    left.append(_time(state.t_s, run.duration_s, state.is_starting), "bold")
    right = Text(run.scenario, "bold")
    if state.next_what and math.isfinite(state.next_in_s):
        right.append(f"  {state.next_what} in {duration(state.next_in_s)}" + (" (held)" if state.is_held else ""), SOFT)
    return _two_sides(left, right, width)


def _condition_line(view: RunView, width: int, now_s: float) -> Text:
    """Interlock, waiting and bypasses; the connection at the right."""
    state = view.state
    right = connection(view, now_s)
    left = Text(" ")
    if state.interlock:
        left.append(f" interlock {state.interlock} ", ALERT)
        left.append(" ")
    if state.waits_for:
        left.append(f"waits for: {state.waits_for} ", "bold")
    for name, left_s in state.bypassed.items():
        left.append(f" BYPASS {name} {duration(left_s)} ", WARNING)
        left.append(" ")
    if left.cell_len == 1 and not view.lost:
        left.append("no interlock active", SOFT)
    return _two_sides(left, right, width)


def connection(view: RunView, now_s: float) -> Text:
    """How the connection is, in words; with the age of the values when they are old."""
    age_s = now_s - view.received_s
    age = f", values {duration(age_s)} old" if math.isfinite(age_s) else ""
    if view.ended:
        return Text(f" RUN ENDED: {view.ended} ", WARNING)
    if view.lost:
        word = "CONNECTION LOST" if math.isfinite(age_s) else "NOT CONNECTED"
        return Text(f" {word}{age}; connecting ", ALERT)
    if view.is_old(now_s):
        return Text(f" NO STATES{age} " if age else " waiting for the first state ", ALERT if age else WARNING)
    return Text("● live", "#5fd7af")


def duration(seconds: float) -> str:
    """A time in words: 4 s, 2:05 min, 1:02 h."""
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    return f"{whole // 60}:{whole % 60:02} min" if whole < 6000 else f"{whole // 3600}:{whole % 3600 // 60:02} h"


def _time(t_s: float, duration_s: float, is_starting: bool) -> str:
    if not math.isfinite(t_s):
        return ""
    if is_starting or t_s < 0.0:
        return f"start phase, {-t_s:.0f} s to time 0"
    return f"{t_s:.1f} s" + (f" of {duration_s:g} s" if math.isfinite(duration_s) else ", open end")


def _two_sides(left: Text, right: Text, width: int) -> Text:
    """One line; when there is too little room, the left side is cut off."""
    left.truncate(max(width - right.cell_len - 1, 0), overflow="ellipsis")
    line = Text.assemble(left, " " * max(width - left.cell_len - right.cell_len, 0), right)
    line.truncate(width)
    return line
