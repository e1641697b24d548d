"""What the terminal shows of a campaign at its end."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from hil.campaigns import statistics
from hil.campaigns.figure_text import not_played_text, rate_text, share_text, spread_text
from hil.campaigns.row import Row
from hil.campaigns.statistics import FaultClass
from hil.core.counted import counted

MAX_NAMED = 5
PROMPT = "right 60 s after 5 %"
MIN_WIDTH = 120
"""Of the table, where no terminal sets its width. On a narrower terminal each class is a few lines instead."""


def show(console: Console, rows: Sequence[Row]) -> None:
    """Classes of faults, false alarms, invariants."""
    if not console.is_terminal:
        console.width = max(console.width, MIN_WIDTH)
    classes = statistics.fault_classes(rows)
    if classes:
        if console.width < MIN_WIDTH:
            _show_as_lines(console, classes)
        else:
            console.print(_class_table(classes))
    if missing := not_played_text(statistics.not_played(rows)):
        console.print(missing, highlight=False, markup=False)
    console.print(f"False alarms: {rate_text(statistics.false_alarms(rows))}", highlight=False)
    if questions := statistics.questions_text(rows):
        console.print(questions, highlight=False)
    honest = sum(row.honest_alarms for row in rows)
    if honest:
        console.print(f"Besides, {counted(honest, 'alarm')} that say what a drawn rig is.", highlight=False)
    if unknown := statistics.unknown_text(rows):
        console.print(unknown, highlight=False)
    if trips := statistics.trips(rows):
        causes = ", ".join(f"{cause} {count}" for cause, count in trips.items())
        console.print(f"Tripped: {sum(trips.values())} of {counted(len(rows), 'run')}: {causes}", highlight=False)
    for name, guilty in statistics.broken(rows).items():
        if guilty:
            named = ", ".join(f"{row.key} (seed {row.seed}: {row.broken})" for row in guilty[:MAX_NAMED])
            more = f" and {len(guilty) - MAX_NAMED} more" if len(guilty) > MAX_NAMED else ""
            console.print(
                f"[bold red]{name}[/]: {counted(len(guilty), 'run')}: {named}{more}", highlight=False, soft_wrap=True
            )
    if not any(row.breaks for row in rows):
        console.print(f"All invariants hold in {counted(len(rows), 'run')}.", highlight=False)
    steps = sum(row.steps for row in rows)
    if steps:
        cpu_us = 1e6 * sum(row.cpu_s for row in rows) / steps
        console.print(f"{counted(steps, 'control step')}, {cpu_us:.0f} µs of processor time each.", highlight=False)


def _show_as_lines(console: Console, classes: Sequence[FaultClass]) -> None:
    """The same for a narrow terminal: a few lines for each class of faults, of at most 60 columns."""
    console.print("Median / 95th percentile:", highlight=False)
    for one in classes:
        bound = "" if one.bound_s is None else f", bound {one.bound_s:.2g} s"
        lines = (
            one.label,
            f"  {counted(one.runs, 'run')}, found {one.detected:.1%}, right {one.right:.1%}",
            *_growth_lines(one),
            f"  found after {spread_text(one.detection, 2)} s{bound}",
            f"  isolated after {spread_text(one.isolation, 2)} s",
            f"  size error 5 s later {spread_text(one.size_error_5s, 2)}",
        )
        for line in lines:
            console.print(line, highlight=False, markup=False)


def _growth_lines(one: FaultClass) -> tuple[str, ...]:
    return () if one.prompt is None else (f"  or among candidates {one.held:.1%}, {PROMPT} {one.prompt:.1%}",)


def _class_table(classes: Sequence[FaultClass]) -> Table:
    table = Table(title="Median / 95th percentile", title_justify="left")
    table.add_column("fault", no_wrap=True)
    grows = any(one.prompt is not None for one in classes)
    for name in (
        "runs",
        "found",
        "right",
        *(("or among\ncandidates", "right 60 s\nafter 5 %") if grows else ()),
        "found\nafter [s]",
        "bound\n[s]",
        "isolated\nafter [s]",
        "size error\n5 s later",
    ):
        table.add_column(name, justify="right")
    for one in classes:
        table.add_row(
            one.label,
            str(one.runs),
            f"{one.detected:.1%}",
            f"{one.right:.1%}",
            *((f"{one.held:.1%}", share_text(one.prompt)) if grows else ()),
            spread_text(one.detection, 2),
            "–" if one.bound_s is None else f"{one.bound_s:.2g}",
            spread_text(one.isolation, 2),
            spread_text(one.size_error_5s, 2),
        )
    return table
