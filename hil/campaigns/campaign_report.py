"""The report of a campaign, `report.html`: one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from hil.campaigns import delay_figures, statistics
from hil.campaigns.figure_text import not_played_text, rate_text, share_text, spread_text
from hil.campaigns.growing import PROMPT_S
from hil.campaigns.row import INVARIANTS, Row
from hil.campaigns.statistics import FaultClass
from hil.campaigns.store import Store
from hil.core.counted import counted
from hil.edge.record.file_writing import write_atomically
from hil.review import page
from hil.review.run_figures import style

MAX_DECLARED = 14
MAX_ROWS = 200
OTHER = "other"
WORDS = {
    "overflow": "No level above the rim, no water over it.",
    "dry_run": "No pump is driven for more than 2 s without water from any pump.",
    "applied_out_of_range": "Applied voltages within range.",
    "rate_broken": "Applied voltages change no faster than the rate allows.",
    "latch_broken": "After a trip, 0 V and nothing else.",
    "not_at_rest": "0 V after every end.",
    "crashed": "No run raised.",
}


def write_report(store: Store, name: str, rows: Sequence[Row]) -> Path:
    """Write the report into the campaign's folder and say where."""
    write_atomically(store.report_path, render(name, rows))
    return store.report_path


def render(name: str, rows: Sequence[Row]) -> str:
    """The page's HTML."""
    classes = statistics.fault_classes(rows)
    body = "".join(
        (
            _header(name, rows),
            _cards(rows),
            page.section("Safety", _invariants(rows)),
            page.section("Classes of faults", _class_table(classes) + _not_played(rows)),
            page.section("Faults played, and faults declared", _confusion(rows)),
            page.section("Delays", _figures(classes, rows)),
            page.section("False alarms", _false_alarms(rows)),
            page.section("Trips", _trips(rows)),
        )
    )
    return page.document(f"Campaign {name}", body)


def _header(name: str, rows: Sequence[Row]) -> str:
    state = "failed" if any(row.breaks for row in rows) else "complete"
    seeds = sorted({row.seed for row in rows})
    facts = [
        ("runs", str(len(rows))),
        ("scenarios", ", ".join(sorted({row.scenario for row in rows}))),
        ("seeds", f"{seeds[0]} to {seeds[-1]}" if seeds else "none"),
    ]
    return f"<header><h1>{page.escape(name)}{page.badge(state)}</h1>{page.facts(facts)}</header>\n"


def _cards(rows: Sequence[Row]) -> str:
    rate = statistics.false_alarms(rows)
    asked = [row for row in rows if row.detected is not None]
    steps, cpu_s = sum(row.steps for row in rows), sum(row.cpu_s for row in rows)
    return page.cards(
        [
            ("simulated", f"{sum(row.hours for row in rows):.4g} h"),
            ("false alarms per hour without a fault", "–" if rate.per_h is None else f"{rate.per_h:.3g}"),
            ("at most, with 97.5 % confidence", "–" if rate.high_h is None else f"{rate.high_h:.3g}"),
            ("faults found", f"{_share(sum(bool(row.detected) for row in asked), len(asked))}"),
            ("and named rightly", f"{_share(sum(bool(row.right) for row in asked), len(asked))}"),
            ("alarms for an operator in 10 min: mean, most in a run", _alarms(rows)),
            ("runs with a flood of alarms, with a chattering one", _floods(rows)),
            ("runs that broke an invariant", str(sum(bool(row.breaks) for row in rows))),
            ("runs that tripped", str(sum(bool(row.trip_cause) for row in rows))),
            ("processor time a control step", "–" if not steps else f"{1e6 * cpu_s / steps:.0f} µs"),
        ]
    )


def _alarms(rows: Sequence[Row]) -> str:
    windows = sum(max(row.hours * 6.0, 1.0) for row in rows)
    if not rows:
        return "–"
    return f"{sum(row.alarm_count for row in rows) / windows:.2g}, {max(row.alarm_peak_10_min for row in rows)}"


def _floods(rows: Sequence[Row]) -> str:
    return f"{sum(row.alarm_floods > 0 for row in rows)}, {sum(row.alarm_chattering > 0 for row in rows)}"


def _invariants(rows: Sequence[Row]) -> str:
    guilty = statistics.broken(rows)
    lines = [
        [
            WORDS[name],
            "holds" if not guilty[name] else f"broken in {counted(len(guilty[name]), 'run')}",
            _seeds(guilty[name]),
        ]
        for name in INVARIANTS
    ]
    classes = ["ERROR" if guilty[name] else "" for name in INVARIANTS]
    heads = ["invariant", f"in {counted(len(rows), 'run')}", "seeds"]
    worst = [[row.key, row.label, str(row.seed), row.broken] for row in rows if row.breaks][:MAX_ROWS]
    details = page.table(["case", "fault", "seed", "what"], worst) if worst else ""
    highest = max((row.level_max_cm for row in rows if row.level_max_cm is not None), default=None)
    note = "" if highest is None else f'<p class="soft">Highest level of all: {highest:.2f} cm.</p>'
    return page.table(heads, lines, classes=classes) + details + note


