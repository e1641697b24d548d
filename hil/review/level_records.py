"""From a run folder to a record for identification: readings in V as the sensors gave them, voltages as applied.

Readings and their times are those of can.log. The voltages are those that the pump node reports in PumpStatus, every
50 ms; they hold from the moment of the command that asked for them, which sent.log has, on. Where no command explains
a voltage that the node reports (a node that has tripped), it holds from the status on.

Frames were checked when they were received; here the CRC alone is checked again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.core.identification.records import Array, LevelRecord, RulerReading
from hil.edge.record.run_folder import RunFolder, RunFolderError
from hil.wire.contract import Contract, FrameSpec, crc8

APPLIED_TOLERANCE_V = 0.02
"""A reported voltage is that of a command if it is so close: the steps of the node's converter."""

SAME_TIME_S = 2e-3
"""The two level frames of one moment arrive within this time."""

DBC = "bench.dbc"


@dataclass(frozen=True, eq=False)
class Decoded:
    """The frames of one identifier. time_s : (n,) since the epoch. values : (n,) for each signal, in its unit."""

    time_s: Array
    values: dict[str, Array]

    def __getitem__(self, signal: str) -> Array:
        return self.values[signal]


def record_of_folder(path: Path, ruler: Sequence[RulerReading] = ()) -> LevelRecord:
    """The record of a run, from its first control step to its last. ruler : with times in run time.

    Raises RunFolderError when the folder has no usable record.
    """
    folder = RunFolder.open(path)
    manifest = folder.manifest()
    zero_s = manifest.clock.run_zero_epoch_s
    if zero_s is None:
        raise RunFolderError(f"{path}: the run has no control step: nothing can be identified from it")
    contract = _contract(folder)
    lines = _read_log(folder.can_log_path)
    lower, upper = (decoded(lines, contract.frames[name]) for name in ("LowerLevels", "UpperLevels"))
    status = decoded(lines, contract.frames["PumpStatus"])
    sent = decoded(_read_log(folder.sent_log_path), contract.frames["PumpCommand"])
    if not len(lower.time_s) or not len(upper.time_s) or not len(status.time_s):
        raise RunFolderError(f"{path}: can.log has no level frames, or no PumpStatus")
    time_s, reading_V = readings(lower, upper)
    changes_s, voltages_V = applied_voltages(status, sent)
    begin_s, end_s = _span(folder, zero_s, sent, time_s)
    low_V, high_V = manifest.plan.settings["rig"]["sensors"]["range_V"]
    record = on_one_axis(time_s, reading_V, changes_s, voltages_V, begin_s, end_s)
    return LevelRecord(
        name=path.name,
        time_s=record[0] - zero_s,
        voltage_V=record[1],
        reading_V=record[2],
        saturation_V=(float(low_V), float(high_V)),
        ruler=tuple(ruler),
    )


def decoded(lines: dict[int, tuple[list[float], list[str]]], spec: FrameSpec) -> Decoded:
    """All frames of one identifier whose length and CRC are right."""
    times_s, payloads = lines.get(spec.frame_id, ([], []))
    whole = [(t, data) for t, text in zip(times_s, payloads, strict=True) if (data := _payload(text, spec)) is not None]
    raw = np.array([int.from_bytes(data, "little") for _, data in whole], dtype=np.uint64)
    values = {s.name: ((raw >> np.uint64(s.shift)) & np.uint64(s.mask)).astype(float) * s.scale for s in spec.signals}
    return Decoded(np.array([t for t, _ in whole], dtype=float), values)


def readings(lower: Decoded, upper: Decoded) -> tuple[Array, Array]:
    """(n,) times and (n, 4) readings, NaN where a channel is not valid or its frame is missing."""
    first = np.column_stack([np.where(lower[f"Status{i}"] == 0, lower[f"Level{i}"], np.nan) for i in (1, 2)])
    second = np.column_stack([np.where(upper[f"Status{i}"] == 0, upper[f"Level{i}"], np.nan) for i in (3, 4)])
    near = np.clip(np.searchsorted(upper.time_s, lower.time_s - SAME_TIME_S), 0, len(upper.time_s) - 1)
    is_near = np.abs(upper.time_s[near] - lower.time_s) <= SAME_TIME_S
    levels_V = np.full((len(lower.time_s), 4), np.nan)
    levels_V[:, :2] = first
    levels_V[is_near, 2:] = second[near[is_near]]
    keep = np.concatenate([[True], np.diff(lower.time_s) > 0.0])
    return lower.time_s[keep], levels_V[keep]


