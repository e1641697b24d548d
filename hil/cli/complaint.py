"""Lines on standard error: the one with which a command ends that did not do what was asked, and warnings."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import typer

from hil.cli import exit_codes


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
    """Ctrl-C inside ends the command with one line, too; typer alone would end it without a word."""
    try:
        yield
    except KeyboardInterrupt:
        raise typer.Exit(complain("interrupted", exit_codes.BY_SIGNAL["SIGINT"])) from None
