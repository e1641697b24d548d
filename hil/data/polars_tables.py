"""The tables of a recorded run for polars, where it is installed. polars has no index: `t_s` is the first column."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hil.core.errors import HilError

if TYPE_CHECKING:
    from hil.data.recorded_run import RecordedRun


class PolarsTables:
    """The tables of a run as polars data frames, each converted at its first use. Raises HilError without polars."""

    def __init__(self, run: RecordedRun) -> None:
        try:
            import polars
        except ImportError as error:
            raise HilError("polars is not installed: `pip install polars`, or use the pandas tables") from error
        self._run, self._polars = run, polars

    @cached_property
    def ticks(self) -> Any:
        """As `RecordedRun.ticks`."""
        return self._of(self._run.ticks)

    def select(self, *columns: str) -> Any:
        """As `RecordedRun.select`."""
        return self._of(self._run.select(*columns))

    @cached_property
    def frames(self) -> Any:
        """As `RecordedRun.frames`."""
        return self._of(self._run.frames)

    @cached_property
    def signals(self) -> Mapping[str, Any]:
        """As `RecordedRun.signals`, but all messages at once."""
        return {name: self._of(table) for name, table in self._run.signals.items()}

    @cached_property
    def events(self) -> Any:
        """As `RecordedRun.events`; the data of an event as text in JSON."""
        import json

        table = self._run.events
        return self._of(table.assign(data=[json.dumps(data, ensure_ascii=False) for data in table["data"]]))

    @cached_property
    def alarms(self) -> Any:
        """As `RecordedRun.alarms`; targets as text."""
        table = self._run.alarms
        lists = {name: [list(value) for value in table[name]] for name in ("candidates", "first_candidates")}
        return self._of(table.assign(target=[str(target) for target in table["target"]], **lists))

    @cached_property
    def windows(self) -> Any:
        """As `RecordedRun.windows`."""
        return self._of(self._run.windows)

    def _of(self, table: Any) -> Any:
        named = table.reset_index() if table.index.name else table
        return self._polars.from_pandas(named)
