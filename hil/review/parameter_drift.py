"""What a run says about its rig file: the record of its control steps, and how far the parameters have moved.

`kpi.json` has it as `parameters`, the report as a table with sentences. Why and how: `hil.core.identification.drift`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from math import inf

import numpy as np

from hil.core.identification.drift import ALL_CHECKED, Drift, drift_of
from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.sensors import LevelSensors
from hil.edge.config.rig_file import Rig
from hil.edge.config.settings_file import SettingsError, validated
from hil.edge.record.manifest import Manifest
from hil.review.alarms import merged
from hil.review.ticks import Floats, LoggedEvent, Ticks

MAX_STEPS = 6000
"""A longer record is cut to the stretch of so many steps in which the voltages move most: a second or two of fit."""
BEFORE_S = 5.0
"""The record ends so long before the onset of the first fault that was named."""
SECONDS_PER_H = 3600.0
SHOWN_SDS, SHOWN_SHARE, CERTAIN_SDS = 2.0, 0.01, 3.0
MIN_HOURS = 0.1
"""A rate over a shorter time says nothing."""


def drift_of_run(manifest: Manifest, ticks: Ticks, events: Sequence[LoggedEvent]) -> Drift | None:
    """The run's verdict on its rig file; None where run.json has no rig that can be used."""
    try:
        rig = validated(Rig, dict(manifest.plan.settings["rig"]), "run.json")
    except (SettingsError, KeyError, TypeError, ValueError):
        return None
    return drift_from(rig, ticks, events)


def drift_from(rig: Rig, ticks: Ticks, events: Sequence[LoggedEvent]) -> Drift:
    """The verdict of a run on a rig file, its own or another one of the same rig. Never raises."""
    record = record_of_ticks(ticks, events, rig)
    if record is None:
        return Drift((), ALL_CHECKED, "no control steps without a fault")
    try:
        return drift_of(record, signal_model(rig), rig.uncertainty.of_each)
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Drift((), ALL_CHECKED, f"the fit failed: {error}")


def signal_model(rig: Rig) -> RigModel:
    """The rig file's model whose readings are level signals."""
    gain = rig.level_sensors.signal_gain
    sensors = LevelSensors((gain,) * 4, range_V=rig.sensors.range_V)
    return RigModel(rig.tank_model, rig.pump_path, sensors, rig.lags_s, rig.signal_noise)


def record_of_ticks(ticks: Ticks, events: Sequence[LoggedEvent], rig: Rig) -> LevelRecord | None:
    """The control steps until the first named fault, as a record of level signals; None for fewer than two.

    The voltages of a step are those that the pump node reports at the next one: they have been applied in between.
    """
    until_s = first_fault_s(events)
    keep = np.flatnonzero(np.isfinite(ticks["t_s"]) & (ticks["t_s"] < until_s))
    if len(keep) < 3:
        return None
    voltage_V = ticks.stack("v1_applied_V", "v2_applied_V")[keep][1:]
    reading_V = ticks.stack("h1_V", "h2_V", "h3_V", "h4_V")[keep][:-1]
    time_s = ticks["t_s"][keep][:-1]
    first = busiest(voltage_V, MAX_STEPS)
    time_s, voltage_V, reading_V = (column[first : first + MAX_STEPS] for column in (time_s, voltage_V, reading_V))
    usable = np.isfinite(voltage_V).all(axis=1) & (np.diff(time_s, prepend=-inf) > 0.0)
    if usable.sum() < 2:
        return None
    return LevelRecord(
        name="run",
        time_s=time_s[usable],
        voltage_V=voltage_V[usable],
        reading_V=reading_V[usable],
        saturation_V=rig.sensors.range_V if rig.level_sensors.is_plain else (-inf, inf),
    )


def first_fault_s(events: Sequence[LoggedEvent]) -> float:
    """When the first named fault began, less `BEFORE_S`; inf without one."""
    onsets = [
        finding.onset_s if finding.onset_s is not None else finding.detected_s or 0.0
        for finding in merged(event.data for event in events if event.code == "alarm")
    ]
    trips = [event.t_s for event in events if event.code == "trip"]
    return min([*(onset_s - BEFORE_S for onset_s in onsets), *trips], default=inf)


def busiest(voltage_V: Floats, width: int) -> int:
    """The first row of the stretch of so many rows in which the voltages (n, 2) vary most; 0 for a short record."""
    starts = range(0, len(voltage_V) - width + 1, width // 4)
    return max(starts, key=lambda at: float(np.nanvar(voltage_V[at : at + width], axis=0).sum()), default=0)


def parameters_json(drift: Drift, hours: float | None) -> dict[str, dict[str, float | None]]:
    """The key `parameters` of kpi.json. hours : since the rig file was written; None: not known."""
    return {
        one.name: {
            "file": one.file,
            "estimate": rounded(one.estimate),
            "sd": rounded(one.sd),
            "shift_sd": rounded(one.shift_sd),
            "per_hour": None if hours is None else rounded((one.estimate - one.file) / hours),
        }
        for one in drift.moved
    }


def rounded(value: float) -> float:
    """To six digits: the last ones of a fit are not the same on all processors."""
    return float(f"{value:.6g}")


def has_moved(value: Mapping[str, float | None]) -> bool:
    """Whether a move is worth a sentence.

    That is two standard deviations of file and run together; or one per cent, where the run alone is certain of it.
    """
    file, estimate, sd, shift_sd = value["file"], value["estimate"], value["sd"], value["shift_sd"]
    assert file is not None and estimate is not None and sd is not None  # noqa: S101, PT018 - never None there
    move = abs(estimate - file)
    return abs(shift_sd or 0.0) >= SHOWN_SDS or move > max(SHOWN_SHARE * file, CERTAIN_SDS * sd)


def hours_since_file(manifest: Manifest) -> float | None:
    """From the last change of the rig file to the start of the run; None where run.json does not say, or for less."""
    written = manifest.plan.settings.get("rig_file_utc")
    if not isinstance(written, str):
        return None
    passed = datetime.fromisoformat(manifest.started_utc) - datetime.fromisoformat(written)
    hours = passed.total_seconds() / SECONDS_PER_H
    return hours if hours > MIN_HOURS else None


def file_words(manifest: Manifest) -> str:
    """How sentences name the rig file: with its day where it is known."""
    written = manifest.plan.settings.get("rig_file_utc")
    if not isinstance(written, str):
        return "the rig file says"
    day = datetime.fromisoformat(written)
    return f"the rig file of {day.day} {day:%B} says"


def sentence(name: str, value: Mapping[str, float | None], than: str) -> str:
    """What a move means: "pump 1 gives 3.1 % less than the rig file says (1.0 standard deviations)"."""
    file, estimate, shift_sd = value["file"], value["estimate"], value["shift_sd"]
    assert file is not None and estimate is not None and shift_sd is not None  # noqa: S101, PT018 - never None there
    share = estimate / file - 1.0
    group, number = name.rstrip("1234"), name[-1]
    subject, less, more = {
        "k": (f"pump {number} gives", "less", "more"),
        "gamma": (f"the valve of pump {number} passes", "less to the lower tank", "more to the lower tank"),
        "a": (f"the outlet of tank {number} is", "narrower", "wider"),
    }[group]
    return (
        f"{subject} {100.0 * abs(share):.2g} % {less if share < 0.0 else more} than {than} "
        f"({abs(shift_sd):.1f} standard deviations)"
    )
