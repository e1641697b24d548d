"""The report of a comparison, `report.html`, in the form of a run's report: configuration first, then key figures."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from hil.compare.compared_run import START, ComparedRun
from hil.compare.differences import Difference
from hil.compare.figure_rows import MIN_SPREAD, FigureRow, Value
from hil.compare.overlaid_figures import overlaid_figures
from hil.core.counted import counted
from hil.review import page, run_figures
from hil.review.alarm_table import alarm_table

NOTHING_DIFFERS = "Nothing differs: neither settings nor files nor versions, as the runs have recorded them."


def render(
    runs: Sequence[ComparedRun],
    found: Sequence[Difference],
    rows: Sequence[FigureRow],
    notes: Sequence[str] = (),
    align: str = START,
) -> str:
    """The page's HTML. found : what differs. rows : key figures. notes : what a reader has to know, a line each."""
    body = "".join(
        (
            _header(runs, notes, align),
            page.section("Runs", _run_table(runs)),
            page.section("What differs in the configuration", _difference_table(runs, found)),
            page.section("Key figures", _figure_table(runs, rows)),
            page.section("Alarms and trips", alarm_table([(run.name, run.kpi, run.ticks) for run in runs])),
            page.section("Figures", _figures(runs)),
        )
    )
    return page.document(f"Comparison of {counted(len(runs), 'run')}", body)


def alignment(align: str) -> str:
    """How the runs are aligned, in words."""
    if align == START:
        return "at time 0 of each run"
    return f"at {align} s of each run" if align.replace(".", "", 1).lstrip("-").isdecimal() else f"at {align}"


def _header(runs: Sequence[ComparedRun], notes: Sequence[str], align: str) -> str:
    facts = [
        ("runs", str(len(runs))),
        ("aligned", alignment(align)),
        ("scenarios", ", ".join(dict.fromkeys(run.manifest.plan.scenario for run in runs))),
    ]
    title = f"<h1>{page.escape('Comparison: ' + ', '.join(run.name for run in runs[:6]))}</h1>"
    return f"<header>{title}{page.facts(facts)}{page.paragraphs(notes)}</header>\n"


def _run_table(runs: Sequence[ComparedRun]) -> str:
    rows = [
        [
            run.name,
            run.manifest.plan.scenario,
            run.manifest.outcome,
            run.manifest.reason,
            datetime.fromisoformat(run.manifest.started_utc).strftime("%Y-%m-%d %H:%M UTC"),
            run.manifest.plan.mode,
            f"{run.manifest.plan.period_s:g}",
            "none" if run.manifest.plan.seed is None else str(run.manifest.plan.seed),
            f"{run.kpi.duration_s:.1f}",
            f"{run.zero_s:g}",
        ]
        for run in runs
    ]
    heads = ["run", "scenario", "ended", "why", "started", "mode", "period [s]", "seed", "length [s]", "aligned at [s]"]
    return page.table(heads, rows, numeric=frozenset((6, 7, 8, 9)))


def _difference_table(runs: Sequence[ComparedRun], found: Sequence[Difference]) -> str:
    if not found:
        return page.paragraphs([NOTHING_DIFFERS])
    return page.table(["key", *(run.name for run in runs)], [[one.key, *one.values] for one in found])


def _figure_table(runs: Sequence[ComparedRun], rows: Sequence[FigureRow]) -> str:
    names = [run.name for run in runs]
    heads = ["figure", "unit", names[0]]
    for name in names[1:]:
        heads += [name, "ratio"]
    spread = ["median", "min", "max"] if len(runs) >= MIN_SPREAD else []
    cells = []
    for row in rows:
        if row.is_same:
            continue
        line = [row.label, row.unit, value_text(row.values[0])]
        for value, ratio in zip(row.values[1:], row.ratios[1:], strict=True):
            line += [value_text(value), ratio_text(ratio)]
        cells.append([*line, *(value_text(one) for one in (row.median, row.low, row.high)[: len(spread)])])
    heads += spread
    same = page.paragraphs([text]) if (text := same_text(rows)) else ""
    note = f'<p class="soft">Ratio: to {page.escape(names[0])}.</p>'
    return page.table(heads, cells, numeric=frozenset(range(2, len(heads)))) + note + same


def same_text(rows: Sequence[FigureRow]) -> str:
    """The figures that all runs share, in one sentence; "" for none."""
    same = [f"{row.label}: {value_text(row.values[0])} {row.unit}".strip() for row in rows if row.is_same]
    return f"The same in all runs. {'; '.join(same)}." if same else ""


def value_text(value: Value) -> str:
    """A figure's value: four digits, or yes and no; a dash for an unknown one."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        is_whole = value.is_integer() or abs(value) >= 1000.0
        return f"{value + 0.0:.0f}" if is_whole and abs(value) < 1e9 else f"{value:.4g}"
    return "–" if value is None else value


def ratio_text(ratio: float | None) -> str:
    """A ratio with three digits; nothing where there is none."""
    if ratio is None:
        return ""
    return f"× {ratio:.0f}" if abs(ratio) >= 100.0 else f"× {ratio:#.3g}"


def _figures(runs: Sequence[ComparedRun]) -> str:
    with run_figures.style():
        parts = overlaid_figures(runs)
    if not parts:
        return '<p class="soft">No run has a control step.</p>'
    drawn = "".join(page.figure(one.svg, f"{one.title}.", one.caption) for one in parts)
    return f'<div class="figures">{drawn}</div>\n'
