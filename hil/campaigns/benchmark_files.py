"""A benchmark's results for other programs: `benchmark.json`, `benchmark.csv`, `runs.csv`.

`benchmark.csv` has a line for each entrant and window, `runs.csv` one for each run and window. Unknown values are null
or empty; what is infinite, because runs did not end, is "inf".
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hil.campaigns.benchmark_report import METHOD
from hil.campaigns.contests import Contest
from hil.campaigns.row import Row
from hil.campaigns.standing import Standings
from hil.campaigns.standings import figures_of, how_it_ended
from hil.edge.record.file_writing import write_atomically


def write_files(folder: Path, name: str, runs: Sequence[tuple[Contest, Row]], standings: Standings) -> tuple[Path, ...]:
    """Write the three files and say where they are."""
    about = {"name": name, "method": " ".join(METHOD), **asdict(standings)}
    files = {
        folder / "benchmark.json": json.dumps(_plain(about), indent=2, ensure_ascii=False, allow_nan=False) + "\n",
        folder / "benchmark.csv": _csv(_flat(asdict(one)) for one in standings.of_courses),
        folder / "runs.csv": _csv(_run_lines(runs)),
    }
    for path, text in files.items():
        write_atomically(path, text)
    return tuple(files)


def _run_lines(runs: Sequence[tuple[Contest, Row]]) -> Iterable[dict[str, Any]]:
    for contest, row in runs:
        about = {
            "key": row.key,
            **asdict(contest.entrant),
            "scenario": contest.scenario,
            "seed": row.seed,
            "ended": how_it_ended(row) or "complete",
            "detection_s": row.detection_s,
            "bound_s": row.bound_s,
            "right": row.right,
            "false_alarms": row.false_alarms,
            "cpu_s": row.cpu_s,
        }
        for window in contest.case.scenario_data.get("window", ()):
            yield {**about, "window": window["name"], **_flat(figures_of(row, str(window["name"])) or {})}


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Tables and lists as columns: iae_Vs_1, ratio_low."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        key = f"{prefix}{name}"
        if name in ("entrant", "course"):
            found |= _flat(value)
        elif name == "endings":
            found[key] = "; ".join(f"{cause}: {count}" for cause, count in value.items())
        elif isinstance(value, Mapping):
            found |= _flat(value, f"{key}_")
        elif isinstance(value, list | tuple):
            found |= {f"{key}_{place}": one for place, one in enumerate(value, 1)}
        else:
            found[key] = value
    return found


def _csv(lines: Iterable[Mapping[str, Any]]) -> str:
    known = list(lines)
    columns = list(dict.fromkeys(column for line in known for column in line))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(known)
    return text.getvalue()


def _plain(value: Any) -> Any:
    """As JSON can say it."""
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
