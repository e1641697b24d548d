"""Open a recording in the Rerun viewer: in a window, or without a screen as a page for a browser on this machine.

Whatever is started here listens on 127.0.0.1 only.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder

HOST = "127.0.0.1"
START_S = 3.0  # a viewer that cannot start (no screen, no graphics) ends within this time
LOAD_S = 20.0
"""For a viewer to load a recording, before its time cursor is moved."""

LIVE_NICENESS = 10
"""Of a viewer that is started beside a run: the run goes first."""

Say = Callable[[str], None]


class NoViewerError(RunFolderError):
    """The viewer cannot be used here; the message says what there is instead."""


@dataclass(frozen=True, slots=True)
class Opening:
    """How a recording is opened.

    at_s : run time at the time cursor; None: the start. layout : writes another layout to a file; None: the
    recording's own. instead : what a user without a viewer can do.
    """

    at_s: float | None = None
    layout: Callable[[Path], None] | None = None
    instead: str = ""


def has_screen() -> bool:
    """Whether a window can be opened here."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def recording_of(folder: RunFolder) -> Path:
    """The run's recording. Raises NoViewerError when it has none."""
    if not folder.rrd_path.is_file():
        raise NoViewerError(f"{folder.path} has no run.rrd (recorded without Rerun?); {instead_of(folder)}")
    return folder.rrd_path


def open_window(path: Path, opening: Opening, *, start_s: float = START_S, load_s: float = LOAD_S) -> bool:
    """Start the viewer on a recording; it goes on running afterwards. Whether the time cursor is where it shall be.

    Raises NoViewerError, with a message for the user, when no viewer can start.
    """
    port = free_port()
    viewer = start([str(path), "--port", str(port)])
    _await_start(viewer, opening.instead, start_s)
    return opening.at_s is None or _move_cursor(port, opening.at_s, load_s)


def serve_page(path: Path, opening: Opening, say: Say, *, start_s: float = START_S) -> None:
    """Serve a recording as a page until the server ends or is interrupted; `say` gets the address.

    The plots open around `at_s`; a page's time cursor can't be placed from here, and stays at the start.
    Raises NoViewerError when the server can't start.
    """
    with TemporaryDirectory() as made:
        files = [str(path)]
        if opening.layout is not None:
            layout = Path(made) / "layout.rbl"
            opening.layout(layout)
            files.append(str(layout))
        data, page = free_port(), free_port()
        with _ended(start([*files, "--port", str(data), *_page(page)], is_page=True)) as server:
            _await_start(server, opening.instead, start_s)
            say(address_of(page, data))
            server.wait()


def address_of(page: int, data: int) -> str:
    """The address of the page on port `page` that shows what is served on port `data`."""
    return f"http://{HOST}:{page}/?url={quote(live_url(data), safe='')}"


def live_url(data: int) -> str:
    """What a viewer is given to see what is served on port `data`."""
    return f"rerun+http://{HOST}:{data}/proxy"


@contextmanager
def live_view(data: int, *, is_page: bool, say: Say) -> Iterator[None]:
    """Start a viewer of a run that is served on port `data`, for as long as the run goes on.

    A window stays afterwards; the server of a page is ended, and a page that is open keeps what it has. A viewer that
    does not start is no reason to wait: `say` gets what to do then.
    """
    url = live_url(data)
    page = free_port()
    arguments = [url, "--port", str(free_port()), *(_page(page) if is_page else [])]
    try:
        viewer = start(arguments, is_page=is_page, is_quiet=True)
    except OSError as error:
        say(f"no viewer can be started ({error.strerror}); connect one to {url}")
        yield
        return
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, viewer.pid, LIVE_NICENESS)
    say(f"live: {address_of(page, data)}" if is_page else f"live: the Rerun viewer, or any other at {url}")
    if is_page:
        with _ended(viewer):
            yield
    else:
        yield


def start(arguments: Sequence[str], *, is_page: bool = False, is_quiet: bool = False) -> subprocess.Popen[bytes]:
    """Start Rerun's program with these arguments. is_page : it ends with this program. is_quiet : without output."""
    module = "hil.review.page_server" if is_page else "rerun_cli"
    output = subprocess.DEVNULL if is_quiet else None
    return subprocess.Popen(  # noqa: S603 - our own arguments
        [sys.executable, "-m", module, *arguments, "--bind", HOST],
        stdin=subprocess.PIPE if is_page else subprocess.DEVNULL,
        stdout=output,
        stderr=output,
        start_new_session=True,
        env={"RUST_LOG": "error", **os.environ},
    )


def free_port() -> int:
    """A port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def instead_of(folder: RunFolder) -> str:
    """What there is of a run without a viewer."""
    if folder.report_path.is_file():
        return f"the report is at {folder.report_path}"
    return f"`hil report {folder.path}` makes a report without it"


def _page(port: int) -> list[str]:
    return ["--serve-web", "--web-viewer-port", str(port)]


def _await_start(viewer: subprocess.Popen[bytes], instead: str, start_s: float) -> None:
    try:
        code = viewer.wait(timeout=start_s)
    except subprocess.TimeoutExpired:
        return  # it runs
    if code != 0:
        raise NoViewerError(f"the Rerun viewer ended at once (code {code}); {instead}")


@contextmanager
def _ended(server: subprocess.Popen[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """Close the standard input of a page's server, by which it ends."""
    try:
        yield server
    finally:
        if server.stdin is not None:
            server.stdin.close()
        server.wait()


def _move_cursor(port: int, at_s: float, load_s: float) -> bool:
    """Move the time cursor of a viewer when it has loaded; whether that was possible."""
    from rerun.experimental import ViewerClient

    from hil.edge.record.rerun_log import TIMELINE

    end_s = time.monotonic() + load_s
    while time.monotonic() < end_s:
        with suppress(Exception):  # an interface that Rerun may change; not up yet is one of its errors
            client = ViewerClient(f"rerun+http://{HOST}:{port}/proxy")
            if client.get_state().recordings:
                client.set_time(TIMELINE, duration=at_s, play_state="paused")
                return True
        time.sleep(0.2)
    return False
