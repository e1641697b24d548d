"""How `hil` ends, as a shell sees it."""

from __future__ import annotations

BAD_INPUT = 2
BY_STATUS = {"complete": 0, "stopped": 0, "tripped": 3, "failed": 4}
BY_SIGNAL = {"SIGHUP": 129, "SIGINT": 130, "SIGTERM": 143}
