"""Exit codes of `hil`. They are documented in its help and in docs/how-to/operating.md; scripts rely on them.

    0    done
    2    bad input, or a record that can't be begun; nothing moved
    3    tripped; campaign: a run broke an invariant
    4    not ready, or failed; identify: nothing identified, or with --write: the rig file was not replaced (tune, too);
         ctl: refused, or no run to ask
    5    done, but a file of the record or standard output can't be written completely; the line says which
         identify --check: a parameter has moved from the rig file by more than the limit
    6    test: a run has not kept a limit of its scenario; replay: other commands than recorded
    129, 130, 143  stopped by SIGHUP, SIGINT, SIGTERM

A run that did not end well keeps its code when its record is incomplete, too: the line says both.
"""

from __future__ import annotations

BAD_INPUT = 2
BROKEN_INVARIANT = 3
NOT_DONE = 4
INCOMPLETE = 5
MOVED = 5
"""Of `hil identify --check`."""
LIMIT_NOT_KEPT = 6
"""Of `hil test`."""
DIFFERS = 6
"""Of `hil replay`."""
BY_STATUS = {"complete": 0, "stopped": 0, "tripped": 3, "failed": 4}
BY_SIGNAL = {"SIGHUP": 129, "SIGINT": 130, "SIGTERM": 143}


def is_by_signal(reason: str) -> bool:
    """Whether a signal has stopped the run. reason : its name first, if so."""
    return reason.partition(";")[0] in BY_SIGNAL


def of_run(status: str, reason: str, *, is_incomplete: bool = False) -> int:
    """Of a run that ended so. reason : the name of a signal first, where one stopped the run."""
    code = BY_SIGNAL.get(reason.partition(";")[0], BY_STATUS[status])
    return code or (INCOMPLETE if is_incomplete else 0)
