"""Pictures of the panel in situations of all kinds, at 80x24 and at 160x50, beside those that were looked at.

`HIL_SNAPSHOTS=write pytest tests/panel/test_panel_snapshots.py` writes them again; then look at every one that differs.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from textual.widgets import Input

from hil.panel.emulator_client import EmulatorClient
from hil.panel.panel_app import PanelApp
from hil.panel.run_connection import RunConnection
from hil.panel.run_messages import ShownEvent, read_hello, read_state
from tests.panel.fake_run import ALARM, HELLO, state
from tools.panel_pictures import plain_svg

SNAPSHOTS = Path(__file__).parent / "snapshots"
SIZES = {"80x24": (80, 24), "160x50": (160, 50)}
LARGE = ("running", "console", "question", "trip")
"""Situations that are also looked at in a large window."""
WEAK = ALARM | {"since_s": 150.2}
STUCK = ALARM | {
    "key": "alarm:3",
    "title": "sensor 3: stuck",
    "priority": "medium",
    "state": "acknowledged",
    "since_s": 80.0,
    "cause": "sensor or its wire broken",
    "action": "compare the level with a ruler",
}
QUIET = ALARM | {"key": "alarm:1", "title": "late steps", "priority": "low", "state": "shelved", "shelved_s": 240.0}


class NoConnection(RunConnection):
    """In its place the test tells the panel what the run says."""

    async def follow(self) -> None:
        """Nothing to follow."""
        await asyncio.Event().wait()


class Stage:
    """A panel, and a clock that the test sets."""

    def __init__(self, folder: Path) -> None:
        self.now_s = 0.0
        self.app = PanelApp(Path, clock=lambda: self.now_s, emulator=EmulatorClient(str(folder / "none")))
        self.app.connection = NoConnection(Path, self.app)

    def state(self, **others: Any) -> None:
        """The run says how it is."""
        self.app.on_state(read_state(state(**others)))

    def earlier(self, **others: Any) -> None:
        """The run has said how it was; nothing is drawn."""
        self.app.view.received(read_state(state(**others)), self.now_s)

    def event(self, t_s: float, severity: str, text: str, code: str = "alarm") -> None:
        """The run says what has happened."""
        self.app.on_run_event(ShownEvent(t_s, severity, code, text))


def quiet_run(stage: Stage) -> None:
    """Two minutes at the operating point, with a step of reference 1."""
    for t_s in range(120):
        high = min(max(t_s - 60, 0) / 20.0, 1.0)
        level_cm = 12.4 + 0.9 * high * min(max(t_s - 65, 0) / 30.0, 1.0)
        stage.earlier(
            t_s=float(t_s),
            measured_cm=[level_cm, 12.68, 1.63, 1.41],
            reference_cm=[12.4 + high, 12.7],
            target_cm=[13.4 if t_s >= 60 else 12.4, 12.7],
            command_V=[3.0 + 0.6 * high * (1.0 - min(max(t_s - 80, 0) / 30.0, 1.0)), 3.0],
        )
    stage.state(t_s=120.0, measured_cm=[13.3, 12.68, 1.63, 1.41], reference_cm=[13.4, 12.7], target_cm=[13.4, 12.7])
    stage.event(60.0, "INFO", "references to 13.4 cm, within 20 s", "operator")


def fault(stage: Stage) -> None:
    """A weak pump, a sensor that is not trusted, a bypass, a high level."""
    quiet_run(stage)
    stage.state(
        t_s=163.5,
        mode="DEGRADED",
        measured_cm=[18.4, 11.1, 9.0, 1.2],
        trusted=[True, True, False, True],
        reference_cm=[17.0, 12.7],
        target_cm=[18.0, 12.7],
        command_V=[7.32, 3.0],
        applied_V=[7.32, 3.0],
        effectiveness=[0.41, 1.0],
        bypassed={"dry_run": 12.5},
        alarms=[QUIET, STUCK, WEAK],
    )
    stage.event(80.0, "WARN", "sensor 3 is stuck since 78.8 s", "alarm")
    stage.event(150.2, "WARN", "pump 1 has lost 59 % of its gain", "alarm")


def trip(stage: Stage) -> None:
    """Tripped by a high level."""
    fault(stage)
    stage.state(
        t_s=170.0,
        mode="TRIPPED",
        command_V=[0.0, 0.0],
        applied_V=[0.0, 0.0],
        effectiveness=[None, None],
        interlock="high_level",
        waits_for="level 1 to fall below 19 cm",
        pump_flow_cm3_s=[0.0, 0.0],
        next=None,
        alarms=[WEAK | {"title": "tripped: level 1 above 19 cm", "count": 2}],
    )
    stage.event(170.0, "ERROR", "tripped: level 1 is above 19 cm", "trip")


def held(stage: Stage) -> None:
    """By hand, the scenario's clock held, an open end."""
    stage.state(t_s=12.0, mode="MANUAL", held=True, command_V=[3.5, 0.0], applied_V=[3.5, 0.0])