def _seeds(rows: Sequence[Row]) -> str:
    named = [f"{row.label}: {row.seed}" for row in rows[:8]]
    return "; ".join(named) + (" ..." if len(rows) > len(named) else "")


def _class_table(classes: Sequence[FaultClass]) -> str:
    if not classes:
        return ""
    lines = [
        [
            one.label,
            str(one.runs),
            f"{one.detected:.1%}",
            spread_text(one.detection),
            "–" if one.bound_s is None else f"{one.bound_s:.3g}",
            spread_text(one.isolation),
            f"{one.candidates_hold:.1%}",
            f"{one.right:.1%}",
            f"{one.held:.1%}",
            share_text(one.prompt),
            str(one.flips),
            f"{spread_text(one.size_error_1s, 2)}",
            f"{spread_text(one.size_error_5s, 2)}",
            " | ".join(spread_text(output) for output in one.iae_after_fault),
        ]
        for one in classes
    ]
    heads = [
        "fault", "runs", "detected", "detected after [s]", "bound [s]", "isolated after [s]", "among candidates",
        "right", "or among candidates at the end", "right 60 s after 5 %", "flips", "size error, 1 s", "5 s",
        "IAE after it, outputs 1 | 2 [V s]",
    ]  # fmt: skip
    note = (
        '<p class="soft">Median / 95th percentile. Delays since the onset; size errors of a pump\'s effectiveness. '
        f"Right {PROMPT_S:g} s after 5 %: share of the growing faults that had their right name, and no other, within "
        "this time after their size had reached 5 %.</p>"
    )
    return page.table(heads, lines, numeric=frozenset(range(1, len(heads)))) + note


def _not_played(rows: Sequence[Row]) -> str:
    text = not_played_text(statistics.not_played(rows))
    return f"<p>{page.escape(text)}.</p>" if text else ""


def _confusion(rows: Sequence[Row]) -> str:
    table = statistics.confusion(rows)
    totals: dict[str, int] = {}
    for counts in table.values():
        for name, count in counts.items():
            totals[name] = totals.get(name, 0) + count
    named = sorted(totals, key=lambda name: (-totals[name], name))[:MAX_DECLARED]
    rest = set(totals) - set(named)
    heads = ["played", *named, *([OTHER] if rest else [])]
    lines = [[label, *_counts(counts, named, rest)] for label, counts in table.items()]
    return page.table(heads, lines, numeric=frozenset(range(1, len(heads)))) if lines else ""


def _counts(counts: Mapping[str, int], named: Sequence[str], rest: set[str]) -> list[str]:
    others = sum(counts.get(name, 0) for name in rest)
    cells = [str(counts.get(name, 0) or "") for name in named]
    return [*cells, str(others or "")] if rest else cells


def _figures(classes: Sequence[FaultClass], rows: Sequence[Row]) -> str:
    parts = []
    with style():
        for one in classes:
            members = [row for row in rows if row.label == one.label]
            parts.append(page.figure(delay_figures.delays(one.label, members, one.bound_s), one.label, ""))
    return f'<div class="figures">{"".join(parts)}</div>\n' if parts else ""


def _honest(rows: Sequence[Row]) -> str:
    count = sum(row.honest_alarms for row in rows)
    asked = statistics.questions_text(rows)
    said = f"Besides, {counted(count, 'alarm')} that say what a drawn rig is." if count else ""
    return "".join(f" {text}" for text in (asked, said, statistics.unknown_text(rows)) if text)


def _false_alarms(rows: Sequence[Row]) -> str:
    spurious = sum(row.spurious_alarms for row in rows)
    repeated = sum(row.repeated_alarms for row in rows)
    again = f" Further ones with the name of a growing or intermittent fault: {repeated}." if repeated else ""
    text = f"{rate_text(statistics.false_alarms(rows))}. Spurious ones after a fault: {spurious}.{again}{_honest(rows)}"
    lines = [
        [
            row.key,
            row.scenario,
            row.label,
            str(row.seed),
            str(row.false_alarms),
            str(row.spurious_alarms),
            f"{row.unknown_s:.0f}" if row.unknowns else "",
            row.declared,
        ]
        for row in rows
        if row.false_alarms or row.spurious_alarms or row.unknown_long
    ]
    heads = [
        "case", "scenario", "fault", "seed", "false", "spurious", "longest unknown [s]", "declared after the onset",
    ]  # fmt: skip
    listed = page.table(heads, lines[:MAX_ROWS], numeric=frozenset((3, 4, 5, 6))) if lines else ""
    return f"<p>{page.escape(text)}</p>{listed}"


def _trips(rows: Sequence[Row]) -> str:
    lines = [
        [row.key, row.label, str(row.seed), row.trip_cause, "–" if row.trip_s is None else f"{row.trip_s:.1f}"]
        for row in rows
        if row.trip_cause
    ]
    return page.table(["case", "fault", "seed", "cause", "at [s]"], lines[:MAX_ROWS]) if lines else ""


def _share(count: int, of: int) -> str:
    return "–" if of == 0 else f"{count / of:.1%}"
