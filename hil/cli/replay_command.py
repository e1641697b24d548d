"""`hil replay` on the terminal: the verdict, the alarms, and what is in doubt."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.cli import exit_codes
from hil.core.counted import counted
from hil.replay.replay_run import ReplayOptions, ReplayResult, replay
from hil.review.alarms import Finding


def run(console: Console, record: Path, options: ReplayOptions, *, as_json: bool) -> int:
    """Replay and show; returns the exit code."""
    result = replay(record, options)
    if as_json:
        console.out(json.dumps(_as_json(result), indent=2), highlight=False)
    else:
        _show(console, result)
    return 0 if result.is_same else exit_codes.DIFFERS


def _show(console: Console, result: ReplayResult) -> None:
    say = console.print
    plain: dict[str, Any] = {"markup": False, "highlight": False, "soft_wrap": True}
    if result.comparison is None:
        say(f"what if: {result.what_if}; the commands are not compared", **plain)
    elif result.comparison.first is None:
        say(f"same commands as recorded: {counted(result.comparison.compared, 'command')}", **plain)
    else:
        say(f"first difference: {result.comparison.first}", **plain)
        say(f"{result.comparison.differing} of {counted(result.comparison.compared, 'command')} differ", **plain)
    if result.comparison is not None and result.comparison.rounded:
        rounded = counted(result.comparison.rounded, "command")
        say(f"{rounded} differ by rounding only, {result.comparison.largest_V:g} V at the most", **plain)
    if result.recorded_alarms or result.replayed_alarms:
        say(_alarm_table(result), markup=False, highlight=False)
    for doubt in result.doubts:
        say(f"not exact: {doubt}", **plain)


def _alarm_table(result: ReplayResult) -> Table:
    table = Table(title="alarms", title_justify="left")
    table.add_column("recorded", overflow="fold")
    table.add_column("today", overflow="fold")
    recorded = result.recorded_alarms or ()
    for number in range(max(len(recorded), len(result.replayed_alarms))):
        table.add_row(_said(recorded, number), _said(result.replayed_alarms, number))
    return table


def _said(findings: Sequence[Finding], number: int) -> str:
    if number >= len(findings):
        return ""
    one = findings[number]
    at = "" if one.detected_s is None else f"{one.detected_s:.1f} s: "
    return f"{at}{one.kind} {one.target}"


def _as_json(result: ReplayResult) -> dict[str, Any]:
    compared = result.comparison
    return {
        "record": str(result.where),
        "what_if": asdict(result.what_if),
        "is_same": None if compared is None else result.is_same,
        "commands": None if compared is None else asdict(compared),
        "recorded_alarms": None if result.recorded_alarms is None else [asdict(one) for one in result.recorded_alarms],
        "alarms": [asdict(one) for one in result.replayed_alarms],
        "doubts": list(result.doubts),
    }