def lost(stage: Stage) -> None:
    """The connection was cut off 12 s ago."""
    fault(stage)
    stage.app.on_lost("the run has closed the connection")
    stage.now_s = 12.0


def ended(stage: Stage) -> None:
    """The run has ended."""
    trip(stage)
    stage.event(170.2, "INFO", "tripped (high_level)", "end")
    stage.app.on_lost("the run has closed the connection")


SITUATIONS: dict[str, tuple[Callable[[Stage], None], tuple[str, ...]]] = {
    "running": (quiet_run, ()),
    "trends": (quiet_run, ("2",)),
    "fault": (fault, ()),
    "events": (fault, ("3",)),
    "console": (fault, ("4",)),
    "trip": (trip, ()),
    "manual-held": (held, ()),
    "reference-entry": (quiet_run, ("r",)),
    "question": (quiet_run, ("a",)),
    "help": (quiet_run, ("question_mark",)),
    "connection-lost": (lost, ()),
    "ended": (ended, ()),
}


async def pictures(folder: Path, size: tuple[int, int], names: Sequence[str]) -> dict[str, str]:
    """An SVG of each of these situations, from one application for all of them."""
    found = {}
    stage = Stage(folder)
    async with stage.app.run_test(size=size) as pilot:
        for name in names:
            play, keys = SITUATIONS[name]
            stage.now_s = 0.0
            stage.app.on_run(read_hello(HELLO | {"folder": f"/data/runs/{name}"}))
            await pilot.press("1")
            play(stage)
            await pilot.press(*keys)
            for field in stage.app.screen.query(Input):
                field.cursor_blink = False
            stage.app.refresh_status()
            await pilot.pause()
            found[name] = plain_svg(stage.app)
            if len(stage.app.screen_stack) > 1:
                await pilot.press("escape")
    return found


@pytest.mark.parametrize("size", SIZES)
def test_the_panel_looks_as_it_did(size: str, tmp_path: Path) -> None:
    names = LARGE if size == "160x50" else tuple(SITUATIONS)
    found = asyncio.run(pictures(tmp_path, SIZES[size], names))
    if os.environ.get("HIL_SNAPSHOTS") == "write":
        SNAPSHOTS.mkdir(exist_ok=True)
        for name, svg in found.items():
            (SNAPSHOTS / f"{name}-{size}.svg").write_text(svg)
    expected = {name: (SNAPSHOTS / f"{name}-{size}.svg").read_text() for name in names}
    differ = [name for name in names if found[name] != expected[name]]
    for name in differ:
        (tmp_path / f"{name}.svg").write_text(found[name])
    assert differ == [], f"see {tmp_path}"


def test_a_panel_whose_screens_are_gone_draws_nothing(tmp_path: Path) -> None:
    """Its timers may tick once more while it closes."""
    app = Stage(tmp_path).app
    assert not app.screen_stack
    app.refresh_status()
