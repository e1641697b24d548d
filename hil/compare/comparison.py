"""A comparison of runs: read, compared, and written as a page, as JSON and as a recording."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hil.compare.compared_run import START, ComparedRun, compared_runs, run_paths
from hil.compare.differences import Difference, differences
from hil.compare.figure_rows import FigureRow, figure_rows
from hil.edge.record.file_writing import write_atomically


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs beside each other. align : as asked for. differences : of the configuration. rows : key figures."""

    runs: tuple[ComparedRun, ...]
    align: str
    differences: tuple[Difference, ...]
    rows: tuple[FigureRow, ...]

    @classmethod
    def of(cls, paths: Sequence[Path], align: str = START, *, whole: bool = True) -> Comparison:
        """Compare run folders, and those within folders that are none.

        align : start, a time in s, or an event: trip, alarm:1 (its number), CODE:N (the N-th of that code).
        whole : also for a recording; without it long runs are read more quickly. Raises RunFolderError, one line, for
        fewer than two runs, a record that can't be read, or one without the moment.
        """
        runs = compared_runs(run_paths(paths), align, whole=whole)
        found = differences([run.manifest for run in runs])
        return cls(runs, align, found, figure_rows([run.figures for run in runs]))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader has to know of the records, a line each."""
        notes = [note for run in self.runs for note in run.notes]
        periods = dict.fromkeys(run.manifest.plan.period_s for run in self.runs)
        if len(periods) > 1:
            shown = ", ".join(f"{period_s:g} s" for period_s in periods)
            notes.append(f"the control periods differ: {shown}; each run is drawn at its own steps")
        if len({run.kpi.iae_source for run in self.runs if len(run.ticks)}) > 1:
            notes.append("the IAE is from true levels for some runs, and from estimated ones for others")
        notes += self._unequal_windows()
        return tuple(notes)

    def _unequal_windows(self) -> list[str]:
        """Windows that some runs have recorded longer than others: their integrals can't be compared as they are."""
        found = []
        drawn = [run for run in self.runs if len(run.ticks)]
        spare_s = 2.0 * max((run.manifest.plan.period_s for run in drawn), default=0.0)
        for window in dict.fromkeys(name for run in drawn for name in run.kpi.iae_covered_s):
            parts_s = [run.kpi.iae_covered_s[window] for run in drawn if window in run.kpi.iae_covered_s]
            if max(parts_s) - min(parts_s) > spare_s:
                shown = ", ".join(f"{part_s:.4g}" for part_s in parts_s)
                found.append(f"of the window {window} the runs have different parts ({shown} s): mind it at their IAE")
        return found

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready values."""
        runs = [
            {
                "name": run.name,
                "path": str(run.folder.path),
                "scenario": run.manifest.plan.scenario,
                "status": run.manifest.outcome,
                "reason": run.manifest.reason,
                "started_utc": run.manifest.started_utc,
                "mode": run.manifest.plan.mode,
                "period_s": run.manifest.plan.period_s,
                "seed": run.manifest.plan.seed,
                "aligned_at_s": run.zero_s,
            }
            for run in self.runs
        ]
        return {
            "align": self.align,
            "runs": runs,
            "notes": list(self.notes),
            "differences": [asdict(one) for one in self.differences],
            "figures": [asdict(row) for row in self.rows],
        }

    def write_report(self, folder: Path) -> Path:
        """Write report.html and compare.json into a new or old folder; where the page is. Raises OSError."""
        from hil.compare.compare_report import render

        folder.mkdir(parents=True, exist_ok=True)
        page = folder / "report.html"
        text = json.dumps(self.as_dict(), indent=2, ensure_ascii=False, allow_nan=False)
        write_atomically(folder / "compare.json", text + "\n")
        write_atomically(page, render(self.runs, self.differences, self.rows, self.notes, self.align))
        return page

    def write_recording(self, path: Path) -> None:
        """Write the runs as one recording for the Rerun viewer. Raises CompareError."""
        from hil.compare.compare_recording import write_recording

        write_recording(path, self.runs)
