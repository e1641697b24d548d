"""What the panel knows of its run: the last state, its history, the event log, and how the connection is."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from hil.panel.run_messages import ShownEvent, ShownRun, ShownState
from hil.panel.trend_drawing import Trend

TREND_S = 300.0
SAMPLE_S = 0.5
STALE_S = 2.0
"""A state older than this is shown as old."""
EVENTS_MAX = 500
TROUBLE = ("TRIPPED", "DEGRADED")


@dataclass
class RunView:
    """The picture of a run. Times received_s and lost_s are of the panel's clock, nan for none.

    lost : why there is no connection, "" when there is one. ended : how the run ended, "" while it may still run.
    """

    run: ShownRun = field(default_factory=ShownRun)
    state: ShownState = field(default_factory=ShownState)
    history: deque[ShownState] = field(default_factory=lambda: deque(maxlen=round(TREND_S / SAMPLE_S) + 1))
    events: deque[ShownEvent] = field(default_factory=lambda: deque(maxlen=EVENTS_MAX))
    received_s: float = math.nan
    lost: str = "not connected yet"
    ended: str = ""

    def is_another(self, run: ShownRun) -> bool:
        """Whether it is not the run that is shown; False for the first one."""
        return bool(self.run.folder) and (run.folder, run.pid) != (self.run.folder, self.run.pid)

    def connected(self, run: ShownRun) -> None:
        """A greeting came. That of another run begins a new history."""
        if self.is_another(run):
            self.history.clear()
            self.events.clear()
            self.state = ShownState()
            self.received_s = math.nan
        self.run, self.lost, self.ended = run, "", ""

    def received(self, state: ShownState, now_s: float) -> bool:
        """A state came. The history keeps one for each SAMPLE_S; returns whether it has this one."""
        self.state, self.received_s = state, now_s
        is_timed = math.isfinite(state.t_s)  # it is not before the rig is ready
        is_kept = is_timed and (not self.history or abs(state.t_s - self.history[-1].t_s) >= SAMPLE_S)
        if is_kept:
            self.history.append(state)
        return is_kept

    def is_old(self, now_s: float) -> bool:
        """Whether the numbers shown are not those of now."""
        return bool(self.lost) or not now_s - self.received_s <= STALE_S

    def trends(self) -> list[Trend]:
        """The charts: lower levels with their references, the pumps' commands with what is applied."""
        times_s = [state.t_s for state in self.history]
        levels = [
            Trend(
                f"T{tank + 1} cm",
                times_s,
                [state.measured_cm[tank] for state in self.history],
                [state.reference_cm[tank] for state in self.history],
            )
            for tank in (0, 1)
        ]
        commands = [
            Trend(f"P{pump + 1} V", times_s, [state.command_V[pump] for state in self.history]) for pump in (0, 1)
        ]
        return levels + commands
