"""In a terminal that can't show it the panel says so in one line; in a small one it still shows the stop key."""

from __future__ import annotations

import asyncio
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from hil.panel.panel_app import PanelApp
from tests.panel.fake_run import fake_run
from tests.panel.test_panel import shown, until

REFUSED = {
    "no place for text": ({"TERM": "dumb"}, "TERM=dumb; use hil ctl watch"),
    "not UTF-8": ({"TERM": "xterm", "PYTHONIOENCODING": "latin-1"}, "set LANG=C.UTF-8"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_terminal_that_cannot_show_the_panel_is_told_so(name: str) -> None:
    """It drew escape codes and \\u2502 over the whole screen."""
    environment, text = REFUSED[name]
    master, slave = pty.openpty()
    code = "from hil.cli.beside_panel import check_terminal; check_terminal()"
    made = subprocess.run(
        [sys.executable, "-c", code],
        stdin=slave,
        stdout=slave,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )
    os.close(master)
    os.close(slave)
    assert text in made.stderr


@pytest.mark.parametrize("size", [(60, 20), (40, 12)])
def test_a_small_terminal_shows_mode_stop_key_and_help(tmp_path: Path, size: tuple[int, int]) -> None:
    async def session() -> None:
        async with fake_run(tmp_path) as run:
            app = PanelApp(lambda: run.path)
            async with app.run_test(size=size) as pilot:
                run.send_state(mode="TRIPPED", interlock="level_high")
                await until(pilot, lambda: "TRIPPED" in shown(pilot, "status"))
                stop = app.screen.query_one("#stop").region
                assert stop.right <= size[0]
                assert stop.bottom <= size[1]
                await pilot.press("ctrl+x")
                await until(pilot, lambda: run.requests[-1:] == [{"do": "stop"}])

    asyncio.run(session())
