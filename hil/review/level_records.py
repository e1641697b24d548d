"""From a run folder to a record for identification: readings in V as the sensors gave them, voltages as applied.

Readings and their times are those of can.log. The voltages are those that the pump node reports in PumpStatus, every
50 ms; they hold from the moment of the command that asked for them, which sent.log has, on. Where no command explains
a voltage that the node reports (a node that has tripped), it holds from the status on.

Frames were checked when they were received; here the CRC alone is checked again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np

from hil.core.identification.records import Array, LevelRecord, RulerReading
from hil.edge.record.log_file import read_log_text
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import read_ticks
from hil.wire.contract import Contract, FrameSpec, crc8

APPLIED_TOLERANCE_V = 0.02
"""A reported voltage is that of a command if it is so close: the steps of the node's converter."""

SAME_TIME_S = 2e-3
"""The two level frames of one moment arrive within this time."""

WIRE_STEP_V = 2e-4
CONVERTER_BITS = (8, 10, 12)
MIN_DISTINCT = 6
"""Of 12 bit: six values lie on the steps by chance once in three million records."""

DBC = "bench.dbc"

MEAN_OF = 5
"""Readings of the level node, every 20 ms, in one mean: nothing is lost, and the fit takes a third of the time."""

REST_S = 3.0
BEFORE_S = 1e-3
EMPTY_CM = (0.0, 0.0, 0.0, 0.0)
UNKNOWN_CM = (nan, nan, nan, nan)


@dataclass(frozen=True, eq=False)
class Decoded:
    """The frames of one identifier. time_s : (n,) since the epoch. values : (n,) for each signal, in its unit."""

    time_s: Array
    values: dict[str, Array]

    def __getitem__(self, signal: str) -> Array:
        return self.values[signal]


