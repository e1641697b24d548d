"""The report of a run, `report.html`: one file that needs nothing else, for a screen, a phone or paper."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.core.counted import counted
from hil.core.fault_kinds import FaultKind
from hil.edge.record.file_writing import write_atomically
from hil.edge.record.manifest import Manifest
from hil.edge.record.run_folder import RunFolder
from hil.review import page, run_figures, table3
from hil.review.alarm_attention import attention
from hil.review.alarm_table import alarm_table
from hil.review.alarms import Injected, injected
from hil.review.drift_section import drift_section, with_recorded
from hil.review.kpi import COLUMNS as KPI_COLUMNS
from hil.review.kpi import LEVELS, Kpi, evaluate, level_gain, output_levels
from hil.review.ticks import LoggedEvent, Ticks, read

MAX_EVENTS = 400
COLUMNS = (
    *KPI_COLUMNS,
    *(
        f"{name}{pump}{unit}"
        for name, unit in (("target", "_V"), ("v", "_V"), ("theta", ""), ("iae", "_Vs"))
        for pump in "12"
    ),
    *("h3_est_V", "h4_est_V"),
    *(f"noise{tank}_cm_sqrt_s" for tank in LEVELS),
)
BROKEN = {
    "overflow": "A tank overflowed: a level reached the rim.",
    "dry_run": "A pump ran without water.",
    "applied_out_of_range": "A pump's voltage was outside its range.",
}


@dataclass(frozen=True, eq=False)
class Run:
    """A run as read back."""

    manifest: Manifest
    ticks: Ticks
    events: Sequence[LoggedEvent]
    kpi: Kpi
    name: str = ""

    @property
    def strategy(self) -> str:
        """The strategy's name, as the paper has it."""
        return table3.RECONFIGURATION if self.manifest.plan.reconfigure else table3.NO_RECONFIGURATION


def write_report(folder: RunFolder, compare: RunFolder | None = None) -> Path:
    """Write `report.html` into the folder and say where. compare : a second run, drawn into the same figures.

    Raises RunFolderError when a record cannot be read.
    """
    run = _load(folder)
    other = None if compare is None else _load(compare)
    if other is not None and other.name == run.name:
        run, other = replace(run, name=str(folder.path)), replace(other, name=str(compare and compare.path))
    write_atomically(folder.report_path, render(run, other))
    return folder.report_path


def render(run: Run, other: Run | None = None) -> str:
    """The page's HTML."""
    plan = run.manifest.plan
    runs = [run] if other is None else [run, other]
    is_papers = all(table3.applies_to(one.kpi) and not _is_cut_short(one) for one in runs)
    body = "".join(
        (
            _header(run.manifest, "" if other is None else other.name),
            _cards(run, is_live=plan.mode == "live"),
            page.section("Table 3 of the paper", _paper_table(runs) if is_papers else ""),
            page.section("Integral of the absolute error", "" if is_papers else _iae_table(runs)),
            page.section("Alarms and trips", alarm_table([(one.name, one.kpi, one.ticks) for one in runs])),
            page.section(
                "Attention asked for", "".join(attention(one.name, one.kpi.alarm_load, one.events) for one in runs)
            ),
            page.section("Is the rig file still right?", drift_section(run.manifest, run.kpi)),
            page.section("Figures", _figures(run, other)),
            page.section("Events", _event_table(run.events)),
            page.section("Configuration", _configuration(run.manifest)),
        )
    )
    return page.document(f"{plan.scenario}: {run.manifest.outcome}", body)


def _load(folder: RunFolder) -> Run:
    manifest = folder.manifest()
    ticks, events = read(folder, COLUMNS)
    figures = with_recorded(evaluate(manifest, ticks, events), folder)
    return Run(manifest, ticks, events, figures, folder.path.name)


def _header(manifest: Manifest, compared: str = "") -> str:
    plan = manifest.plan
    reason = manifest.reason or (
        "Unfinished: the process did not record how the run ended. What it recorded until then is shown."
        if manifest.status == "running"
        else ""
    )
    facts = [
        ("started", _moment(manifest.started_utc)),
        ("ended", _moment(manifest.ended_utc)),
        ("mode", plan.mode),
        ("control period", f"{plan.period_s:g} s"),
        ("seed", "none" if plan.seed is None else str(plan.seed)),
        *((name, version) for name, version in manifest.versions.items()),
    ]
    if manifest.speed_x is not None:
        facts.insert(2, ("speed", f"{manifest.speed_x:.3g} × real time"))
    if compared:
        facts.insert(0, ("compared with", compared))
    title = f"<h1>{page.escape(plan.scenario)}{page.badge(manifest.outcome)}</h1>"
    return f'<header>{title}<p class="soft">{page.escape(reason)}</p>{page.facts(facts)}</header>\n'


