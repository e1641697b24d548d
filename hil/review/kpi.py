"""Key figures of a run, `kpi.json`: control error, alarms and trips, timing of the loop."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from hil.core.sensors import signal_gain
from hil.core.types import Mode
from hil.edge.record.file_writing import write_atomically
from hil.edge.record.manifest import Manifest, RunPlan, Window
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.alarm_load import AlarmLoad, alarm_load
from hil.review.alarms import Injected, injected, judge, merged
from hil.review.parameter_drift import drift_of_run, hours_since_file, parameters_json
from hil.review.run_measures import absolute_error_integral, after_fault_window, dry_run
from hil.review.step_response import response_figures
from hil.review.ticks import Floats, LoggedEvent, Ticks, read

LEVELS = ("1", "2", "3", "4")
COLUMNS = (
    *("t_s", "mode", "r1_V", "r2_V", "h1_est_V", "h2_est_V", "v1_applied_V", "v2_applied_V"),
    *(f"h{tank}_V" for tank in LEVELS), *(f"true_h{tank}_cm" for tank in LEVELS),
    *("skipped", "rejected", "lateness_s", "latency_s", "recorder_queue"),
)  # fmt: skip
"""What the figures are computed from: all that is kept in memory of a tick table."""

CONTROLLING = [mode.value for mode in Mode if mode.is_controlling]
Finite = float | None  # None: not known
Known = bool | None

LATENESS_QUANTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999, "max": 1.0}
LATENCY_QUANTILES = {"p50": 0.5, "p99": 0.99, "max": 1.0}

RANGE_TOLERANCE_V = 1e-4
HEIGHT_TOLERANCE_CM = 1e-6


@dataclass(frozen=True, slots=True)
class Kpi:
    """The figures as `kpi.json` has them; None where the run was too short or the value is not known.

    iae_Vs : window -> outputs 1, 2, of the reference asked for against the level. iae_covered_s : how much of the
    window the record covers. settling_s, overshoot_cm, overshoot_at_s : window -> outputs 1, 2, see
    `hil.review.step_response`; None where the run ended before the window. level_max_at_s : when each tank had its
    highest level. ticks : steps in control, arming and ramp left out. duration_s : from time 0 on, without
    the start_phase_s before it. commands : how many were sent, how many of them the pump node did not accept, how many
    frames were lost. lateness_s : quantiles of how late the steps began. latency_s : quantiles of the time from the
    arrival of the newest frame that a step could use to the sending of its command. recorder_queue_max : most entries
    that waited for the recorder.

    alarms : one entry for each reported fault, see `hil.review.alarms.Finding`. false_alarms : those before the first
    fault, spurious_alarms : later ones that report no fault of the scenario; None where its faults are not known.
    alarm_load : see `hil.review.alarm_load`. iae_after_fault_Vs : from the first fault's onset to the end of its
    window, or of the run. overflow : a level reached the rim. dry_run : a pump ran without water.
    applied_out_of_range : a pump's voltage was outside the rig file's range.

    parameters : what the run says of the rig file, for each gain, split and outlet that its movement determines: file,
    estimate, sd, shift_sd (in standard deviations of both), per_hour. parameters_note : why there are none.
    """

    scenario: str
    status: str
    reason: str
    reconfigure: bool
    iae_Vs: dict[str, tuple[float, float]]
    iae_source: Literal["truth", "estimate"]
    iae_covered_s: dict[str, float]
    settling_s: dict[str, tuple[Finite, Finite] | None]
    overshoot_cm: dict[str, tuple[Finite, Finite] | None]
    overshoot_at_s: dict[str, tuple[Finite, Finite] | None]
    applied_max_V: tuple[Finite, Finite]
    level_max_cm: tuple[Finite, Finite, Finite, Finite]
    level_max_at_s: tuple[Finite, Finite, Finite, Finite]
    iae_after_fault_Vs: tuple[float, float] | None
    alarms: tuple[dict[str, Any], ...]
    false_alarms: int | None
    spurious_alarms: int | None
    overflow: Known
    dry_run: Known
    applied_out_of_range: Known
    trips: tuple[dict[str, Any], ...]
    ticks: int
    duration_s: float
    start_phase_s: float
    skipped: int
    rejected: int
    commands: dict[str, Any]
    lateness_s: dict[str, Finite]
    latency_s: dict[str, Finite]
    recorder_queue_max: Finite
    recorder: dict[str, Any]
    speed_x: float | None
    alarm_load: AlarmLoad
    parameters: dict[str, dict[str, Finite]] = field(default_factory=dict)
    parameters_note: str = "not looked at"


def compute(folder: RunFolder, speed_x: float | None = None) -> Kpi:
    """Compute the figures and write `kpi.json`. speed_x : scenario seconds per wall second; from run.json when None.

    Raises RunFolderError when the record cannot be read.
    """
    ticks, events = read(folder, COLUMNS)
    manifest = folder.manifest()
    try:
        kpi = with_parameters(evaluate(manifest, ticks, events, speed_x), manifest, ticks, events)
    except RunFolderError as error:  # said of the settings, wherever they come from
        raise RunFolderError(f"{folder.path}: {error}") from error
    write_atomically(folder.kpi_path, json.dumps(asdict(kpi), indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    return kpi


def with_parameters(kpi: Kpi, manifest: Manifest, ticks: Ticks, events: Sequence[LoggedEvent]) -> Kpi:
    """The figures with what the run says of its rig file; a second or two."""
    drift = drift_of_run(manifest, ticks, events)
    if drift is None:
        return replace(kpi, parameters_note="run.json has no rig that this program can use")
    return replace(kpi, parameters=parameters_json(drift, hours_since_file(manifest)), parameters_note=drift.why)


def evaluate(manifest: Manifest, ticks: Ticks, events: Sequence[LoggedEvent], speed_x: float | None = None) -> Kpi:
    """The figures of a record."""
    plan = manifest.plan
    gain_V_cm = level_gain(plan.settings)
    first_s = float(ticks["t_s"][0]) if len(ticks) else 0.0
    level_V = output_levels(ticks, gain_V_cm)
    integrals = {window.name: _window_iae(ticks, level_V, window, plan.period_s) for window in plan.windows}
    responses = response_figures(ticks, level_V, plan.windows, plan.period_s, gain_V_cm)
    faults = known_faults(plan)
    findings = merged(event.data for event in events if event.code == "alarm")
    verdict = None if faults is None else judge(faults, findings)
    after_fault = None if not faults else after_fault_window(faults, plan.windows)
    return Kpi(
        scenario=plan.scenario,
        status=manifest.outcome,
        reason=manifest.reason,
        reconfigure=plan.reconfigure,
        iae_Vs={name: pair for name, (pair, _) in integrals.items()},
        iae_source="truth" if ticks.has_truth else "estimate",
        iae_covered_s={name: covered_s for name, (_, covered_s) in integrals.items()},
        settling_s=responses["settling_s"],
        overshoot_cm=responses["overshoot_cm"],
        overshoot_at_s=responses["overshoot_at_s"],
        applied_max_V=(_peak(ticks["v1_applied_V"]), _peak(ticks["v2_applied_V"])),
        level_max_cm=_level_peaks(ticks, gain_V_cm),
        level_max_at_s=_level_peak_times(ticks),
        iae_after_fault_Vs=None if after_fault is None else _window_iae(ticks, level_V, after_fault, plan.period_s)[0],
        alarms=tuple(asdict(finding) for finding in findings),
        false_alarms=None if verdict is None else len(verdict.false),
        spurious_alarms=None if verdict is None else len(verdict.spurious),
        overflow=_overflow(ticks, plan.settings, gain_V_cm),
        dry_run=None if faults is None else dry_run(ticks["t_s"], ticks.stack("v1_applied_V", "v2_applied_V"), faults),
        applied_out_of_range=_applied_out_of_range(ticks, plan.settings),
        trips=tuple(
            {"t_s": event.t_s, **_pick(event.data, "cause"), "text": event.text}
            for event in events
            if event.code == "trip"
        ),
        ticks=int(np.isin(ticks["mode"], CONTROLLING).sum()),
        duration_s=max(_last(ticks["t_s"]) - max(first_s, 0.0), 0.0),
        start_phase_s=max(-first_s, 0.0),
        skipped=int(_last(ticks["skipped"])),
        rejected=int(_last(ticks["rejected"])),
        commands=next((dict(event.data) for event in events if event.code == "end"), {}),
        lateness_s=_quantiles(ticks["lateness_s"], LATENESS_QUANTILES),
        latency_s=_quantiles(ticks.get("latency_s"), LATENCY_QUANTILES),
        recorder_queue_max=_peak(ticks.get("recorder_queue")),
        recorder=dict(manifest.recorder),
        speed_x=manifest.speed_x if speed_x is None else speed_x,
        alarm_load=alarm_load(events, min(first_s, 0.0), _last(ticks["t_s"])),
    )


def level_gain(settings: Mapping[str, Any]) -> float:
    """Level signal per level in V/cm, from the merged settings; raises RunFolderError when it is missing."""
    try:
        return signal_gain(settings["rig"]["sensors"]["gain_V_cm"])
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError("run.json's settings have no rig.sensors.gain_V_cm") from error


def known_faults(plan: RunPlan) -> tuple[Injected, ...] | None:
    """The injected faults; None for a live run, where only the emulator's own scenario has them."""
    scenario = plan.settings.get("scenario")
    if plan.mode != "lockstep" or not isinstance(scenario, Mapping):
        return None
    return injected(scenario.get("fault", ()))


