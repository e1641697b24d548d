"""A recorded run as tables with units: control steps, events, frames, and the signals of each message of the DBC."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.data.can_log import CanLog, can_log_blocks, read_can_log
from hil.edge.record.json_text import whole_text
from hil.edge.record.log_file import find_log, open_log
from hil.edge.record.manifest import Manifest
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.edge.record.signals import recorded
from hil.review.ticks import LoggedEvent, Ticks, read_events, read_ticks, tick_pieces

Array = npt.NDArray[Any]

DBC = "bench.dbc"
EPOCH_TIME = "time since 1970-01-01 00:00 UTC; of a simulated run, since its start"
RUN_TIME = "run time, as in the table of control steps; NaN if the run had no control step"
MICROSECONDS = 6
SENT_MARK = b" T"
MAX_NAME = 63
PIECE_BYTES = 1 << 22
"""Of a log so much is read at once: some 90 000 frames."""


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
class FramePiece:
    """A stretch of the log. is_sent : (n,) of each frame, whether the controller sent it."""

    log: CanLog
    is_sent: npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RunTables:
    """What a run folder has; control steps and frames are read when they are asked for, since a long run has many.

    zero_s : run time 0 since the epoch, NaN where it is not known. dbc : text of the wire's contract, "" if the folder
    has no copy.
    """

    folder: RunFolder
    manifest: Manifest
    zero_s: float
    logged: tuple[LoggedEvent, ...]
    sent: SentFrames
    dbc: str

    @cached_property
    def frames(self) -> CanLog:
        """All frames of the log."""
        return read_can_log(self.folder.can_log_path)

    @cached_property
    def is_sent(self) -> npt.NDArray[np.bool_]:
        """(n,) of each frame, whether the controller sent it."""
        return self.sent.of(self.frames, 0)

    def frame_pieces(self) -> Iterator[FramePiece]:
        """The frames, a stretch of the log at a time."""
        row = 0
        for log in can_log_blocks(self.folder.can_log_path, PIECE_BYTES):
            yield FramePiece(log, self.sent.of(log, row))
            row += len(log)

    def step_pieces(self) -> Iterator[ExportTable]:
        """The table of ticks.csv, a stretch of it at a time."""
        for piece in tick_pieces(self.folder.ticks_path):
            yield self._steps(piece)

    @property
    def description(self) -> dict[str, str]:
        """What a file says of the run it is of."""
        plan = self.manifest.plan
        seed = {} if plan.seed is None else {"seed": str(plan.seed)}
        return {
            "run": whole_text(self.folder.path.resolve().name),
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
        """The table of ticks.csv; it is not kept."""
        return self._steps(read_ticks(self.folder.ticks_path))

    def _steps(self, ticks: Ticks) -> ExportTable:
        plan = self.manifest.plan
        known = {signal.column: signal for signal in recorded(plan.mode, plan.shown)}
        columns = []
        for name, values in ticks.columns.items():
            signal = known.get(name)
            columns.append(ExportColumn(name, values, *((signal.unit, signal.meaning) if signal else ())))
        return ExportTable("ticks", self._since_epoch(ticks["t_s"]), tuple(columns))

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

    def frame_columns(self, piece: FramePiece | None = None) -> ExportTable:
        """Frames, all but their data. piece : of the log; None: all of it."""
        log, is_sent = (self.frames, self.is_sent) if piece is None else (piece.log, piece.is_sent)
        names = np.array(log.channels or ("",), dtype=object)
        columns = (
            *self._times(log.time_s),
            ExportColumn("channel", names[log.channel], "", "name of the bus"),
            ExportColumn("arbitration_id", log.arbitration_id.astype(np.int64), "", "identifier"),
            ExportColumn("is_extended", log.is_extended, "", "whether the identifier has 29 bits"),
            ExportColumn("is_remote", log.is_remote, "", "whether it is a remote frame"),
            ExportColumn("is_error", log.is_error, "", "whether the bus reports an error"),
            ExportColumn("is_sent", is_sent, "", "whether the controller sent it"),
            ExportColumn("length", log.length.astype(np.int32), "B", "number of data bytes"),
        )
        return ExportTable("frames", log.time_s, columns)

    def messages(self, log: CanLog | None = None) -> Iterator[ExportTable]:
        """Signals of each message that has frames, decoded one message at a time: all at once need much memory.

        log : a stretch of it; None: all of it.
        """
        from hil.data.decode import decode

        database = self._database
        for message in database.messages if database is not None else ():
            table = decode(self.frames if log is None else log, database, [message.name])[message.name]
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

    @cached_property
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
    zero_s = manifest.clock.run_zero_epoch_s
    return RunTables(
        folder=folder,
        manifest=manifest,
        zero_s=np.nan if zero_s is None else zero_s,
        logged=read_events(folder.events_path),
        sent=_sent(folder),
        dbc=manifest.plan.copies.get(DBC, ""),
    )


@dataclass(frozen=True, eq=False)
class SentFrames:
    """Which frames of a log the controller sent: those with the time and the identifier of a line of sent.log.

    time_s : (m,) of sent.log, sorted. arbitration_id : (k,) those in it. marks : (n,) for a log of format 1, which has
    marks and no sent.log; otherwise None.
    """

    time_s: npt.NDArray[np.float64]
    arbitration_id: npt.NDArray[np.uint32]
    marks: npt.NDArray[np.bool_] | None = None

    def of(self, log: CanLog, first_row: int) -> npt.NDArray[np.bool_]:
        """(n,) of each frame of a stretch of can.log. first_row : number of its first frame."""
        if self.marks is not None:
            return self.marks[first_row : first_row + len(log)]
        if not len(self.time_s):
            return np.zeros(len(log), np.bool_)
        found = np.isin(log.arbitration_id, self.arbitration_id)
        rows = np.flatnonzero(found)
        times_s = log.time_s[rows]
        place = np.minimum(np.searchsorted(self.time_s, times_s), len(self.time_s) - 1)
        found[rows] = self.time_s[place] == times_s
        return found


def _sent(folder: RunFolder) -> SentFrames:
    nothing = np.empty(0), np.empty(0, np.uint32)
    if _has_log(folder.sent_log_path):
        sent = read_can_log(folder.sent_log_path)
        return SentFrames(np.sort(sent.time_s), np.unique(sent.arbitration_id))
    with open_log(find_log(folder.can_log_path)) as stream:
        lines = stream.read().split(b"\n")[:-1]
    return SentFrames(*nothing, np.array([line.rstrip().endswith(SENT_MARK) for line in lines if line], dtype=np.bool_))


def _has_log(path: Path) -> bool:
    try:
        find_log(path)
    except RunFolderError:
        return False
    return True
