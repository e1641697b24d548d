"""A recorded run as tables with units: control steps, events, frames, and the signals of each message of the DBC."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.data.can_log import CanLog, read_can_log
from hil.edge.record.log_file import find_log, open_log
from hil.edge.record.run_folder import Manifest, RunFolder, RunFolderError
from hil.edge.record.signals import recorded
from hil.review.ticks import LoggedEvent, Ticks, read_events, read_ticks

Array = npt.NDArray[Any]

DBC = "bench.dbc"
EPOCH_TIME = "time since 1970-01-01 00:00 UTC; of a simulated run, since its start"
RUN_TIME = "run time, as in the table of control steps; NaN if the run had no control step"
MICROSECONDS = 6
SENT_MARK = b" T"
MAX_NAME = 63


@dataclass(frozen=True, eq=False)
class ExportColumn:
    """One column. values : (n,), numbers or text. choices : names of numbers that stand for states."""

    name: str
    values: Array
    unit: str = ""
    meaning: str = ""
    choices: Mapping[float, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ExportTable:
    """Columns of one length. time_s : (n,) since the epoch, for formats whose rows have a time of their own."""

    name: str
    time_s: npt.NDArray[np.float64]
    columns: tuple[ExportColumn, ...]

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, eq=False)
class RunTables:
    """What a run folder has.

    zero_s : run time 0 since the epoch, NaN where it is not known. is_sent : (n,) of each frame, whether the controller
    sent it. dbc : text of the wire's contract, "" if the folder has no copy.
    """

    folder: RunFolder
    manifest: Manifest
    zero_s: float
    ticks: Ticks
    logged: tuple[LoggedEvent, ...]
    frames: CanLog
    is_sent: npt.NDArray[np.bool_]
    dbc: str

    @property
    def description(self) -> dict[str, str]:
        """What a file says of the run it is of."""
        plan = self.manifest.plan
        seed = {} if plan.seed is None else {"seed": str(plan.seed)}
        return {
            "run": self.folder.path.resolve().name,
            "scenario": plan.scenario,
            "mode": plan.mode,
            "status": self.manifest.outcome,
            "reason": self.manifest.reason,
            "started_utc": self.manifest.started_utc,
            "program": f"fourtank-hil {self.manifest.versions.get('hil', '')}".strip(),
            "run_zero_epoch_s": repr(self.zero_s),
            **seed,
        }

    def control_steps(self) -> ExportTable:
        """The table of ticks.csv."""
        plan = self.manifest.plan
        known = {signal.column: signal for signal in recorded(plan.mode, plan.shown)}
        columns = []
        for name, values in self.ticks.columns.items():
            signal = known.get(name)
            columns.append(ExportColumn(name, values, *((signal.unit, signal.meaning) if signal else ())))
        return ExportTable("ticks", self._since_epoch(self.ticks["t_s"]), tuple(columns))

    def events(self) -> ExportTable:
        """Events with their data as text in JSON."""
        t_s = np.array([event.t_s for event in self.logged], dtype=np.float64)
        text = {
            "severity": ("", [event.severity for event in self.logged]),
            "code": ("which kind of event it is", [event.code for event in self.logged]),
            "text": ("", [event.text for event in self.logged]),
            "data": ("numbers of the event, as JSON", [json.dumps(event.data) for event in self.logged]),
        }
        columns = [ExportColumn(name, np.array(all_, dtype=object), "", what) for name, (what, all_) in text.items()]
        return ExportTable("events", self._since_epoch(t_s), (ExportColumn("t_s", t_s, "s", "run time"), *columns))

    def frame_columns(self) -> ExportTable:
        """Frames, all but their data."""
        log = self.frames
        names = np.array(log.channels or ("",), dtype=object)
        columns = (
            *self._times(log.time_s),
            ExportColumn("channel", names[log.channel], "", "name of the bus"),
            ExportColumn("arbitration_id", log.arbitration_id.astype(np.int64), "", "identifier"),
            ExportColumn("is_extended", log.is_extended, "", "whether the identifier has 29 bits"),
            ExportColumn("is_remote", log.is_remote, "", "whether it is a remote frame"),
            ExportColumn("is_error", log.is_error, "", "whether the bus reports an error"),
            ExportColumn("is_sent", self.is_sent, "", "whether the controller sent it"),
            ExportColumn("length", log.length.astype(np.int32), "B", "number of data bytes"),
        )
        return ExportTable("frames", log.time_s, columns)

    def messages(self) -> Iterator[ExportTable]:
        """Signals of each message that has frames, decoded one message at a time: all at once need much memory."""
        from hil.data.decode import decode

        database = self._database()
        for message in database.messages if database is not None else ():
            table = decode(self.frames, database, [message.name])[message.name]
            if len(table):
                about = {signal.name: (signal.comment or "").strip() for signal in message.signals}
                columns = (
                    ExportColumn(name, values, table.units[name], about[name], table.choices.get(name, {}))
                    for name, values in table.columns.items()
                )
                yield ExportTable(message.name, table.time_s, (*self._times(table.time_s), *columns))

    def _times(self, time_s: npt.NDArray[np.float64]) -> tuple[ExportColumn, ExportColumn]:
        run_s = np.round(time_s - self.zero_s, MICROSECONDS)
        return ExportColumn("time_s", time_s, "s", EPOCH_TIME), ExportColumn("t_s", run_s, "s", RUN_TIME)

    def _since_epoch(self, t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        zero_s = 0.0 if np.isnan(self.zero_s) else self.zero_s
        since: npt.NDArray[np.float64] = np.round(t_s + zero_s, MICROSECONDS)
        return since

    def _database(self) -> Any:
        """The folder's own DBC as a cantools database; None if it has no copy."""
        import cantools

        if not self.dbc:
            return None
        try:
            return cantools.database.load_string(self.dbc, database_format="dbc")
        except Exception as error:  # noqa: BLE001 - cantools raises its parser's own errors, of many kinds
            reason = str(error).splitlines()[0]
            raise RunFolderError(f"{self.folder.manifest_path}: the copy of {DBC} is not a DBC: {reason}") from None


