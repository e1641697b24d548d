"""A picture of a run's recording without a screen: `python -m tools.screenshot FOLDER OUT.png`.

Starts Rerun's viewer on no screen, asks it what it shows until the recording is there, and has it save a picture. Needs
a Vulkan driver; one in software will do (Debian: `apt-get install mesa-vulkan-drivers`). README's picture is made by

    hil simulate paper_glr --out runs/first --seed 7
    python -m tools.screenshot runs/first docs/images/overview.png --at 230

and the other tabs' by --tab.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from rerun.experimental import ViewerClient

from hil.edge.record.rerun_log import APPLICATION
from hil.edge.record.run_folder import RunFolder
from hil.review.blueprint import blueprint

SIZE = "1600x1000"
MENU_PX = 36
SETTLE_S = 12.0  # until the viewer's messages at its start have disappeared


def screenshot(
    recording: Path, picture: Path, *, size: str = SIZE, at_s: float | None = None, layout: Path | None = None
) -> None:
    """Save a picture of the recording as it opens.

    at_s : position of the time cursor; None: the start. layout : an .rbl file; None: the recording's own.
    Raises RuntimeError when the viewer does not come up or saves no picture.
    """
    port = _free_port()
    files = [str(recording)] if layout is None else [str(recording), str(layout)]
    command = [sys.executable, "-m", "rerun_cli", *files, "--headless", "--renderer", "vulkan"]
    command += ["--bind", "127.0.0.1", "--port", str(port), "--window-size", size]
    picture.unlink(missing_ok=True)
    viewer = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        client = _connect(viewer, port)
        if at_s is not None:
            client.set_time("run_time", duration=at_s, play_state="paused")
        time.sleep(SETTLE_S)
        client.save_screenshot(str(picture.resolve()))
        if not picture.is_file():
            raise RuntimeError(f"the viewer saved no picture to {picture}")
        _without_menu(picture)
    finally:
        if viewer.poll() is None:
            os.killpg(viewer.pid, signal.SIGTERM)  # the process group that was started above: launcher and viewer
        viewer.communicate()


def layout_of(folder: Path, tab: str, made: Path) -> Path:
    """The layout of the run with that tab open, as a file in the folder `made`."""
    path = made / "layout.rbl"
    plan = RunFolder.open(folder).manifest().plan
    duration_s = plan.settings["scenario"]["scenario"]["duration_s"]
    layout = blueprint(plan.mode, duration_s, plan.shown, has_picture=True, tab=tab)
    layout.save(APPLICATION, str(path))
    return path


def _without_menu(picture: Path) -> None:
    """Cut the viewer's menu off, in which it warns of the machine that the picture is made on."""
    with Image.open(picture) as whole:
        whole.crop((0, MENU_PX, *whole.size)).save(picture, optimize=True)


def _connect(viewer: subprocess.Popen[str], port: int, timeout_s: float = 30.0) -> ViewerClient:
    """Wait until the viewer answers and has the recording."""
    deadline_s = time.monotonic() + timeout_s
    while time.monotonic() < deadline_s and viewer.poll() is None:
        try:
            client = ViewerClient(f"rerun+http://127.0.0.1:{port}/proxy")
            if client.get_state().recordings:
                return client
        except (ConnectionError, RuntimeError, OSError):
            pass  # not up yet
        time.sleep(0.2)
    if viewer.poll() is None:
        raise RuntimeError(f"the viewer showed no recording within {timeout_s:g} s")
    _, complaint = viewer.communicate()
    raise RuntimeError(f"the viewer did not start; is there a Vulkan driver?\n{complaint.strip()[-1500:]}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description="A picture of a run's recording, made without a screen.")
    parser.add_argument("folder", type=Path, help="run folder, or an .rrd file")
    parser.add_argument("picture", type=Path, help="the PNG to write")
    parser.add_argument("--size", default=SIZE, help="in pixels (default: %(default)s)")
    parser.add_argument("--at", type=float, metavar="SECONDS", help="run time at the cursor (default: the start)")
    parser.add_argument("--tab", metavar="NAME", help="tab that is open, of a run folder (default: the first)")
    options = parser.parse_args()
    recording = options.folder / "run.rrd" if options.folder.is_dir() else options.folder
    if not recording.is_file():
        print(f"there is no recording at {recording}", file=sys.stderr)
        return 1
    try:
        with TemporaryDirectory() as made:
            layout = layout_of(options.folder, options.tab, Path(made)) if options.tab else None
            screenshot(recording, options.picture, size=options.size, at_s=options.at, layout=layout)
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return 1
    print(options.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
