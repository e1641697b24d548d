"""What a run leaves, as objects: key figures, time series, events. The figures are those of `kpi.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isnan, nan
from pathlib import Path
from typing import Any

from hil.campaigns.row import Row
from hil.campaigns.statistics import FaultClass, fault_classes
from hil.core.counted import counted
from hil.edge.record.manifest import Manifest
from hil.edge.record.run_folder import RunFolder
from hil.review.alarms import Finding
from hil.review.kpi import Kpi
from hil.review.ticks import Floats, LoggedEvent, Ticks, read


@dataclass(frozen=True, eq=False)
class RunResult:
    """One run: how it ended, its key figures, its time series and its events.

    Attributes
    ----------
    kpi : Kpi
        The key figures, field by field as in `kpi.json`.
    series : mapping of str to (n,) ndarray of float
        One array for each column of `ticks.csv`, one entry for each control step; NaN where a value is not known.
        Units stand in the names: `t_s`, `h1_V`, `v1_applied_V`, `theta1`, `true_h1_cm`, ...
    events : tuple of LoggedEvent
        Everything that was worth a line: time in s, severity, code, text, data.
    folder : pathlib.Path or None
        The run folder; None for a run that was kept in memory.
    manifest : Manifest
        What was run and how it ended, as in `run.json`.

    """

    kpi: Kpi
    series: Mapping[str, Floats]
    events: tuple[LoggedEvent, ...]
    manifest: Manifest
    folder: Path | None = None

    @property
    def status(self) -> str:
        """`complete`, `stopped`, `tripped`, `failed` or `interrupted`."""
        return self.kpi.status

    @property
    def reason(self) -> str:
        """Why the run ended."""
        return self.kpi.reason

    @property
    def iae_Vs(self) -> Mapping[str, tuple[float, float]]:  # noqa: N802 - units keep their case
        """Integral of the absolute error of outputs 1 and 2 in V s, by window; NaN for one not reached."""
        covered_s = self.kpi.iae_covered_s
        return {name: iae if covered_s[name] > 0.0 else (nan, nan) for name, iae in self.kpi.iae_Vs.items()}

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings of the run as nested dicts: `settings["rig"]`, `settings["scenario"]`."""
        return self.manifest.plan.settings

    @property
    def alarms(self) -> tuple[Finding, ...]:
        """What the fault detector reported: one finding for each fault, in the order in which they were raised."""
        return tuple(Finding(**alarm) for alarm in self.kpi.alarms)

    def figures(self) -> dict[str, Any]:
        """The key figures as a dict, the same as `kpi.json`."""
        return asdict(self.kpi)

    def report(self, path: str | Path) -> Path:
        """Write the report of the run, one HTML file that needs nothing else, and return its path."""
        from hil.review.run_report import Run, render

        run = Run(self.manifest, Ticks(self.series), self.events, self.kpi)
        file = Path(path)
        file.write_text(render(run), encoding="utf-8")
        return file

    def __repr__(self) -> str:
        where = "in memory" if self.folder is None else str(self.folder)
        iae = ", ".join(
            f"{name} not reached" if isnan(first) else f"{name} {first:.3f}, {second:.3f} V s"
            for name, (first, second) in self.iae_Vs.items()
        )
        steps, alarms = counted(len(self.series["t_s"]), "step"), counted(len(self.alarms), "alarm")
        return (
            f"<RunResult {self.kpi.scenario}: {self.status} ({self.reason}), {steps}, {alarms}, "
            f"IAE: {iae or 'no windows'}; {where}>"
        )


def result_of_folder(path: Path, kpi: Kpi) -> RunResult:
    """The result of a run that has left a run folder. Raises RunFolderError when it can't be read."""
    folder = RunFolder.open(path)
    ticks, events = read(folder)
    return RunResult(kpi, ticks.columns, events, folder.manifest(), path)


@dataclass(frozen=True, eq=False)
class CampaignResult:
    """A campaign: one row for each run.

    Attributes
    ----------
    name : str
        The campaign's name.
    rows : tuple of Row
        One for each run, in the order of the cases; its fields are the columns of `outcomes.parquet`.
    folder : pathlib.Path or None
        The campaign's folder; None when the rows were kept in memory.

    """

    name: str
    rows: tuple[Row, ...]
    folder: Path | None = None

    @property
    def broken(self) -> tuple[Row, ...]:
        """The rows of runs that broke an invariant or crashed; empty when all is well."""
        return tuple(row for row in self.rows if row.breaks)

    def classes(self) -> tuple[FaultClass, ...]:
        """Statistics for each class of faults: share found and named rightly, delays, size errors."""
        return tuple(fault_classes(self.rows))

    def __repr__(self) -> str:
        return f"<CampaignResult {self.name}: {counted(len(self.rows), 'run')}, {len(self.broken)} broken>"