def output_levels(ticks: Ticks, gain_V_cm: float) -> Floats:
    """Outputs 1 and 2 in V, (n, 2): the true ones where they are recorded, else the estimates."""
    if ticks.has_truth:
        return ticks.stack("true_h1_cm", "true_h2_cm") * gain_V_cm
    return ticks.stack("h1_est_V", "h2_est_V")


def _window_iae(ticks: Ticks, level_V: Floats, window: Window, period_s: float) -> tuple[tuple[float, float], float]:
    results = [
        absolute_error_integral(ticks["t_s"], ticks[f"r{i + 1}_V"], level_V[:, i], window.from_s, window.to_s, period_s)
        for i in (0, 1)
    ]
    return (results[0][0], results[1][0]), round(min(covered_s for _, covered_s in results), 9)


def _overflow(ticks: Ticks, settings: Mapping[str, Any], gain_V_cm: float) -> Known:
    height_cm = settings["rig"].get("tanks", {}).get("height_cm")
    if height_cm is None:
        return None
    heights_cm = [height_cm] * 4 if isinstance(height_cm, int | float) else height_cm
    peaks_cm = zip(_level_peaks(ticks, gain_V_cm), heights_cm, strict=True)
    known = [peak >= height - HEIGHT_TOLERANCE_CM for peak, height in peaks_cm if peak is not None]
    return any(known) if known else None


