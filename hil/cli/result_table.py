"""The table of results: check, verdict, what was found and what to do."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from hil.probe.check_result import Result, Verdict

EXIT_FAILED = 4
STYLES = {Verdict.PASS: "green", Verdict.WARN: "yellow", Verdict.FAIL: "bold red", Verdict.NOT_CHECKED: "dim"}


def table(title: str, results: Sequence[Result]) -> Table:
    """One row for each result."""
    rows = Table(title=title, title_justify="left", expand=False)
    for heading in ("check", "", "found, and what to do"):
        rows.add_column(heading, overflow="fold")
    for result in results:
        mark = f"[{STYLES[result.verdict]}]{result.verdict.value}[/]"
        advice = f"\n[bold]→[/] {escape(result.advice)}" if result.advice else ""
        rows.add_row(escape(result.check), mark, escape(result.found) + advice)
    return rows


def tally(results: Sequence[Result]) -> str:
    """Number of results by verdict."""
    counts = {verdict: sum(result.verdict is verdict for result in results) for verdict in Verdict}
    return ", ".join(f"{count} {verdict.value}" for verdict, count in counts.items() if count)
