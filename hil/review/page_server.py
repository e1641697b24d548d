"""Rerun's server of a page, ended with the program that wants it: `python -m hil.review.page_server ARGUMENT...`.

It runs until its standard input is closed, which a program that ends does in every way of ending, a kill too.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading


def main(arguments: list[str]) -> int:
    """Run Rerun's program with these arguments until it ends or standard input does; its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the program that wants the page decides
    command = [sys.executable, "-m", "rerun_cli", *arguments]
    server = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)  # noqa: S603 - our own

    def watch() -> None:
        while os.read(0, 1024):
            pass
        os.killpg(server.pid, signal.SIGKILL)  # a session of its own: the launcher and Rerun's program

    threading.Thread(target=watch, name="watch", daemon=True).start()
    return server.wait()


if __name__ == "__main__":
    os._exit(main(sys.argv[1:]) & 0xFF)  # the watching thread still waits