def identifier(name: str) -> str:
    """A name as a field's name: letters, digits and underscores, a letter first, no longer than MATLAB reads."""
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)
    return (plain if plain[:1].isalpha() else f"x{plain}")[:MAX_NAME]


def read_run(path: Path) -> RunTables:
    """Read a run folder, also of a run that was killed.

    Raises NoRunFolderError when it is none, RunFolderError when a file of it is missing or damaged.
    """
    folder = RunFolder.open(path)
    manifest = folder.manifest()
    frames = read_can_log(folder.can_log_path)
    zero_s = manifest.clock.run_zero_epoch_s
    return RunTables(
        folder=folder,
        manifest=manifest,
        zero_s=np.nan if zero_s is None else zero_s,
        ticks=read_ticks(folder.ticks_path),
        logged=read_events(folder.events_path),
        frames=frames,
        is_sent=_sent(folder, frames),
        dbc=manifest.plan.copies.get(DBC, ""),
    )


def _sent(folder: RunFolder, frames: CanLog) -> npt.NDArray[np.bool_]:
    """Which frames are in sent.log, too: those with the time and the identifier of a line of it.

    Format 1 has no sent.log, but marks in can.log.
    """
    if not _has_log(folder.sent_log_path):
        with open_log(find_log(folder.can_log_path)) as stream:
            lines = stream.read().split(b"\n")[:-1]
        return np.array([line.rstrip().endswith(SENT_MARK) for line in lines if line], dtype=np.bool_)
    sent = read_can_log(folder.sent_log_path)
    return np.isin(frames.time_s, sent.time_s) & np.isin(frames.arbitration_id, np.unique(sent.arbitration_id))


def _has_log(path: Path) -> bool:
    try:
        find_log(path)
    except RunFolderError:
        return False
    return True
