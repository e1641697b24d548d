"""The panel in the terminal of `hil run --panel`: a process of its own, beside the run.

The run is the process that the user has started; the panel is its child, and the run never waits for it. What the run
writes while the panel has the terminal is kept, and written when the panel has ended, in whatever way.
"""

from __future__ import annotations

import codecs
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import termios
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

from hil.panel.panel_error import PanelError

LEAVE_SCREEN = b"\x1b[?1049l\x1b[?25h\x1b[?1000l\x1b[?1002l\x1b[?1003l\x1b[?1006l\x1b[?1004l\x1b[?2004l\x1b[<u\x1b[0m"
"""Back from the alternate screen; cursor on; mouse, focus and paste reports off: a killed panel has not done it."""
GOES_ON = "hil: the panel has ended, the run goes on. Ctrl+C stops the run; hil panel {folder} shows it again.\n"
END_S = 2.0
LOOK_S = 0.5
BESIDE = "HIL_PANEL_BESIDE_RUN"
"""Set in the environment of a panel that a run has started: it ends with the run's process."""


class BesidePanel:
    """Use as a context around the run. At its end it waits until the operator leaves the panel.

    A closed terminal (SIGHUP) ends the panel and not the run. Ctrl-C is a key of the panel as long as there is one, and
    stops the run as ever when there is none.
    """

    def __init__(self, folder: Path, socket: Path | None, emulator: str | None) -> None:
        self._command = [sys.executable, "-m", "hil", "panel", str(folder)]
        self._command += [] if socket is None else ["--socket", str(socket)]
        self._folder, self._is_over = folder, False
        self._command += [] if emulator is None else ["--emulator", emulator]

    def __enter__(self) -> BesidePanel:
        """Start the panel and give it the terminal. Raises PanelError where there is none."""
        check_terminal()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        _flush()
        self._held = tempfile.TemporaryFile()
        self._outputs = [os.dup(1), os.dup(2)]
        self._terminal: list[Any] | None = None
        with suppress(termios.error):
            self._terminal = termios.tcgetattr(0)
        self._process = subprocess.Popen(  # noqa: S603 - ourselves
            self._command, stdout=self._outputs[0], stderr=self._outputs[1], env={**os.environ, BESIDE: "1"}
        )
        for number in (1, 2):
            os.dup2(self._held.fileno(), number)
        self._watch = threading.Thread(target=self._wait, name="panel", daemon=True)
        self._watch.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        """Wait for the operator after a run that has ended; end the panel after an error."""
        self._is_over = True
        if kind is not None:
            self.end()
        while self._watch.is_alive():
            self._watch.join(LOOK_S)
            if _is_hung_up():  # nobody can leave a panel that has no terminal
                self.end()

    def end(self) -> None:
        """End the panel, one that is stopped or hangs as well."""
        self._is_over = True
        self._process.terminate()
        self._watch.join(END_S)
        self._process.kill()

    def _wait(self) -> None:
        """When the panel has ended: set the terminal right, and write what was kept."""
        code = self._process.wait()
        if self._terminal is not None:
            with suppress(termios.error):
                termios.tcsetattr(0, termios.TCSAFLUSH, self._terminal)
        if code != 0:
            with suppress(OSError):
                os.write(self._outputs[0], LEAVE_SCREEN)
        _flush()
        for number, output in zip((1, 2), self._outputs, strict=True):
            os.dup2(output, number)
        with suppress(OSError), os.fdopen(self._outputs[0], "wb") as terminal:
            self._held.seek(0)
            shutil.copyfileobj(self._held, terminal)
            if not self._is_over:
                terminal.write(GOES_ON.format(folder=self._folder).encode())
        with suppress(OSError):
            os.close(self._outputs[1])
        self._held.close()


def check_terminal() -> None:
    """Raise PanelError when standard input or output is no terminal, or one that can't show the panel."""
    if not (os.isatty(0) and os.isatty(1)):
        raise PanelError("the panel needs a terminal; hil panel --web shows it in a browser")
    if os.environ.get("TERM") == "dumb":
        raise PanelError("the panel can't place its text in a terminal with TERM=dumb; use hil ctl watch and hil ctl")
    encoding = getattr(sys.stdout, "encoding", None) or "ascii"
    if codecs.lookup(encoding).name != "utf-8":
        raise PanelError(
            f"the panel draws in UTF-8, and this terminal has {encoding}: set LANG=C.UTF-8, or use hil ctl"
        )


def _is_hung_up() -> bool:
    """Whether the terminal was closed."""
    looked = select.poll()
    looked.register(0, 0)
    return any(event & select.POLLHUP for _, event in looked.poll(0))


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