def _cards(run: Run, *, is_live: bool) -> str:
    kpi = run.kpi
    duration = f"{kpi.duration_s:.1f} s"
    pairs = [
        ("recorded", duration),
        ("control steps", f"{kpi.ticks}"),
        ("periods skipped", f"{kpi.skipped}"),
        ("frames rejected", f"{kpi.rejected}"),
        ("largest applied voltage", f"{page.number(_largest(kpi.applied_max_V), 3)} V"),
        ("highest level", f"{page.number(_largest(kpi.level_max_cm), 4)} cm"),
        ("lateness, 99 % of steps", _milliseconds(kpi.lateness_s["p99"]) if is_live else "none, simulated"),
        *([("frame to command, 99 % of steps", _milliseconds(kpi.latency_s["p99"]))] if is_live else []),
        ("alarms, trips", f"{len(kpi.alarms)}, {len(kpi.trips)}"),
    ]
    walks = [run.ticks.get(f"noise{tank}_cm_sqrt_s") for tank in (1, 2, 3, 4)]
    if len(run.ticks) and all(math.isfinite(walk[-1]) for walk in walks):
        learned = ", ".join(page.number(float(walk[-1]), 2) for walk in walks)
        pairs.append(("process noise learned, tanks 1 to 4", f"{learned} cm/√s"))
    if kpi.start_phase_s:
        pairs.append(("start phase, before time 0", f"{kpi.start_phase_s:.1f} s"))
    probes = sum(event.code == "probe" and event.data.get("state") == "begin" for event in run.events)
    if probes:
        pairs.append(("probes: movements of the pumps that tell faults apart", f"{probes}"))
    if kpi.false_alarms is not None and kpi.spurious_alarms is not None:
        pairs.append(("false alarms, spurious alarms", f"{kpi.false_alarms}, {kpi.spurious_alarms}"))
    if kpi.iae_after_fault_Vs is not None:
        first_Vs, second_Vs = kpi.iae_after_fault_Vs
        pairs.append(("IAE after the fault, outputs 1, 2", f"{first_Vs:.3g}, {second_Vs:.3g} V s"))
    troubles = [text for name, text in BROKEN.items() if getattr(kpi, name)]
    troubles += kpi.recorder.get("errors", [])
    if kpi.recorder.get("dropped"):
        troubles.append(f"{counted(kpi.recorder['dropped'], 'entry', 'entries')} of the record dropped")
    return page.cards(pairs) + "".join(f'<p class="ERROR">{page.escape(text)}</p>' for text in troubles)


def _paper_table(runs: Sequence[Run]) -> str:
    rows = []
    for line in table3.lines(*(run.kpi for run in runs)):
        for output in (0, 1):
            paper_Vs = line.paper_Vs[output]
            cells = [line.window, line.strategy] if output == 0 else ["", ""]
            cells += [str(output + 1), table3.cell(paper_Vs)]
            for ours in line.ours_Vs:
                ours_Vs = None if ours is None else ours[output]
                cells += [table3.cell(ours_Vs), table3.deviation(ours_Vs, paper_Vs)]
            rows.append(cells)
    ours_heads = [head for run in runs for head in (run.name or "this run", "off by")]
    heads = ["window", "strategy", "output", "paper", *ours_heads]
    sources = {"truth": "the true levels", "estimate": "the estimated levels"}
    named = " and ".join(sorted({sources[run.kpi.iae_source] for run in runs}))
    note = f'<p class="soft">Integral of the absolute error in V s, from {page.escape(named)}.</p>'
    return page.table(heads, rows, numeric=frozenset(range(2, len(heads)))) + note


def _is_cut_short(run: Run) -> bool:
    return any(
        run.kpi.iae_covered_s[window.name] < window.to_s - window.from_s - 1e-6 for window in run.manifest.plan.windows
    )


