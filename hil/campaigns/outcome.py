"""The outcome of a run: one row of the table of outcomes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from hil.campaigns import control_figures, growing, told
from hil.campaigns.cases import Case
from hil.campaigns.observer import Observations, ran_dry, rate_broken
from hil.campaigns.row import CRASHED, Elapsed, Row
from hil.campaigns.told import FlowShare
from hil.core.types import NAMELESS, Pair, Quad
from hil.edge.record.manifest import Window
from hil.loop import Outcome as Ending
from hil.review.alarm_load import alarm_load
from hil.review.alarms import Finding, Injected, Judgement, injected, judge
from hil.review.run_measures import absolute_error_integral, after_fault_window, dry_run
from hil.review.ticks import LoggedEvent

PUMP_LOSS = "pump_effectiveness"
Bound = Callable[[Case], float | None]
"""Bound of a case's detection delay in s; None where it is not known."""


@dataclass(frozen=True)
class RigFigures:
    """What a run's figures need of its configuration. rate_V_s : fastest requested change of an output.

    height_cm : (4,) of the rims. level_gain_V_cm : of the level signals. valve_split : (2,) the rig file's.
    flow_share : what the emulator's healthy pumps give over what the rig file says; None where nobody knows.
    """

    windows: tuple[Window, ...]
    period_s: float
    rate_V_s: float
    height_cm: Quad
    level_gain_V_cm: float
    valve_split: Pair
    flow_share: FlowShare | None = None


@dataclass(frozen=True)
class Rest:
    """The emulator at the end. spilled_cm3 : what went over a rim. applied_V : its outputs."""

    spilled_cm3: float
    applied_V: tuple[float, float]


def evaluate(
    case: Case,
    bench: RigFigures,
    seen: Observations,
    ending: Ending,
    rest: Rest,
    *,
    elapsed: Elapsed,
    bound_s: Bound | None = None,
) -> Row:
    """The run's row."""
    run_s = float(seen.steps[-1, 0]) + bench.period_s if len(seen.steps) else 0.0
    began_s = float(seen.steps[0, 0]) if len(seen.steps) else 0.0  # below zero by what a start phase takes
    planned = injected(case.faults)
    faults = tuple(fault for fault in planned if fault.at_s < run_s)  # a run may end, by a trip, before its fault
    process = [fault for fault in faults if fault.is_of_the_process]
    onset_s = min([fault.at_s for fault in process], default=math.inf)
    alarms = told.reported(case.drawn, seen, onset_s, bench.flow_share)
    judged = [one for one in alarms if not told.is_allowed(one, case.drawn, faults)]
    findings = tuple(one.finding for one in judged)
    verdict = judge(faults, findings)
    healthy_s = min([fault.at_s for fault in process] + [run_s])
    columns = {
        **_about(case, planned),
        **_diagnosis(bench, process, verdict, findings, seen),
        "alarms_json": _json([one.as_json() for one in alarms]),
        "honest_alarms": sum(one.is_honest for one in alarms if one not in judged),
        "questions": sum(one.is_question for one in judged if one.finding in (*verdict.false, *verdict.spurious)),
        **told.unknown_figures(alarms, run_s, is_complete=ending.status == "complete"),
        **_errors(bench, seen, faults),
        **_safety(bench, seen, rest, faults),
        **_ending(seen, ending),
        **_attention(seen, began_s, run_s),
        "windows_json": _json(control_figures.of_windows(seen, bench.windows, bench.level_gain_V_cm, bench.period_s)),
    }
    return Row(
        bound_s=None if bound_s is None else bound_s(case),
        not_played=len(planned) - len(faults),
        hours=(run_s - began_s) / 3600.0,
        healthy_h=(healthy_s - began_s) / 3600.0,
        crashed=False,
        steps=len(seen.steps),
        wall_s=elapsed.wall_s,
        cpu_s=elapsed.cpu_s,
        **columns,
    )


def crash(case: Case, error: Exception, elapsed: Elapsed) -> Row:
    """The row of a run that raised an exception; the report shows it as a broken invariant."""
    empty: dict[str, Any] = {
        field.name: {"str": "", "int": 0, "float": 0.0, "bool": False}.get(str(field.type)) for field in fields(Row)
    }
    text = f"{type(error).__name__}: {error}"
    empty |= _about(case, injected(case.faults))
    empty |= {"crashed": True, "broken": text, "status": CRASHED, "reason": text, "alarms_json": "[]"}
    empty |= asdict(elapsed)
    return Row(**empty)


def _about(case: Case, faults: Sequence[Injected]) -> dict[str, Any]:
    names = sorted({fault.kind for fault in faults})
    values = {fault.value for fault in faults}
    return {
        "key": case.key,
        "label": case.label,
        "scenario": case.scenario,
        "seed": case.seed,
        "faults_json": _json(list(case.faults)),
        "drawn_json": _json(dict(case.drawn)),
        "kind": "+".join(names),
        "target": "+".join(str(fault.target) for fault in faults),
        "value": values.pop() if len(values) == 1 else None,
        "onset_s": faults[0].at_s if faults else None,
    }


