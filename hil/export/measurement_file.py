"""One MF4 file (ASAM MDF 4): the frames as bus logging with the DBC embedded, the signals decoded, ticks and events."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from hashlib import md5
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hil.data.can_log import MAX_DATA, CanLog
from hil.edge.record.record_errors import RunFolderError
from hil.export.export_tables import DBC, ExportColumn, ExportTable, RunTables
from hil.export.frame_data import data_lengths

if TYPE_CHECKING:
    from asammdf import MDF, Signal

EXTRA = "mf4"
VERSION = "4.10"
TRANSMITTED = 1

TIMES = ("time_s", "t_s")
"""Columns that are the group's time, and no channel of it."""

HEAD = (("BusChannel", "<u1"), ("ID", "<u4"), ("IDE", "<u1"), ("DLC", "<u1"), ("DataLength", "<u1"))
WITH_DATA = (*HEAD, ("DataBytes", f"({MAX_DATA},)u1"), ("Dir", "<u1"), ("EDL", "<u1"), ("BRS", "<u1"), ("ESI", "<u1"))
KINDS = {
    "CAN_DataFrame": WITH_DATA,
    "CAN_RemoteFrame": (*HEAD, ("Dir", "<u1")),
    "CAN_ErrorFrame": WITH_DATA,
}
"""Channels of bus logging as the ASAM's standard for it names them."""


def write_mf4(run: RunTables, out: Path) -> None:
    """Groups of channels: raw frames, one for each message with its signals, ticks, events. Their time is run time.

    The file's start is run time 0. Numbers that stand for states have their names as a conversion.
    """
    from asammdf import MDF

    zero_s = _zero_s(run)
    with MDF(version=VERSION) as file:
        file.header.start_time = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=round(zero_s * 1e6))
        file.header.comment = "; ".join(f"{name}: {text}" for name, text in run.description.items() if text)
        _append_frames(file, run, zero_s)
        for table in (*run.messages(), run.control_steps(), run.events()):
            _append_table(file, table, zero_s)
        with out.open("w+b") as stream:  # given a path, it would add .mf4 to a name without it
            file.save(stream, compression=1)


def _zero_s(run: RunTables) -> float:
    """Run time 0 since the epoch; of a run without a control step, the time of its first frame."""
    if np.isfinite(run.zero_s):
        return run.zero_s
    return float(run.frames.time_s.min(initial=np.inf)) if len(run.frames) else 0.0


def _append_frames(file: MDF, run: RunTables, zero_s: float) -> None:
    from asammdf import Signal, Source
    from asammdf.blocks.v4_constants import BUS_TYPE_CAN, FLAG_CG_BUS_EVENT, SOURCE_BUS

    source = Source("CAN", ",".join(run.frames.channels), "", SOURCE_BUS, BUS_TYPE_CAN)
    text = run.dbc.encode()
    attachment = (text, Path(DBC), md5(text, usedforsecurity=False).digest()) if text else None
    log = run.frames
    chosen = {"CAN_RemoteFrame": log.is_remote, "CAN_ErrorFrame": log.is_error}
    chosen["CAN_DataFrame"] = ~(log.is_remote | log.is_error)
    for kind in KINDS:
        rows = np.flatnonzero(chosen[kind])
        if len(rows):
            rows = rows[np.argsort(log.time_s[rows], kind="stable")]
            times_s = _run_time(log.time_s[rows], zero_s)
            samples = _samples(kind, log[rows], run.is_sent[rows])
            signal = Signal(samples, times_s, name=kind, source=source, attachment=attachment)
            file.append(signal, acq_name="CAN", acq_source=source, common_timebase=True)
            group: Any = file.groups[-1].channel_group
            group.flags |= FLAG_CG_BUS_EVENT


def _samples(kind: str, log: CanLog, is_sent: npt.NDArray[np.bool_]) -> npt.NDArray[Any]:
    samples = np.zeros(len(log), dtype=[(f"{kind}.{name}", form) for name, form in KINDS[kind]])
    samples[f"{kind}.BusChannel"] = log.channel + 1
    samples[f"{kind}.ID"] = log.arbitration_id
    samples[f"{kind}.IDE"] = log.is_extended
    samples[f"{kind}.DLC"] = log.length
    samples[f"{kind}.DataLength"] = data_lengths(log)
    samples[f"{kind}.Dir"] = np.where(is_sent, TRANSMITTED, 0)
    if KINDS[kind] is WITH_DATA:
        samples[f"{kind}.DataBytes"] = log.data
    return samples


def _append_table(file: MDF, table: ExportTable, zero_s: float) -> None:
    from asammdf import Source

    if not len(table):
        return
    order = np.argsort(table.time_s, kind="stable")
    times_s = _run_time(table.time_s[order], zero_s)
    signals = [_signal(column, order, times_s) for column in table.columns if column.name not in TIMES]
    source = Source(table.name, table.name, "", 0, 0)
    file.append(signals, acq_name=table.name, acq_source=source, comment=table.name, common_timebase=True)


def _signal(column: ExportColumn, order: npt.NDArray[np.intp], times_s: npt.NDArray[np.float64]) -> Signal:
    from asammdf import Signal

    values = column.values[order]
    if values.dtype.kind == "O":
        texts = np.array([str(value).encode() for value in values])
        return Signal(texts, times_s, name=column.name, comment=column.meaning, encoding="utf-8")
    conversion: dict[str, object] | None = None
    if column.choices:
        conversion = {}
        for index, (number, text) in enumerate(sorted(column.choices.items())):
            conversion |= {f"val_{index}": number, f"text_{index}": text.encode()}
        conversion["default"] = b""
    return Signal(values, times_s, unit=column.unit, name=column.name, conversion=conversion, comment=column.meaning)


def _run_time(time_s: npt.NDArray[np.float64], zero_s: float) -> npt.NDArray[np.float64]:
    since: npt.NDArray[np.float64] = np.round(time_s - zero_s, 6)
    return since


def require() -> None:
    """Raise RunFolderError if asammdf is not there."""
    from importlib.util import find_spec

    if find_spec("asammdf") is None:
        raise RunFolderError(f"--to mf4 needs asammdf, which is not installed: pip install 'fourtank-hil[{EXTRA}]'")
