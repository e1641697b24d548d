"""The tutorial's pictures of the panel: `python -m tools.panel_pictures [FOLDER]`, by default docs/images.

Starts the emulator and a run in real time, plays the session of docs/tutorial/first-hour.md through the panel by its
keys, and saves what the panel shows. It takes about five minutes.
"""

from __future__ import annotations

import argparse
import asyncio
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from textual.pilot import Pilot
from textual.widgets import Static

from hil.panel.emulator_client import EmulatorClient
from hil.panel.panel_app import PanelApp
from hil.panel.run_search import run_finder

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
SMALL, LARGE = (80, 24), (120, 36)
READY = re.compile(r"ready: slcan on (\S+)")


def plain_svg(app: PanelApp) -> str:
    """What an application shows, as SVG: without fonts from elsewhere, and without the number that names its parts."""
    svg = re.sub(r"@font-face \{[^}]*\}", "", app.export_screenshot())
    return re.sub(r"terminal-\d+", "terminal", svg)


class Session:
    """A session at the panel of a real run."""

    def __init__(self, pilot: Pilot[None], app: PanelApp, folder: Path) -> None:
        self._pilot, self._app, self._folder = pilot, app, folder

    async def wait(self, holds: Callable[[PanelApp], bool], timeout_s: float = 90.0) -> None:
        """Until something holds; TimeoutError when it does not, RuntimeError when the run has ended before."""
        async with asyncio.timeout(timeout_s):
            while not holds(self._app):
                if self._app.view.ended:
                    raise RuntimeError(f"the run has ended: {self._app.view.ended}")
                await asyncio.sleep(0.1)

    async def wait_until(self, t_s: float) -> None:
        """Until that time of the run."""
        await self.wait(lambda app: app.view.state.t_s >= t_s, 300.0)

    async def press(self, *keys: str) -> None:
        """Press keys; a text in quotation marks is typed into a field, in place of what is there."""
        for key in keys:
            if key.startswith('"'):
                await self._pilot.press("end", "ctrl+u", *("space" if c == " " else c for c in key.strip('"')))
            else:
                await self._pilot.press(key)
        await asyncio.sleep(0.5)

    async def picture(self, name: str, size: tuple[int, int]) -> None:
        """Save what is shown, in a window of that size."""
        await self._pilot.resize_terminal(*size)
        await asyncio.sleep(1.0)
        (self._folder / f"{name}.svg").write_text(plain_svg(self._app), encoding="utf-8")
        sys.stdout.write(f"{name}.svg at {self._app.view.state.t_s:.1f} s\n")


async def play(session: Session) -> None:
    """The tutorial's session."""
    await session.wait_until(45.0)
    await session.picture("panel-running", LARGE)
    await session.press("h", "r", '"14"', "enter", '""', "enter", '"20"')
    await session.picture("panel-reference-entry", SMALL)
    await session.press("enter")
    await session.picture("panel-question", SMALL)
    await session.press("y")
    await asyncio.sleep(50.0)
    await session.picture("panel-reference", LARGE)
    await session.press("4", "enter", "enter", '"0.5"', "enter", '"20"')
    await session.picture("panel-fault-entry", SMALL)
    await session.press("enter", "enter")
    await session.wait(lambda app: "ok pump_effectiveness" in str(app.query_one("#emulator-answers", Static).render()))
    await session.press("1")
    await session.wait(lambda app: app.view.state.mode == "DEGRADED", 120.0)
    await asyncio.sleep(25.0)
    await session.picture("panel-alarm", LARGE)
    await session.press("k", "n", '"pump 1 weak on purpose"', "enter")
    await session.press("m", '"3.5"', "enter", '"3.5"', "enter", "y")
    await session.wait(lambda app: app.view.state.mode == "MANUAL")
    await session.press("b", "enter", '"30"', "enter", "y")
    await session.wait(lambda app: bool(app.view.state.bypassed))
    await session.picture("panel-manual", SMALL)
    await session.press("a", "y")
    await session.wait(lambda app: app.view.state.mode != "MANUAL")
    await session.press("ctrl+x")
    await session.wait(lambda app: bool(app.view.ended))
    await session.picture("panel-ended", SMALL)


@contextmanager
def bench(folder: Path) -> Iterator[Path]:
    """Emulator and run, in that folder; yields the run's folder."""
    program = Path(sys.executable).parent
    command = [program / "firmware-sim", "--slcan", "0", "--seed", "1", "--control", folder / "emulator"]
    emulator = subprocess.Popen(list(map(str, command)), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    run: subprocess.Popen[bytes] | None = None
    try:
        found = None if emulator.stdout is None else READY.search(emulator.stdout.readline())
        if found is None:
            raise RuntimeError("firmware-sim does not start")
        channel = ["-i", "slcan", "-c", found[1], "--out", folder / "first-hour"]
        run = subprocess.Popen([program / "hil", "run", "steps", *channel, "--duration", "3600"])
        yield folder / "first-hour"
        run.wait(120.0)
    finally:
        for process in (run, emulator):
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(30.0)


async def main(images: Path) -> None:
    """Make all pictures."""
    with tempfile.TemporaryDirectory() as name, bench(Path(name)) as run:
        app = PanelApp(run_finder(run, None), emulator=EmulatorClient(str(Path(name) / "emulator")))
        async with app.run_test(size=LARGE) as pilot:
            await play(Session(pilot, app, images))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=IMAGES)
    asyncio.run(main(parser.parse_args().folder))