def _applied_out_of_range(ticks: Ticks, settings: Mapping[str, Any]) -> Known:
    limits = settings["rig"].get("pumps", {}).get("range_V")
    applied_V = ticks.stack("v1_applied_V", "v2_applied_V")
    applied_V = applied_V[np.isfinite(applied_V)]
    if limits is None or not len(applied_V):
        return None
    low_V, high_V = limits[0] - RANGE_TOLERANCE_V, limits[1] + RANGE_TOLERANCE_V
    return bool(applied_V.min() < min(low_V, 0.0) or applied_V.max() > high_V)


def _level_peaks(ticks: Ticks, gain_V_cm: float) -> tuple[Finite, Finite, Finite, Finite]:
    scale = 1.0 if ticks.has_truth else 1.0 / gain_V_cm
    one, two, three, four = (_peak(level * scale) for level in _levels(ticks))
    return one, two, three, four


def _level_peak_times(ticks: Ticks) -> tuple[Finite, Finite, Finite, Finite]:
    one, two, three, four = (
        float(ticks["t_s"][np.nanargmax(level)]) if np.isfinite(level).any() else None for level in _levels(ticks)
    )
    return one, two, three, four


def _levels(ticks: Ticks) -> list[Floats]:
    """The true levels in cm where they are recorded, else the level signals in V."""
    return [ticks[f"true_h{tank}_cm" if ticks.has_truth else f"h{tank}_V"] for tank in LEVELS]


def _peak(values: Floats) -> Finite:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else None


def _last(values: Floats) -> float:
    return float(values[-1]) if len(values) and math.isfinite(values[-1]) else 0.0


def _quantiles(values: Floats, wanted: Mapping[str, float]) -> dict[str, Finite]:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return dict.fromkeys(wanted)
    return {name: float(np.quantile(finite, share)) for name, share in wanted.items()}


def _pick(data: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: data.get(key) for key in keys}
