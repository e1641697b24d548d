"""The end of a check that a signal has stopped."""

from __future__ import annotations

import sys

from hil.cli import exit_codes


def interrupted(signal_name: str) -> int:
    """Say so in one line; the exit code."""
    sys.stderr.write(f"hil: stopped by {signal_name}; the pump node was told 0 V\n")
    return exit_codes.BY_SIGNAL[signal_name]
