"""The panel on a run that is none: what it shows, and what a session by keyboard alone sends."""

from __future__ import annotations

import asyncio
import math
import signal
import subprocess
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from textual import events
from textual.pilot import Pilot
from textual.widgets import Input, Static

from hil.panel.panel_app import PanelApp
from hil.panel.run_messages import ShownRun, read_event, read_state
from hil.panel.run_view import RunView
from hil.panel.tank_drawing import tank_picture
from hil.panel.trend_drawing import trend_chart
from tests.panel.fake_run import ALARM, HELLO, FakeRun, fake_run
from tools.panel_pictures import Session


@asynccontextmanager
async def panel(folder: Path, size: tuple[int, int] = (80, 24)) -> AsyncIterator[tuple[FakeRun, Pilot[None]]]:
    """A panel beside a fake run."""
    async with fake_run(folder) as run:
        app = PanelApp(lambda: run.path)
        async with app.run_test(size=size) as pilot:
            await until(pilot, lambda: app.connection.is_open)
            yield run, pilot


async def until(pilot: Pilot[None], holds: Callable[[], bool], timeout_s: float = 10.0) -> None:
    """Let the panel work until a condition holds."""
    async with asyncio.timeout(timeout_s):
        while not holds():
            await pilot.pause(0.005)
    await pilot.pause()


def shown(pilot: Pilot[None], name: str) -> str:
    """The text of a line of the panel."""
    return str(pilot.app.screen_stack[0].query_one(f"#{name}", Static).render())


async def type_into(pilot: Pilot[None], *texts: str) -> None:
    """Fill the fields of a dialog by keys, with Enter after each."""
    for text in texts:
        await pilot.press("end", "ctrl+u", *(".".join(text.split(",")).replace("-", "")), "enter")


def test_keys_and_clicks_tell_an_attended_run_that_somebody_is_there_but_not_each_of_them(tmp_path: Path) -> None:
    """Only requests counted: an operator who watched and turned pages was absent for the run."""

    async def session() -> None:
        async with fake_run(tmp_path) as run:
            now_s = [100.0]
            app = PanelApp(lambda: run.path, clock=lambda: now_s[0])
            async with app.run_test(size=(80, 24)) as pilot:
                await until(pilot, lambda: app.connection.is_open and app.view.run.scenario != "")
                await pilot.press("2", "1")
                assert run.requests == [], "nobody has asked for it"
                run.cut_off()
                run.hello = HELLO | {"attended_s": 600.0}
                await until(pilot, lambda: app.view.run.attended_s == 600.0 and app.connection.is_open)
                await pilot.press("2", "3", "1")
                await until(pilot, lambda: run.requests == [{"do": "here"}])
                now_s[0] += 9.9
                await pilot.press("3")
                await pilot.pause(0.02)
                assert len(run.requests) == 1
                now_s[0] += 0.2
                app.post_message(events.MouseDown(None, 1, 5, 0, 0, 1, False, False, False))
                await until(pilot, lambda: run.requests == [{"do": "here"}] * 2)

    asyncio.run(session())


def test_keys_that_come_at_once_act_in_their_order(tmp_path: Path) -> None:
    """Over a slow line, backspace and a new value in one packet left the field empty: backspace acted last."""

    async def session() -> None:
        async with panel(tmp_path) as (run, pilot):
            run.send_state()
            await pilot.press("r")
            for key in ("backspace", "backspace", "1", "4", "5", "backspace"):
                pilot.app.post_message(events.Key(key, key if key.isdecimal() else None))
            await pilot.pause(0.1)
            assert pilot.app.screen.query(Input).first().value == "14"

    asyncio.run(session())


def test_a_session_by_keyboard_alone(tmp_path: Path) -> None:
    async def session() -> None:
        async with panel(tmp_path) as (run, pilot):
            run.send_state(alarms=[ALARM])
            await until(pilot, lambda: "RUNNING" in shown(pilot, "status"))
            assert "123.4 s of 500 s" in shown(pilot, "status")

            await pilot.press("r")  # outside the limits: refused in the dialog, nothing is sent
            await type_into(pilot, "25", "12", "20")
            assert "reference 1 25: must be 0 to 19 cm" in str(
                pilot.app.screen.query_one("#complaint", Static).render()
            )
            assert run.requests == []
            for _ in range(2):
                await pilot.press("shift+tab")
            pilot.app.screen.query(Input).first().focus()
            await type_into(pilot, "6.5V", "", "20")
            await pilot.press("y")
            await until(pilot, lambda: len(run.requests) == 1)
            assert run.requests[-1] == {"do": "reference", "levels_cm": [13.0, None], "ramp_s": 20.0}
            await until(pilot, lambda: "accepted" in shown(pilot, "message"))

            await pilot.press("m")
            await type_into(pilot, "3.5", "")
            await pilot.press("n")  # not confirmed: nothing is sent
            await pilot.press("m")
            await type_into(pilot, "3.5", "")
            await pilot.press("y")
            await until(pilot, lambda: len(run.requests) == 2)
            assert run.requests[-1] == {"do": "manual", "voltage_V": [3.5, None]}

            await pilot.press("k")
            await until(pilot, lambda: len(run.requests) == 3)
            assert run.requests[-1] == {"do": "ack", "alarm": "alarm:2"}

            await pilot.press("n", "x")  # the stop key works in a dialog, while text is typed
            await pilot.press("ctrl+x")
            await until(pilot, lambda: len(run.requests) == 4)
            assert run.requests[-1] == {"do": "stop"}
            assert "STOP accepted" in shown(pilot, "message")

    asyncio.run(session())


