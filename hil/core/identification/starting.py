"""A start for the fit, nearer to the rig than its file may be: what the sensors show of tanks whose levels are known.

A tank that is known to be empty shows the offset of its sensor; a reading by a ruler then shows the gain. Where there
is no ruler, the sign of the gain is that of the readings' change since the tank was empty. A sensor that falls when the
level rises can't be reached from a file with a rising one by small steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isnan, nan

import numpy as np

from hil.core.identification.parameters import Choice, RigModel, with_values
from hil.core.identification.records import LevelRecord

WINDOW_S = 1.0
MIN_CHANGE_V = 0.2


def starting_point(
    records: Sequence[LevelRecord], start: RigModel, choices: Mapping[str, Choice], groups: Sequence[str]
) -> RigModel:
    """The rig from which the fit starts; only sensors whose parameters are free, or in these groups, are changed."""

    def is_open(group: str, tank: int) -> bool:
        choice = choices.get(f"{group}{tank + 1}", choices.get(group))
        return group in groups if choice is None else choice.role != "fixed"

    changed: dict[str, float] = {}
    for tank in range(4):
        offset_V = start.sensors.offset_V[tank]
        if is_open("sensor_offset", tank):
            offset_V = _known_offset(records, tank, offset_V)
            changed[f"sensor_offset{tank + 1}"] = offset_V
        if is_open("sensor_gain", tank):
            gain = _known_gain(records, tank, offset_V, start.sensors.gain_V_cm[tank])
            changed[f"sensor_gain{tank + 1}"] = gain
    return with_values(start, changed)


def _reading_at(record: LevelRecord, tank: int, time_s: float) -> float:
    """Median of the readings within `WINDOW_S` of a time; NaN where there are none, or they are saturated."""
    low_V, high_V = record.saturation_V
    near = record.reading_V[np.abs(record.time_s - time_s) <= 0.5 * WINDOW_S, tank]
    near = near[np.isfinite(near) & (near > low_V) & (near < high_V)]
    return float(np.median(near)) if len(near) else nan


def _known_offset(records: Sequence[LevelRecord], tank: int, file_V: float) -> float:
    """Reading of an empty tank, before any pump runs; the file's where no record begins with one."""
    for record in records:
        if record.initial_cm[tank] == 0.0:
            running = np.flatnonzero(record.voltage_V.max(axis=1) > 0.0)
            still_s = float(record.time_s[running[0]] if len(running) else record.time_s[-1]) - float(record.time_s[0])
            rows = record.time_s <= record.time_s[0] + max(still_s, 0.1 * WINDOW_S)
            early = record.reading_V[rows, tank]
            early = early[np.isfinite(early)]
            if len(early):
                return float(np.median(early))
    return file_V


def _known_gain(records: Sequence[LevelRecord], tank: int, offset_V: float, file_gain: float) -> float:
    """Least squares over the readings by a ruler; without one the file's gain with the sign that the readings show."""
    products = squares = 0.0
    for record in records:
        for read in record.ruler:
            shown_V = _reading_at(record, tank, read.time_s)
            if read.tank == tank and not isnan(shown_V):
                products += read.level_cm * (shown_V - offset_V)
                squares += read.level_cm**2
    if squares > 1.0 and products != 0.0:
        return products / squares
    empty = [record for record in records if record.initial_cm[tank] == 0.0]
    if not empty:
        return file_gain
    change_V = np.concatenate([record.reading_V[:, tank] for record in empty]) - offset_V
    change_V = change_V[np.isfinite(change_V)]
    if not len(change_V):
        return file_gain
    largest = float(change_V[np.argmax(np.abs(change_V))])
    return -file_gain if abs(largest) > MIN_CHANGE_V and largest * file_gain < 0.0 else file_gain
