"""A process steps back behind the control thread, without any privilege."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

NICE = 10
"""A tenth of the processor time of an ordinary process where both want it: a stop still comes through beside others."""


def step_back(autogroup: Path = Path("/proc/self/autogroup")) -> None:
    """Get the processor after ordinary processes. What the system does not offer is left out.

    The nice value counts among the processes of one session; where Linux groups processes by session (sched(7),
    "The autogroup feature"), that of the group counts between sessions, and this process has a session of its own.
    """
    with suppress(OSError):
        os.nice(NICE)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    with suppress(OSError):
        autogroup.write_text(f"{NICE}\n", encoding="ascii")
