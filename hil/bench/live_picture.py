"""A run that is shown in the Rerun viewer while it goes on."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace

from hil.bench.open_record import TimelineSettings
from hil.bench.run_options import LivePicture
from hil.review import viewer


def with_port(timeline: TimelineSettings | None, live: LivePicture | None) -> TimelineSettings | None:
    """The settings with a port on which the run is served, if it is to be shown."""
    if timeline is None or live is None:
        return timeline
    return replace(timeline, live_port=viewer.free_port())


def shown(timeline: TimelineSettings | None, live: LivePicture | None) -> AbstractContextManager[None]:
    """A viewer of the run, as a context around it."""
    if timeline is None or timeline.live_port is None:
        return nullcontext()
    return viewer.live_view(timeline.live_port, is_page=live == "page", say=say)


def say(text: str) -> None:
    """Write a line on standard error, if that can be written to."""
    with suppress(OSError):
        sys.stderr.write(f"hil: {text}\n")