def _diagnosis(
    bench: RigFigures, process: Sequence[Injected], verdict: Judgement, findings: Sequence[Finding], seen: Observations
) -> dict[str, Any]:
    """Compare the findings with the faults of the process."""
    answers = [finding for finding in verdict.answers if finding is not None]
    after = [finding for finding in findings if finding not in verdict.false]
    columns: dict[str, Any] = {
        "declared": " + ".join(sorted({_name_of(finding) for finding in after})),
        "flips": sum(finding.flips for finding in findings),
        "false_alarms": len(verdict.false),
        "spurious_alarms": len(verdict.spurious),
        "repeated_alarms": len(verdict.repeated),
        **dict.fromkeys(("detected", "detection_s", "isolation_s", "candidates_hold", "right")),
        **dict.fromkeys(("size_error_1s", "size_error_5s")),
    }
    if not process:
        return columns
    columns |= {"detected": bool(answers), "right": verdict.is_right, "held": verdict.is_held}
    columns |= asdict(growing.figures(process, verdict, bench.valve_split))
    if not answers:
        return columns
    onset_s = process[0].at_s
    first = min(answers, key=lambda finding: finding.detected_s or 0.0)
    isolated = [finding.isolated_s for finding in answers]
    is_isolated = None not in isolated and len(answers) == len(process)
    return columns | {
        "detection_s": (first.detected_s or 0.0) - onset_s,
        "isolation_s": max(at_s for at_s in isolated if at_s is not None) - onset_s if is_isolated else None,
        "candidates_hold": any(name in first.first_candidates for fault in process for name in fault.names),
        "size_error_1s": _size_error(verdict, process, seen, 1.0),
        "size_error_5s": _size_error(verdict, process, seen, 5.0),
    }


def _size_error(verdict: Judgement, faults: Sequence[Injected], seen: Observations, after_s: float) -> float | None:
    """Largest error of a lost pump's effectiveness, `after_s` after its isolation; None where there is none."""
    errors = []
    t_s = seen.column("t_s")
    for fault, answer in zip(verdict.faults, verdict.answers, strict=True):
        if fault.kind != PUMP_LOSS or answer is None or answer.isolated_s is None:
            continue
        at = int(np.searchsorted(t_s, answer.isolated_s + after_s - 1e-6))
        if at >= len(t_s) or fault.until_s <= t_s[at]:
            continue
        left = fault.course.size(float(t_s[at]), 1.0, fault.value)
        errors.append(abs(float(seen.column(f"e{fault.target}")[at]) - left))
    is_all_pumps = all(fault.kind == PUMP_LOSS for fault in faults)
    return max(errors) if errors and is_all_pumps else None


def _errors(bench: RigFigures, seen: Observations, faults: Sequence[Injected]) -> dict[str, Any]:
    """Integrals of the absolute error: the whole run, the scenario's windows, what follows the first fault."""
    whole = _iae(bench, seen, Window("run", 0.0, math.inf))
    after = _iae(bench, seen, after_fault_window(faults, bench.windows)) if faults else (None, None)
    return {
        "iae_1_Vs": whole[0],
        "iae_2_Vs": whole[1],
        "iae_after_fault_1_Vs": after[0],
        "iae_after_fault_2_Vs": after[1],
        "iae_windows_json": _json({window.name: _iae(bench, seen, window) for window in bench.windows}),
    }


def _iae(bench: RigFigures, seen: Observations, window: Window) -> tuple[float, float]:
    first, second = (
        absolute_error_integral(
            seen.column("t_s"),
            seen.column(f"r{output}_V"),
            seen.column(f"h{output}_cm") * bench.level_gain_V_cm,
            window.from_s,
            window.to_s,
            bench.period_s,
        )[0]
        for output in (1, 2)
    )
    return first, second


def _safety(bench: RigFigures, seen: Observations, rest: Rest, faults: Sequence[Injected]) -> dict[str, Any]:
    """The invariants, true where broken."""
    levels_cm, applied_V = seen.steps[:, 3:7], seen.steps[:, 7:9]
    level_max_cm = float(levels_cm.max()) if len(levels_cm) else None
    is_over = rest.spilled_cm3 > 0.0 or bool((levels_cm > np.array(bench.height_cm)).any())
    is_dry = dry_run(seen.column("t_s"), applied_V, faults) or ran_dry(seen)
    too_steep = rate_broken(seen, bench.rate_V_s, bench.period_s)
    is_moving = rest.applied_V != (0.0, 0.0)
    words = [
        f"{rest.spilled_cm3:.3g} cm3 over the rim" if is_over else "",
        "a pump ran on without water" if is_dry else "",
        seen.range_broken,
        too_steep,
        seen.latch_broken,
        f"{rest.applied_V} V after the end" if is_moving else "",
    ]
    return {
        "level_max_cm": level_max_cm,
        "spilled_cm3": rest.spilled_cm3,
        "applied_max_V": float(applied_V.max()) if len(applied_V) else None,
        "overflow": is_over,
        "dry_run": is_dry,
        "applied_out_of_range": bool(seen.range_broken),
        "rate_broken": bool(too_steep),
        "latch_broken": bool(seen.latch_broken),
        "not_at_rest": is_moving,
        "broken": "; ".join(filter(None, words)),
    }


def _ending(seen: Observations, ending: Ending) -> dict[str, Any]:
    trips = [(t_s, event) for t_s, event in seen.events if event.code == "trip"]
    return {
        "trip_cause": str(trips[0][1].data.get("cause", "")) if trips else "",
        "trip_s": trips[0][0] if trips else None,
        "commands_lost": ending.commands_lost,
        "frames_lost": ending.frames_lost,
        "status": ending.status,
        "reason": ending.reason,
    }


def _attention(seen: Observations, began_s: float, run_s: float) -> dict[str, Any]:
    happened = (LoggedEvent(t_s, event.severity, event.code, event.text, event.data) for t_s, event in seen.events)
    load = alarm_load(happened, began_s, run_s)
    return {
        "alarm_count": load.count,
        "alarm_peak_10_min": load.peak_10_min,
        "alarm_floods": len(load.floods),
        "alarm_chattering": len(load.chattering),
    }


def _name_of(finding: Finding) -> str:
    return finding.kind if finding.kind in NAMELESS else f"{finding.kind} {finding.target}"


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
