"""`hil replay` on the terminal: the verdict, the alarms, and what is in doubt."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.cli import exit_codes
from hil.cli.run_progress import progress
from hil.edge.record.file_writing import write_atomically
from hil.replay.alarm_difference import in_words
from hil.replay.reference_file import reference_path
from hil.replay.replay_run import ReplayOptions, ReplayResult, replay


def run(console: Console, record: Path, options: ReplayOptions, *, as_json: bool, figure: Path | None) -> int:
    """Replay and show; returns the exit code. Raises what `replay` raises, and IncompleteRecordError for the figure."""
    with progress(console, "steps replayed") as advance:
        result = replay(record, options, advance)
    if as_json:
        console.out(json.dumps(_as_json(result), indent=2), highlight=False)
    else:
        _show(console, result)
    if figure is not None:
        from hil.replay.replay_page import replay_page

        write_atomically(figure, replay_page(result))
        if not as_json:
            console.print(str(figure), markup=False, highlight=False, soft_wrap=True)
    if options.update:
        if not as_json:
            console.print(f"new reference: {reference_path(record)}", markup=False, highlight=False, soft_wrap=True)
        return 0
    return 0 if result.is_same else exit_codes.DIFFERS


def _show(console: Console, result: ReplayResult) -> None:
    for line in result.summary:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if result.recorded_alarms or result.replayed_alarms:
        console.print(_alarm_table(result), markup=False, highlight=False)
    for doubt in result.doubts:
        console.print(f"not exact: {doubt}", markup=False, highlight=False, soft_wrap=True)


def _alarm_table(result: ReplayResult) -> Table:
    table = Table(title="alarms", title_justify="left")
    for name in result.columns:
        table.add_column(name, overflow="fold")
    recorded, today = result.recorded_alarms or (), result.replayed_alarms
    for at in range(max(len(recorded), len(today))):
        table.add_row(*(in_words(ones[at]) if at < len(ones) else "" for ones in (recorded, today)))
    return table


def _as_json(result: ReplayResult) -> dict[str, Any]:
    compared = result.comparison
    return {
        "record": str(result.where),
        "what_if": asdict(result.what_if),
        "is_same": None if compared is None else result.is_same,
        "reference": result.reference_version or None,
        "alarm_difference": result.alarm_difference,
        "commands": None if compared is None else asdict(compared),
        "recorded_alarms": None if result.recorded_alarms is None else [asdict(one) for one in result.recorded_alarms],
        "alarms": [asdict(one) for one in result.replayed_alarms],
        "doubts": list(result.doubts),
    }
