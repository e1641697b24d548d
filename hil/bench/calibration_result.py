"""What a calibration leaves: points, figures, and the rig file with the sensors' gains and offsets as calibrated."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from difflib import unified_diff
from pathlib import Path
from typing import Any

from hil.core.identification.calibration import SensorLine
from hil.edge.config.rig_file import Rig
from hil.edge.config.rig_file_writer import rig_text_with
from hil.edge.config.settings_file import of_all, validated

POINTS_FILE, FIGURES_FILE, NEW_RIG_FILE = "points.csv", "calibration.json", "calibrated.toml"
GAIN_DIGITS, OFFSET_DIGITS = 5, 4
"""Decimals in the rig file: 0.01 mV/cm and 0.1 mV are below what a ruler can tell."""
INTERVAL_SDS = 1.96
"""Half the width of a 95 % interval, in standard deviations."""


def rig_values(rig: Rig, lines: Sequence[SensorLine]) -> dict[str, list[float]]:
    """The keys of the rig file that change, with their four values; those of other sensors stay."""
    gains, offsets = list(of_all(rig.sensors.gain_V_cm)), list(of_all(rig.sensors.offset_V))
    for line in lines:
        gains[line.tank] = round(line.gain_V_cm, GAIN_DIGITS) + 0.0
        offsets[line.tank] = round(line.offset_V, OFFSET_DIGITS) + 0.0  # no -0.0
    return {"sensors.gain_V_cm": gains, "sensors.offset_V": offsets}


def calibrated_text(path: Path, old: str, rig: Rig, lines: Sequence[SensorLine]) -> str:
    """The text of the rig file with the new values. Raises SettingsError when no run could use it.

    path : of the file, for messages. old : its text.
    """
    text = rig_text_with(old, rig_values(rig, lines))
    validated(Rig, tomllib.loads(text), f"{path} as calibrated")
    return text


def difference(old: str, new: str, old_name: str, new_name: str) -> str:
    """The lines that differ, as `diff -u` shows them; "" for the same text."""
    return "".join(
        unified_diff(old.splitlines(keepends=True), new.splitlines(keepends=True), old_name, new_name, n=1)
    ).rstrip("\n")


def figures(rig: Rig, lines: Sequence[SensorLine]) -> Mapping[str, Any]:
    """The content of `calibration.json`: 95 % intervals, the values before, the points and how far they miss."""
    gains, offsets = of_all(rig.sensors.gain_V_cm), of_all(rig.sensors.offset_V)
    return {
        "parameters": {
            name: value
            for line in lines
            for name, value in (
                (f"sensor_gain{line.tank + 1}", _row(line.gain_V_cm, line.gain_sd_V_cm, "V/cm", gains[line.tank])),
                (f"sensor_offset{line.tank + 1}", _row(line.offset_V, line.offset_sd_V, "V", offsets[line.tank])),
            )
        },
        "points": [
            {**asdict(point), "tank": point.tank + 1, "miss_cm": round(miss, 4)}
            for line in lines
            for point, miss in zip(line.points, line.misses_cm, strict=True)
        ],
    }


def figures_json(rig: Rig, lines: Sequence[SensorLine]) -> str:
    """The text of `calibration.json`."""
    return json.dumps(figures(rig, lines), indent=2, allow_nan=False) + "\n"


def _row(value: float, sd: float, unit: str, was: float) -> dict[str, Any]:
    half = INTERVAL_SDS * sd
    return {
        "value": value,
        "low": value - half,
        "high": value + half,
        "unit": unit,
        "was": was,
        "status": "identified",
    }