def applied_voltages(status: Decoded, sent: Decoded) -> tuple[Array, Array]:
    """(m,) times from which on (m, 2) voltages were applied, as reported by the node."""
    asked_V = np.column_stack([sent["Command1"], sent["Command2"]]) * sent["Enable"][:, None]
    times_s, voltages_V = [float(status.time_s[0])], [(float(status["Applied1"][0]), float(status["Applied2"][0]))]
    command = 0
    for t_s, v1, v2 in zip(status.time_s, status["Applied1"], status["Applied2"], strict=True):
        first = command
        while command < len(sent.time_s) and sent.time_s[command] < t_s:
            command += 1
        if (v1, v2) == voltages_V[-1]:
            continue
        change_s = t_s
        for index in range(command - 1, first - 1, -1):  # the newest command before the status that asked for it
            if np.abs(asked_V[index] - (v1, v2)).max() <= APPLIED_TOLERANCE_V:
                change_s = sent.time_s[index]
                break
        if change_s > times_s[-1]:
            times_s.append(float(change_s))
            voltages_V.append((float(v1), float(v2)))
        else:
            voltages_V[-1] = (float(v1), float(v2))
    return np.array(times_s), np.array(voltages_V)


def on_one_axis(
    time_s: Array, reading_V: Array, changes_s: Array, voltages_V: Array, begin_s: float, end_s: float
) -> tuple[Array, Array, Array]:
    """Readings and voltages on one axis of time within begin_s..end_s: a row for each reading and each change."""
    changes = changes_s[(changes_s > begin_s) & (changes_s < end_s)]
    within = (time_s >= begin_s) & (time_s <= end_s)
    axis = np.union1d(np.union1d(time_s[within], changes), [begin_s])
    levels_V = np.full((len(axis), 4), np.nan)
    levels_V[np.searchsorted(axis, time_s[within])] = reading_V[within]
    index = np.clip(np.searchsorted(changes_s, axis, side="right") - 1, 0, len(changes_s) - 1)
    return axis, voltages_V[index], levels_V


def _span(folder: RunFolder, zero_s: float, sent: Decoded, time_s: Array) -> tuple[float, float]:
    """From the first control step to the last reading before the record ends."""
    from hil.review.ticks import read_ticks

    ticks = read_ticks(folder.ticks_path)
    if len(ticks) < 2:
        raise RunFolderError(f"{folder.path}: ticks.csv has fewer than two control steps")
    del sent
    return zero_s + float(ticks["t_s"][0]), min(float(time_s[-1]), zero_s + float(ticks["t_s"][-1]))


def _contract(folder: RunFolder) -> Contract:
    text = folder.manifest().plan.copies.get(DBC)
    if text is None:
        raise RunFolderError(f"{folder.path}: run.json has no copy of {DBC}")
    return Contract.from_dbc(text)


def _read_log(path: Path) -> dict[int, tuple[list[float], list[str]]]:
    """Times and payloads of the data frames in a log, by identifier; a half line at the end is left out."""
    try:
        text = path.read_text(encoding="ascii", errors="replace")
    except OSError as error:
        raise RunFolderError(f"cannot read {path}: {error.strerror}") from error
    found: dict[int, tuple[list[float], list[str]]] = {}
    for line in text.split("\n")[:-1]:
        stamp, _, frame = line.split(" ", 2)
        name, _, payload = frame.partition("#")
        if len(name) != 3:  # extended and error frames have eight digits
            continue
        times_s, payloads = found.setdefault(int(name, 16), ([], []))
        times_s.append(float(stamp[1:-1]))
        payloads.append(payload)
    return found


def _payload(text: str, spec: FrameSpec) -> bytes | None:
    """The payload, or None if its length or CRC is wrong."""
    if len(text) != 2 * spec.length:
        return None
    data = bytes.fromhex(text)
    return data if crc8(data[:-1], spec.crc_start) == data[-1] else None