def record_of_folder(path: Path, ruler: Sequence[RulerReading] = (), *, together: int = MEAN_OF) -> LevelRecord:
    """The record of a run, from its first control step to its last; times are run times.

    ruler : levels that were read in it. together : how many readings make one mean. The first phase of an experiment
    begins REST_S before the pumps first move, with empty tanks.

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
    voltages_V = without_rounding(voltages_V, manifest.plan.settings["rig"]["pumps"]["range_V"])
    begin_s, end_s = _span(folder, zero_s, time_s)
    low_V, high_V = manifest.plan.settings["rig"]["sensors"]["range_V"]
    is_empty = bool(manifest.plan.settings.get("experiment", {}).get("begins_empty"))
    moves_s = changes_s[voltages_V.any(axis=1)]
    if is_empty and len(moves_s):
        begin_s = max(begin_s, float(moves_s[0]) - REST_S)
    axis_s, voltage_V, level_V = on_one_axis(time_s, reading_V, changes_s, voltages_V, begin_s, end_s)
    if len(axis_s) < 2:
        raise RunFolderError(f"{path}: the record is too short")
    saturation_V = (float(low_V), float(high_V))
    axis_s, voltage_V, level_V, samples = in_means(axis_s, voltage_V, level_V, saturation_V, together)
    return LevelRecord(
        name=path.name,
        time_s=axis_s - zero_s,
        voltage_V=voltage_V,
        reading_V=level_V,
        samples=samples,
        saturation_V=saturation_V,
        initial_cm=EMPTY_CM if is_empty else UNKNOWN_CM,
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


def without_rounding(voltages_V: Array, range_V: Sequence[float]) -> Array:
    """(m, 2) reported voltages, as the steps of the node's converter where they all are such steps.

    PumpStatus has whole multiples of 0.2 mV. With few voltages in a record, that is an error of the gains of some
    0.003 %. A converter of 12 bit has steps of 2.4 mV, over all of its range: once MIN_DISTINCT values lie on them,
    they are known exactly.
    """
    low_V, high_V = range_V
    distinct_V = np.unique(voltages_V)
    for bits in CONVERTER_BITS:
        for steps in (2**bits - 1, 2**bits):
            step_V = (high_V - low_V) / steps
            snapped_V = low_V + np.round((distinct_V - low_V) / step_V) * step_V
            if len(distinct_V) >= MIN_DISTINCT and np.abs(snapped_V - distinct_V).max() <= 0.5 * WIRE_STEP_V + 1e-9:
                exact: Array = low_V + np.round((voltages_V - low_V) / step_V) * step_V
                return exact
    return voltages_V


def on_one_axis(
    time_s: Array, reading_V: Array, changes_s: Array, voltages_V: Array, begin_s: float, end_s: float
) -> tuple[Array, Array, Array]:
    """Readings and voltages on one axis of time within begin_s..end_s: a row for each reading and each change.

    The first row, BEFORE_S earlier, has the voltages from before begin_s: what a pump still gives depends on them.
    """
    first_s = begin_s - BEFORE_S
    changes = changes_s[(changes_s > first_s) & (changes_s < end_s)]
    within = (time_s >= begin_s) & (time_s <= end_s)
    axis = np.union1d(np.union1d(time_s[within], changes), [first_s])
    levels_V = np.full((len(axis), 4), np.nan)
    levels_V[np.searchsorted(axis, time_s[within])] = reading_V[within]
    index = np.clip(np.searchsorted(changes_s, axis, side="right") - 1, 0, len(changes_s) - 1)
    return axis, voltages_V[index], levels_V


def in_means(
    time_s: Array, voltage_V: Array, reading_V: Array, saturation_V: tuple[float, float], together: int
) -> tuple[Array, Array, Array, Array]:
    """The same with means of up to so many readings, at their mean time, and (m, 4) how many each is the mean of.

    No mean goes over a change of the voltages. A mean with a saturated reading in it would be wrong: where all of its
    readings are saturated the mean says so, otherwise there is none.
    """
    has_reading = np.isfinite(reading_V).any(axis=1)
    begins = np.concatenate([[True], (np.diff(voltage_V, axis=0) != 0.0).any(axis=1)])
    stretch = np.cumsum(begins) - begins  # the reading of the row that brings a change is from before it
    rows = np.flatnonzero(has_reading)
    first_of = np.searchsorted(stretch[rows], np.arange(stretch[-1] + 1))
    block = (np.arange(len(rows)) - first_of[stretch[rows]]) // together
    starts = np.flatnonzero(np.concatenate([[True], (np.diff(stretch[rows]) != 0) | (np.diff(block) != 0)]))
    if not len(rows):
        return time_s, voltage_V, reading_V, np.ones_like(reading_V)
    counts = np.diff(np.concatenate([starts, [len(rows)]]))
    values, (low_V, high_V) = reading_V[rows], saturation_V
    with np.errstate(invalid="ignore"):
        is_saturated = (values <= low_V) | (values >= high_V)
    saturated = np.add.reduceat(is_saturated.astype(float), starts)
    means = np.add.reduceat(values, starts) / counts[:, None]
    means[(saturated > 0) & (saturated < counts[:, None])] = np.nan
    mean_s = np.add.reduceat(time_s[rows], starts) / counts
    axis = np.union1d(mean_s, time_s[begins])
    level_V, samples = np.full((len(axis), 4), np.nan), np.ones((len(axis), 4))
    at = np.searchsorted(axis, mean_s)
    level_V[at], samples[at] = means, counts[:, None]
    index = np.clip(np.searchsorted(time_s[begins], axis, side="right") - 1, 0, None)
    return axis, voltage_V[begins][index], level_V, samples


def _span(folder: RunFolder, zero_s: float, time_s: Array) -> tuple[float, float]:
    """From the first control step to the last reading before the record ends."""
    ticks = read_ticks(folder.ticks_path)
    if len(ticks) < 2:
        raise RunFolderError(f"{folder.path}: ticks.csv has fewer than two control steps")
    return zero_s + float(ticks["t_s"][0]), min(float(time_s[-1]), zero_s + float(ticks["t_s"][-1]))


def _contract(folder: RunFolder) -> Contract:
    text = folder.manifest().plan.copies.get(DBC)
    if text is None:
        raise RunFolderError(f"{folder.path}: run.json has no copy of {DBC}")
    return Contract.from_dbc(text)


def _read_log(path: Path) -> dict[int, tuple[list[float], list[str]]]:
    """Times and payloads of the data frames in a log, by identifier; a half line at the end is left out."""
    text = read_log_text(path)
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