def test_a_lost_connection_is_said_and_made_again(tmp_path: Path) -> None:
    async def session() -> None:
        async with panel(tmp_path) as (run, pilot):
            run.send_state()
            await until(pilot, lambda: "live" in shown(pilot, "status"))
            run.cut_off()
            await until(pilot, lambda: "CONNECTION LOST" in shown(pilot, "status"))
            assert pilot.app.screen.has_class("-old")
            await until(pilot, lambda: "live" in shown(pilot, "status"))
            assert not pilot.app.screen.has_class("-old")

    asyncio.run(session())


def test_what_was_being_asked_of_a_run_is_not_asked_of_the_next_one(tmp_path: Path) -> None:
    """The panel waits for the next run; a question that was open was sent to that one."""

    async def session() -> None:
        async with panel(tmp_path) as (run, pilot):
            run.send_state()
            await until(pilot, lambda: "live" in shown(pilot, "status"))
            await pilot.press("m")
            await type_into(pilot, "3.5", "3.5")
            run.cut_off()  # the same run again: the question stands
            await until(pilot, lambda: "CONNECTION LOST" in shown(pilot, "status"))
            await until(pilot, lambda: "live" in shown(pilot, "status"))
            assert len(pilot.app.screen_stack) == 2
            run.hello = HELLO | {"folder": "/data/runs/other", "scenario": "other"}
            run.cut_off()
            await until(pilot, lambda: "Another run: other in /data/runs/other" in shown(pilot, "message"))
            assert "The dialog was closed" in shown(pilot, "message")
            await pilot.press("y")
            await pilot.pause(0.1)
            assert run.requests == []

    asyncio.run(session())


def test_a_session_that_makes_pictures_ends_with_its_run(tmp_path: Path) -> None:
    """It waited five minutes for a time that a tripped run never reaches."""

    async def session() -> None:
        async with panel(tmp_path) as (run, pilot):
            assert isinstance(pilot.app, PanelApp)
            run.send_state(t_s=1.0)
            run.send(event={"t_s": 2.0, "severity": "ERROR", "code": "end", "text": "tripped: dry_run", "data": {}})
            with pytest.raises(RuntimeError, match="the run has ended: tripped: dry_run"):
                await asyncio.wait_for(Session(pilot, pilot.app, tmp_path).wait_until(45.0), 20.0)

    asyncio.run(session())


def test_the_stop_key_ends_a_run_that_does_not_answer(tmp_path: Path) -> None:
    """The channel hangs: SIGTERM, which every run takes as an orderly stop."""
    hanging = subprocess.Popen(["sleep", "60"])

    async def session() -> None:
        async with fake_run(tmp_path) as run:
            run.hello = HELLO | {"pid": hanging.pid}
            run.is_deaf = True
            app = PanelApp(lambda: run.path)
            async with app.run_test(size=(80, 24)) as pilot:
                await until(pilot, lambda: app.process.is_alive)
                await pilot.press("f8")
                assert "STOP by SIGTERM" in shown(pilot, "message")

    try:
        asyncio.run(session())
        assert hanging.wait(5.0) == -signal.SIGTERM
    finally:
        hanging.kill()
        hanging.wait()


def test_a_stop_that_can_not_be_sent_points_to_the_emergency_switch(tmp_path: Path) -> None:
    async def session() -> None:
        app = PanelApp(lambda: tmp_path / "none")
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.press("ctrl+x")
            assert "STOP FAILED" in shown(pilot, "message")
            assert "emergency switch" in shown(pilot, "message")

    asyncio.run(session())


def test_text_of_a_run_can_not_command_the_terminal() -> None:
    assert read_event({"t_s": 1.0, "text": "a\x1b[2Jb\nc"}).text == "a [2Jb c"


@pytest.mark.parametrize(
    "data", [{}, {"measured_cm": [1.0], "next": None, "alarms": [{}], "bypassed": {"dry_run": None}}]
)
def test_a_state_with_keys_missing_is_shown(data: dict[str, Any]) -> None:
    state_ = read_state(data)
    assert math.isnan(state_.measured_cm[3])
    assert "T4" in tank_picture(ShownRun(), state_, 44, 20).plain


def test_a_run_that_is_not_ready_has_no_time_and_is_shown() -> None:
    """In a large window the panel used to fail at the first state of every run, which has no time."""
    view = RunView()
    assert not view.received(read_state({"t_s": None, "mode": "DISARMED"}), 0.0)
    assert view.received(read_state({"t_s": 0.0}), 1.0)
    assert all("T1" in trend_chart(trend, 60, 5, 300.0).plain for trend in view.trends()[:1])
