"""Key figures of a run, `kpi.json`: how well it controlled, what it noticed, how the loop kept time.

The integral of a window's absolute error is exact for levels that run straight between two steps and references that
are held from one step to the next. So a reference step that falls on a window's border belongs to the window it opens.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from hil.core.types import Mode
from hil.edge.run_folder import Manifest, RunFolder, RunFolderError, Window, write_atomically
from hil.review.ticks import Floats, LoggedEvent, Ticks, read

LEVELS = ("1", "2", "3", "4")
CONTROLLING = [mode.value for mode in Mode if mode.is_controlling]
Finite = float | None  # None: not known


@dataclass(frozen=True, slots=True)
class Kpi:
    """The figures as `kpi.json` has them; None where the run was too short or the value is not known.

    iae_Vs : window -> outputs 1, 2, of the reference asked for against the level. iae_covered_s : how much of the
    window the record covers. ticks : steps in control, arming and ramp left out. commands : how many were sent, how
    many of them the pump node did not accept, how many frames were lost. lateness_s : quantiles of how late the steps
    began.
    """

    scenario: str
    status: str
    reason: str
    reconfigure: bool
    iae_Vs: dict[str, tuple[float, float]]
    iae_source: Literal["truth", "estimate"]
    iae_covered_s: dict[str, float]
    applied_max_V: tuple[Finite, Finite]
    level_max_cm: tuple[Finite, Finite, Finite, Finite]
    alarms: tuple[dict[str, Any], ...]
    trips: tuple[dict[str, Any], ...]
    ticks: int
    duration_s: float
    skipped: int
    rejected: int
    commands: dict[str, Any]
    lateness_s: dict[str, Finite]
    recorder: dict[str, Any]
    speed_x: float | None


def compute(folder: RunFolder, speed_x: float | None = None) -> Kpi:
    """Work the figures out and write `kpi.json`. speed_x : scenario seconds per wall second; from run.json when None.

    Raises RunFolderError when the record cannot be read.
    """
    ticks, events = read(folder)
    kpi = evaluate(folder.manifest(), ticks, events, speed_x)
    write_atomically(folder.kpi_path, json.dumps(asdict(kpi), indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    return kpi


def evaluate(manifest: Manifest, ticks: Ticks, events: Sequence[LoggedEvent], speed_x: float | None = None) -> Kpi:
    """The figures of a record."""
    plan = manifest.plan
    gain_V_cm = level_gain(plan.settings)
    level_V = output_levels(ticks, gain_V_cm)
    integrals = {window.name: _window_iae(ticks, level_V, window, plan.period_s) for window in plan.windows}
    return Kpi(
        scenario=plan.scenario,
        status=manifest.outcome,
        reason=manifest.reason,
        reconfigure=plan.reconfigure,
        iae_Vs={name: pair for name, (pair, _) in integrals.items()},
        iae_source="truth" if ticks.has_truth else "estimate",
        iae_covered_s={name: covered_s for name, (_, covered_s) in integrals.items()},
        applied_max_V=(_peak(ticks["v1_applied_V"]), _peak(ticks["v2_applied_V"])),
        level_max_cm=_level_peaks(ticks, gain_V_cm),
        alarms=tuple(
            _pick(event.data, "detected_s", "kind", "target", "size") for event in events if event.code == "alarm"
        ),
        trips=tuple(
            {"t_s": event.t_s, **_pick(event.data, "cause"), "text": event.text}
            for event in events
            if event.code == "trip"
        ),
        ticks=int(np.isin(ticks["mode"], CONTROLLING).sum()),
        duration_s=_last(ticks["t_s"]) - (float(ticks["t_s"][0]) if len(ticks) else 0.0),
        skipped=int(_last(ticks["skipped"])),
        rejected=int(_last(ticks["rejected"])),
        commands=next((dict(event.data) for event in events if event.code == "end"), {}),
        lateness_s=_quantiles(ticks["lateness_s"]),
        recorder=dict(manifest.recorder),
        speed_x=manifest.speed_x if speed_x is None else speed_x,
    )


def level_gain(settings: Mapping[str, Any]) -> float:
    """Level voltage per level in V/cm, from the merged settings; raises RunFolderError when they don't say."""
    try:
        return float(settings["rig"]["sensors"]["gain_V_cm"])
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError("run.json's settings have no rig.sensors.gain_V_cm") from error


def output_levels(ticks: Ticks, gain_V_cm: float) -> Floats:
    """Outputs 1 and 2 in V, (n, 2): the true ones where they are recorded, else the estimates."""
    if ticks.has_truth:
        return ticks.stack("true_h1_cm", "true_h2_cm") * gain_V_cm
    return ticks.stack("h1_est_V", "h2_est_V")


def absolute_error_integral(
    times_s: Floats, reference: Floats, level: Floats, from_s: float, to_s: float, hold_s: float
) -> tuple[float, float]:
    """Integral of |reference - level| over [from_s, to_s], and the seconds of it that the samples cover.

    times_s, reference, level : (n,), times ascending. The reference holds from its sample to the next, the level runs
    straight between samples and holds for `hold_s` after the last. Units: those of the level, times s.
    """
    known = np.isfinite(times_s) & np.isfinite(reference) & np.isfinite(level)
    times_s, reference, level = times_s[known], reference[known], level[known]
    if len(times_s) == 0:
        return 0.0, 0.0
    edges_s = np.append(times_s, times_s[-1] + hold_s)
    levels = np.append(level, level[-1])
    start_s = np.clip(edges_s[:-1], from_s, to_s)
    end_s = np.clip(edges_s[1:], from_s, to_s)
    span_s = end_s - start_s
    first = reference - np.interp(start_s, edges_s, levels)
    last = reference - np.interp(end_s, edges_s, levels)
    size = np.abs(first) + np.abs(last)
    crosses = first * last < 0.0
    # a straight error that changes sign is two triangles; otherwise it is a trapezoid
    triangles = (first**2 + last**2) / np.where(crosses, size, 1.0)
    mean = 0.5 * np.where(crosses, triangles, size)
    return float(np.sum(mean * span_s)), float(np.sum(span_s))


def _window_iae(ticks: Ticks, level_V: Floats, window: Window, period_s: float) -> tuple[tuple[float, float], float]:
    results = [
        absolute_error_integral(ticks["t_s"], ticks[f"r{i + 1}_V"], level_V[:, i], window.from_s, window.to_s, period_s)
        for i in (0, 1)
    ]
    return (results[0][0], results[1][0]), round(min(covered_s for _, covered_s in results), 9)


def _level_peaks(ticks: Ticks, gain_V_cm: float) -> tuple[Finite, Finite, Finite, Finite]:
    if ticks.has_truth:
        peaks = [_peak(ticks[f"true_h{tank}_cm"]) for tank in LEVELS]
    else:
        peaks = [_peak(ticks[f"h{tank}_V"] / gain_V_cm) for tank in LEVELS]
    return (peaks[0], peaks[1], peaks[2], peaks[3])


def _peak(values: Floats) -> Finite:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else None


def _last(values: Floats) -> float:
    return float(values[-1]) if len(values) and math.isfinite(values[-1]) else 0.0


def _quantiles(values: Floats) -> dict[str, Finite]:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return {"p50": None, "p99": None, "max": None}
    return {"p50": float(np.quantile(finite, 0.5)), "p99": float(np.quantile(finite, 0.99)), "max": float(finite.max())}


def _pick(data: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: data.get(key) for key in keys}
