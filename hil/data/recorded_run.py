"""A recorded run, read when it is asked for: `hil.open_run`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from datetime import datetime
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hil.core.counted import counted
from hil.edge.record.manifest import Manifest
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder

if TYPE_CHECKING:
    from pandas import DataFrame, Series

    from hil.data.polars_tables import PolarsTables

DBC = "bench.dbc"
BLOCK_BYTES = 1 << 20


class RecordedRun:
    """A run folder as tables. Opening it reads `run.json` alone; each table is read at its first use and then kept.

    Tables of what happened in time have the run time `t_s` in s as their index, so that `table.loc[200:350]` is a
    stretch of time; `table.attrs["units"]` is a dict from column to unit. A table is the same object at each use:
    take a `copy()` before you change it.

    Attributes
    ----------
    path : pathlib.Path
        The run folder.
    manifest : Manifest
        What was run and how it ended, as in `run.json`.

    """

    def __init__(self, folder: RunFolder) -> None:
        self.path = folder.path
        self.manifest: Manifest = folder.manifest()
        self._folder = folder

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.path.resolve().name

    @property
    def scenario(self) -> str:
        """Name of the scenario."""
        return self.manifest.plan.scenario

    @property
    def status(self) -> str:
        """`complete`, `stopped`, `tripped`, `failed` or `interrupted` (no end is recorded, or it goes on)."""
        return self.manifest.outcome

    @property
    def reason(self) -> str:
        """Why the run ended."""
        return self.manifest.reason

    @property
    def seed(self) -> int | None:
        """Of the emulator; None for a run in real time."""
        return self.manifest.plan.seed

    @property
    def period_s(self) -> float:
        """Time from one control step to the next, s."""
        return self.manifest.plan.period_s

    @property
    def started(self) -> datetime:
        """When the run began, with its time zone, UTC."""
        return datetime.fromisoformat(self.manifest.started_utc)

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings as nested dicts: `settings["rig"]["tanks"]["area_cm2"]`; `config` has the same as a series."""
        return self.manifest.plan.settings

    @cached_property
    def ticks(self) -> DataFrame:
        """Every control step, the columns of `ticks.csv` (docs/reference/signals.md); NaN for what is not known."""
        from hil.data.run_tables import ticks_table
        from hil.review.ticks import read_ticks

        return ticks_table(read_ticks(self._folder.ticks_path), self._signals)

    def select(self, *columns: str) -> DataFrame:
        """Some columns of `ticks` alone, for a long run. Raises RunFolderError for one that is not there."""
        from hil.data.run_tables import ticks_table
        from hil.review.ticks import Ticks, read_ticks

        if "ticks" in self.__dict__ and set(columns) <= set(self.ticks.columns):
            return self.ticks[list(columns)]
        found = read_ticks(self._folder.ticks_path, columns).columns
        missing = [name for name in columns if name not in found]
        if missing:
            raise RunFolderError(f"{self._folder.ticks_path} has no column {', '.join(missing)}")
        return ticks_table(Ticks({name: found[name] for name in ("t_s", *columns)}), self._signals)

    @cached_property
    def columns(self) -> DataFrame:
        """The columns of `ticks`: unit and meaning of each, by name."""
        from hil.data.run_tables import columns_table

        return columns_table(self._header.rstrip("\n").split(","), self._signals)

    @cached_property
    def frames(self) -> DataFrame:
        """Every CAN frame of `can.log`: channel, identifier, message (by the DBC), kind, length, data."""
        from hil.data.can_log import can_log_blocks
        from hil.data.run_tables import frames_table

        names = {message.frame_id: message.name for message in self.database.messages if not message.is_extended_frame}
        return frames_table(can_log_blocks(self._folder.can_log_path), self._zero_s, names)

    @cached_property
    def signals(self) -> Mapping[str, DataFrame]:
        """Message name -> its decoded signals, a row for each frame; a message is decoded at its first use."""
        from hil.data.decoded_messages import DecodedMessages

        return DecodedMessages(self._folder.can_log_path, self.database, self._zero_s)

    @cached_property
    def events(self) -> DataFrame:
        """Every event of `events.jsonl`: severity, code, text, data."""
        from hil.data.run_tables import events_table

        return events_table(self._logged)

    @cached_property
    def alarms(self) -> DataFrame:
        """What the fault detector reported: one row for each fault, the columns of `hil.Finding`."""
        from hil.data.run_tables import alarms_table
        from hil.review.alarms import merged

        return alarms_table(merged(event.data for event in self._logged if event.code == "alarm"))

    @cached_property
    def figures(self) -> Mapping[str, Any]:
        """The key figures as nested dicts, as in `kpi.json`; computed from the record where that file is missing."""
        path = self._folder.kpi_path
        if not path.is_file():
            from hil.review.kpi import COLUMNS, evaluate
            from hil.review.ticks import read

            ticks, events = read(self._folder, COLUMNS)
            return dict(json.loads(json.dumps(asdict(evaluate(self.manifest, ticks, events)))))
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise RunFolderError(f"{path} can't be read: {error}; `hil report` makes it again") from error
        if not isinstance(found, dict):
            raise RunFolderError(f"{path} has no key figures; `hil report` makes it again")
        return found

    @property
    def kpi(self) -> Series:
        """The key figures as a series; its index are paths such as `iae_Vs.gain_fall[0]`."""
        from hil.data.run_tables import flat

        return flat(self.figures, "kpi")

    @property
    def config(self) -> Series:
        """The settings as a series; its index are paths such as `rig.tanks.area_cm2[0]`."""
        from hil.data.run_tables import flat

        return flat(self.settings, "config")

    @property
    def windows(self) -> DataFrame:
        """The scenario's windows by name: from_s, to_s, covered_s, the IAE of outputs 1 and 2; NaN if not reached."""
        from hil.data.run_tables import windows_table

        return windows_table(self.manifest.plan.windows, self.figures)

    def window(self, name: str) -> DataFrame:
        """The control steps of one of the scenario's windows, both ends included. Raises KeyError."""
        found = {window.name: window for window in self.manifest.plan.windows}
        if name not in found:
            raise KeyError(f"the run has no window {name!r}; it has {', '.join(found) or 'none'}")
        return self.ticks.loc[found[name].from_s : found[name].to_s]

    def at(self, t_s: float) -> Series:
        """The control step in force at a run time: the last at or before it. Raises ValueError outside the record."""
        times = self.ticks.index
        if not len(times) or not times[0] <= t_s <= times[-1] + self.period_s:
            span = f"from {times[0]:g} to {times[-1]:g} s" if len(times) else "empty"
            raise ValueError(f"t_s = {t_s!r}: the record is {span}")
        return self.ticks.iloc[int(times.searchsorted(t_s, side="right")) - 1]

    @property
    def polars(self) -> PolarsTables:
        """The same tables as polars data frames, `t_s` as their first column. Raises HilError without polars."""
        from hil.data.polars_tables import PolarsTables

        return PolarsTables(self)

    @cached_property
    def database(self) -> Any:
        """The DBC that the run was recorded with, as a cantools database. Raises RunFolderError without its copy."""
        import cantools

        text = self.manifest.plan.copies.get(DBC)
        if text is None:
            raise RunFolderError(f"{self.path}: run.json has no copy of {DBC}, so its frames have no names")
        try:
            return cantools.database.load_string(text, "dbc")
        except Exception as error:  # noqa: BLE001 - cantools raises its parser's own errors, of many kinds
            reason = str(error).splitlines()[0]
            raise RunFolderError(f"{self._folder.manifest_path}: the copy of {DBC} is not a DBC: {reason}") from None

    def __len__(self) -> int:
        """How many control steps were recorded."""
        if "ticks" in self.__dict__:
            return len(self.ticks)
        try:
            with self._folder.ticks_path.open("rb") as file:
                lines = sum(block.count(b"\n") for block in iter(lambda: file.read(BLOCK_BYTES), b""))
        except OSError as error:
            raise RunFolderError(f"cannot read {self._folder.ticks_path}: {error.strerror}") from error
        return max(lines - 1, 0)

    def __bool__(self) -> bool:
        return True

    def __repr__(self) -> str:
        facts = ", ".join(f"{name} {value}" if name else value for name, value in self._facts())
        return f"<RecordedRun {self.path}: {facts}>"

    def _repr_html_(self) -> str:
        from hil.review.page import escape

        rows = [("scenario", self.scenario), ("folder", str(self.path)), ("started", self.manifest.started_utc)]
        rows += [(name or "length", value) for name, value in list(self._facts())[1:]]
        cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
        return f"<table>{cells}</table>"

    def _facts(self) -> Iterator[tuple[str, str]]:
        """What a reader sees first: names and values. Key figures only where kpi.json has them."""
        yield "scenario", self.scenario
        yield "status", f"{self.status} ({self.reason})" if self.reason else self.status
        try:
            yield "", counted(len(self), "control step")
        except RunFolderError as error:
            yield "", str(error)
        if not self._folder.kpi_path.is_file():
            return
        for key in ("alarms", "trips"):
            yield key, str(len(self.figures.get(key, ())))
        for name, (first_Vs, second_Vs) in self.figures.get("iae_Vs", {}).items():
            if self.figures.get("iae_covered_s", {}).get(name, 0.0) > 0.0:
                yield f"IAE {name}", f"{first_Vs:.3f}, {second_Vs:.3f} V s"

    @property
    def _header(self) -> str:
        """The first line of the table of control steps."""
        try:
            with self._folder.ticks_path.open(encoding="utf-8") as file:
                return file.readline()
        except (OSError, UnicodeDecodeError) as error:
            raise RunFolderError(f"cannot read {self._folder.ticks_path}: {error}") from error

    @cached_property
    def _signals(self) -> Any:
        from hil.data.run_tables import signals_of

        return signals_of(self.manifest.plan.mode, self.manifest.plan.shown)

    @cached_property
    def _logged(self) -> Any:
        from hil.review.ticks import read_events

        return read_events(self._folder.events_path)

    @property
    def _zero_s(self) -> float:
        zero_s = self.manifest.clock.run_zero_epoch_s
        if zero_s is None:
            raise RunFolderError(
                f"{self.path}: run.json has no time of the run's start, so its frames have no run time"
            )
        return zero_s