def _iae_table(runs: Sequence[Run]) -> str:
    rows = []
    for run in runs:
        spans = {window.name: window for window in run.manifest.plan.windows}
        for name, (first_Vs, second_Vs) in run.kpi.iae_Vs.items():
            covered_s = run.kpi.iae_covered_s[name]
            span = f"{spans[name].from_s:g} to {spans[name].to_s:g} s"
            if covered_s < spans[name].to_s - spans[name].from_s - 1e-6:
                span += f", {covered_s:.1f} s of it recorded"
            figures = [f"{first_Vs:.4g}", f"{second_Vs:.4g}"] if covered_s > 0.0 else ["not reached", ""]
            strategy = f"{run.strategy} ({run.name})" if len(runs) > 1 else run.strategy
            rows.append([name, strategy, span, *figures, run.kpi.iae_source])
    if not rows:
        return ""
    heads = ["window", "strategy", "span", "output 1 [V s]", "output 2 [V s]", "level from"]
    return page.table(heads, rows, numeric=frozenset((3, 4)))


def _figures(run: Run, other: Run | None) -> str:
    if len(run.ticks) == 0:
        return '<p class="soft">No control step was recorded.</p>'
    name, other_name = _trace_names(run, other)
    traces = [_trace(run, name, run_figures.BLUE)]
    if other is not None and len(other.ticks):
        traces.append(_trace(other, other_name, run_figures.ORANGE))
    gain_V_cm = level_gain(run.manifest.plan.settings)
    source = "true levels" if run.ticks.has_truth else "estimated levels"
    with run_figures.style():
        parts = [
            ("Figure 2.", "Effectiveness of the pumps, as diagnosed.", run_figures.actuator_gains(traces[0])),
            ("Upper tanks.", "Levels of tanks 3 and 4.", run_figures.upper_tanks(traces[0], gain_V_cm)),
            ("Figure 3.", f"Output 1 and its reference ({source}).", run_figures.output(1, traces)),
            ("Figure 4.", f"Output 2 and its reference ({source}).", run_figures.output(2, traces)),
            ("Figure 5.", "Command signals.", run_figures.commands(traces)),
            ("Error.", "Integral of the absolute error so far; output 2 dashed.", run_figures.error_so_far(traces)),
        ]
        if run.manifest.plan.mode == "live":
            parts.append(("Timing.", "Lateness of the control steps.", run_figures.lateness(traces[0])))
    return '<div class="figures">' + "".join(page.figure(svg, title, text) for title, text, svg in parts) + "</div>\n"


def _trace_names(run: Run, other: Run | None) -> tuple[str, str]:
    if other is None or other.strategy != run.strategy:
        return run.strategy, "" if other is None else other.strategy
    return f"this run, {run.strategy}", f"compared run, {other.strategy}"


def _trace(run: Run, name: str, color: str) -> run_figures.Trace:
    plan = run.manifest.plan
    outputs_V = output_levels(run.ticks, level_gain(plan.settings))
    return run_figures.Trace(name, color, run.ticks, outputs_V, run.events, injected_pump_faults(plan.copies))


def injected_pump_faults(copies: Any) -> dict[int, tuple[Injected, ...]]:
    """The lost gains that the scenario's copy lists: pump -> faults, by time."""
    losses: list[Any] = []
    for text in copies.values():
        try:
            listed = tomllib.loads(text).get("fault", [])
        except tomllib.TOMLDecodeError:
            continue
        kinds = (FaultKind.PUMP_EFFECTIVENESS, FaultKind.PUMP_DEAD)
        losses += [fault for fault in listed if fault.get("kind") in kinds] if isinstance(listed, list) else []
    faults = injected(losses)
    return {pump: tuple(one for one in faults if one.target == pump) for pump in sorted({one.target for one in faults})}


def _event_table(events: Sequence[LoggedEvent]) -> str:
    shown = events[:MAX_EVENTS]
    rows = [[f"{event.t_s:.2f}", event.severity, event.code, event.text] for event in shown]
    note = ""
    if len(events) > len(shown):
        note = f'<p class="soft">{len(events) - len(shown)} more are in events.jsonl.</p>'
    heads = ["time [s]", "", "event", "what happened"]
    return page.table(heads, rows, classes=[event.severity for event in shown]) + note if rows else ""


def _configuration(manifest: Manifest) -> str:
    plan = manifest.plan
    folds = [page.fold(name, text) for name, text in plan.copies.items()]
    return "".join(folds) + page.fold("merged settings", json.dumps(plan.settings, indent=2, ensure_ascii=False))


def _moment(utc: str | None) -> str:
    return "unknown" if utc is None else datetime.fromisoformat(utc).strftime("%Y-%m-%d %H:%M:%S UTC")


def _largest(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return max(known) if known else None


def _milliseconds(value_s: float | None) -> str:
    return "–" if value_s is None else f"{value_s * 1e3:.3g} ms"
