"""Lines on standard error: the one with which a command ends that did not do what was asked, and warnings."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import typer

from hil.cli import exit_codes
from hil.edge.host.clock import EndingSignal


def complain(what: str, code: int) -> int:
    """Write the line; returns the exit code. Standard error that can't be written to changes nothing."""
    warn(what)
    return code


def warn(what: str) -> None:
    """Write a line of warning on standard error; nothing for an empty one, as when the help was shown instead."""
    line = " ".join(what.split())
    if line:
        with suppress(OSError):
            print(f"hil: {line}", file=sys.stderr, flush=True)  # noqa: T201 - plain text, never reflowed


def interrupted(signal_name: str) -> int:
    """The line and the exit code of a check that a signal has stopped."""
    return complain(f"stopped by {signal_name}; the pump node was told 0 V", exit_codes.BY_SIGNAL[signal_name])


@contextmanager
def interruptible() -> Iterator[None]:
    """Ctrl-C, SIGTERM or SIGHUP inside ends the command with one line, too, after all that has to be closed is closed.

    typer alone would end it without a word, and the system without anything being closed.
    """
    with EndingSignal() as ending:
        try:
            yield
        except KeyboardInterrupt:
            name = ending.received or "SIGINT"
            what = "interrupted" if name == "SIGINT" else f"stopped by {name}"
            raise typer.Exit(complain(what, exit_codes.BY_SIGNAL[name])) from None
