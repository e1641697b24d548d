"""Messages of several tables, each read a stretch at a time, in the order of their time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf

import numpy as np

from hil.export.mcap_chunks import MessageRows

Tables = Iterator[list[MessageRows]]

SLACK_NS = 1_000_000_000
"""The lines of a log are in the order in which they were written: a frame may be later than its neighbours by this."""


class InOrder:
    """Yields messages of all sources, and none that a later stretch of any source could be earlier than.

    A source gives stretches whose times rise, but for SLACK_NS. What is later still, as after a clock was set back,
    comes when it is there.
    """

    def __init__(self, sources: Sequence[Tables]) -> None:
        self._sources: dict[int, Tables] = dict(enumerate(sources))
        self._known_ns: dict[int, float] = dict.fromkeys(self._sources, -inf)
        self._waiting: list[MessageRows] = []

    def __iter__(self) -> Iterator[list[MessageRows]]:
        """Stretches of time, one after the other."""
        while self._sources:
            behind = min(self._sources, key=self._known_ns.__getitem__)
            before_ns = min(self._known_ns.values())
            self._read(behind)
            until_ns = min(self._known_ns.values(), default=inf)
            if until_ns > before_ns:
                yield self._taken(until_ns)
        yield self._waiting

    def _read(self, source: int) -> None:
        found = next(self._sources[source], None)
        if found is None:
            del self._sources[source], self._known_ns[source]
            return
        self._waiting += found
        latest_ns = max((int(rows.time_ns.max()) - SLACK_NS for rows in found if len(rows)), default=-inf)
        self._known_ns[source] = max(self._known_ns[source], latest_ns)

    def _taken(self, until_ns: float) -> list[MessageRows]:
        """What waits and is not later than that."""
        now, later = [], []
        for rows in self._waiting:
            is_due = rows.time_ns <= until_ns
            if is_due.all():
                now.append(rows)
                continue
            if is_due.any():
                now.append(rows.taken(is_due))
            later.append(rows.taken(np.logical_not(is_due)))
        self._waiting = later
        return now
