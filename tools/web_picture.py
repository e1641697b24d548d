"""A picture of the panel in a browser: `python -m tools.web_picture [OUT.png]`. Needs Chromium, and the extra `web`.

Starts the emulator, a run in real time and `hil panel --web`, opens the page in Chromium without a screen, and saves
what it shows after a minute of the run.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aiohttp import ClientSession, ClientWebSocketResponse

from hil.edge.control.client import ControlClient
from hil.review.viewer import free_port
from tools.panel_pictures import IMAGES, bench

SIZE = (1280, 800)
AT_S = 45.0
DRAWN_S, START_S = 5.0, 120.0
HAS_BEGUN = "document.body.classList.contains('-first-byte')"
"""What textual-serve's page says of itself once the panel has drawn something."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@contextmanager
def web_panel(run: Path) -> Iterator[str]:
    """Serve the panel of a run; yields the address with its secret."""
    command = [Path(sys.executable).parent / "hil", "panel", run, "--web", "--port", f"{free_port()}"]
    with subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, text=True) as panel:
        try:
            line = "" if panel.stdout is None else panel.stdout.readline()
            yield line.partition("panel: ")[2].strip()
        finally:
            panel.terminate()


@contextmanager
def browser(address: str, profile: Path) -> Iterator[int]:
    """Chromium without a screen at that page; yields the port on which it takes commands."""
    program = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if program is None:
        raise RuntimeError(f"none of {', '.join(BROWSERS)} is installed")
    port = free_port()
    options = [f"--remote-debugging-port={port}", f"--user-data-dir={profile}", f"--window-size={SIZE[0]},{SIZE[1]}"]
    command = [program, "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", *options, address]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield port
        finally:
            process.terminate()


async def photograph(port: int) -> bytes:
    """What the page shows, as PNG."""
    async with ClientSession() as session:
        for _ in range(100):
            await asyncio.sleep(0.2)
            try:
                async with session.get(f"http://127.0.0.1:{port}/json") as answer:
                    pages: list[dict[str, Any]] = await answer.json()
            except OSError:
                continue
            if found := [page for page in pages if page["type"] == "page"]:
                break
        else:
            raise RuntimeError("the browser does not start")
        async with session.ws_connect(found[0]["webSocketDebuggerUrl"], max_msg_size=1 << 26) as line:
            async with asyncio.timeout(START_S):
                while not (await command(line, "Runtime.evaluate", expression=HAS_BEGUN))["result"].get("value"):
                    await asyncio.sleep(0.5)
            await asyncio.sleep(DRAWN_S)
            shown = await command(line, "Page.captureScreenshot", format="png")
            return base64.b64decode(shown["data"])


async def command(line: ClientWebSocketResponse, method: str, **parameters: object) -> dict[str, Any]:
    """One command of the Chrome DevTools Protocol, and its result."""
    await line.send_json({"id": 1, "method": method, "params": parameters})
    while (message := json.loads((await line.receive()).data)).get("id") != 1:
        pass
    result: dict[str, Any] = message["result"]
    return result


def wait_until(run: Path, t_s: float) -> None:
    """Until that time of the run."""
    with ControlClient.connect(run / "control.sock", 60.0) as client:
        client.ask("subscribe", rate_hz=1)
        next(m for m in client.messages() if "state" in m and (m["state"]["t_s"] or 0.0) >= t_s)


def main(picture: Path) -> None:
    """Make the picture."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name, bench(Path(name)) as run:
        try:
            while not (run / "control.sock").exists():
                asyncio.run(asyncio.sleep(0.5))
            wait_until(run, AT_S)
            with web_panel(run) as address, browser(address, Path(name) / "profile") as port:
                picture.write_bytes(asyncio.run(photograph(port)))
        finally:
            with ControlClient.connect(run / "control.sock") as client:
                client.ask("stop")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", type=Path, default=IMAGES / "panel-web.png")
    main(parser.parse_args().picture)
