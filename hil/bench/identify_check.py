"""`hil identify RUN... --check`: what recorded runs say of the rig file, and how fast its parameters move."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.identification.drift import ALL_CHECKED, Drift, Moved, rate_per_hour
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.settings_file import SettingsError, validated
from hil.edge.record.manifest import Manifest
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.parameter_drift import SECONDS_PER_H, drift_from
from hil.review.ticks import read

CHECK_FILE, TREND_FILE = "check.json", "trend.png"
MIN_SPAN_H = 0.1
"""Runs that lie closer together show no rate."""


@dataclass(frozen=True, slots=True)
class CheckedRun:
    """A run and its verdict on the rig file. hours : since the first run."""

    name: str
    started_utc: str
    hours: float
    drift: Drift

    def moved(self, name: str) -> Moved | None:
        """A parameter's move; None where the run does not determine it."""
        return next((one for one in self.drift.moved if one.name == name), None)


@dataclass(frozen=True, slots=True)
class Check:
    """The runs in the order of their starts, and the rig file that they are compared with."""

    runs: tuple[CheckedRun, ...]
    file: str

    def newest(self, name: str) -> Moved | None:
        """The newest run's move of a parameter that is determined at all."""
        return next((moved for run in reversed(self.runs) if (moved := run.moved(name)) is not None), None)

    def rate(self, name: str) -> tuple[float, float] | None:
        """By how much a parameter moves per hour, relative to the file, with its standard deviation; None: unknown."""
        known = [(run.hours, moved) for run in self.runs if (moved := run.moved(name)) is not None]
        hours = np.array([hour for hour, _ in known])
        if len(known) < 2 or float(np.ptp(hours)) < MIN_SPAN_H:
            return None
        shares = np.array([moved.share for _, moved in known])
        sds = np.array([moved.sd / moved.file for _, moved in known])
        return rate_per_hour(hours, shares, sds)

    def beyond(self, limit_sd: float) -> tuple[Moved, ...]:
        """The newest moves of more than so many standard deviations."""
        newest = [moved for name in ALL_CHECKED if (moved := self.newest(name)) is not None]
        return tuple(moved for moved in newest if abs(moved.shift_sd) > limit_sd)

    def to_json(self, limit_sd: float) -> str:
        """The text of `check.json`."""
        content: dict[str, Any] = {
            "file": self.file,
            "limit_sd": limit_sd,
            "beyond": [moved.name for moved in self.beyond(limit_sd)],
            "runs": [
                {
                    "name": run.name,
                    "started_utc": run.started_utc,
                    "why_not": run.drift.why,
                    "parameters": {
                        one.name: {
                            "file": one.file,
                            "estimate": one.estimate,
                            "sd": one.sd,
                            "shift_sd": one.shift_sd,
                        }
                        for one in run.drift.moved
                    },
                }
                for run in self.runs
            ],
            "per_hour": {
                name: {"share": rate[0], "sd": rate[1]} for name in ALL_CHECKED if (rate := self.rate(name)) is not None
            },
        }
        return json.dumps(content, indent=2, allow_nan=False) + "\n"


def check_runs(paths: Sequence[Path], rig_path: Path | None = None) -> Check:
    """Compare runs with a rig file. rig_path : None for the rig with which the newest run was made.

    Raises RunFolderError, SettingsError.
    """
    opened = sorted(((RunFolder.open(path), path) for path in paths), key=lambda one: one[0].manifest().started_utc)
    manifests = [folder.manifest() for folder, _ in opened]
    rig = load_rig(rig_path) if rig_path is not None else recorded_rig(manifests[-1], opened[-1][1])
    first = datetime.fromisoformat(manifests[0].started_utc)
    runs = []
    for (folder, path), manifest in zip(opened, manifests, strict=True):
        hours = (datetime.fromisoformat(manifest.started_utc) - first).total_seconds() / SECONDS_PER_H
        runs.append(CheckedRun(path.name, manifest.started_utc, hours, drift_from(rig, *read(folder))))
    return Check(tuple(runs), str(rig_path) if rig_path is not None else f"the rig file of {opened[-1][1]}")


def recorded_rig(manifest: Manifest, path: Path) -> Rig:
    """The rig with which a run was made. Raises RunFolderError."""
    try:
        return validated(Rig, dict(manifest.plan.settings["rig"]), f"{path}/run.json")
    except (SettingsError, KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            f"{path}: run.json has no rig that can be used ({error}); name a rig file by --rig"
        ) from None
