"""One row of the table of runs: what `run.json` and `kpi.json` of a run folder say, and its size on disk."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.edge.record.manifest import Manifest
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder

RUNNING, INTERRUPTED = "running", "interrupted"
NOT_READABLE = "unreadable"
"""Status of a folder whose run.json can't be understood."""


@dataclass(frozen=True)
class IndexedRun:
    """A run folder as a row.

    name : path of the folder below the folder of runs, with `/`. status : as readers show it, so "interrupted" for a
    run whose end is not recorded; "running" for one that surely goes on; "unreadable" where run.json can't be
    understood. duration_s : as in kpi.json; without it, between start and end as recorded; None: not known. rig : name
    of the rig file without its ending; "" where the run does not say it. law, design, detector : as the scenario names
    them. alarms, trips : how many. figures : all of kpi.json, {} where there is none. problem : why figures or all else
    is missing.
    """

    name: str
    started_utc: str = ""
    scenario: str = ""
    status: str = NOT_READABLE
    reason: str = ""
    mode: str = ""
    duration_s: float | None = None
    period_s: float | None = None
    rig: str = ""
    law: str = ""
    design: str = ""
    detector: str = ""
    seed: int | None = None
    reconfigure: bool | None = None
    alarms: int | None = None
    trips: int | None = None
    size_bytes: int = 0
    problem: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready values, `figures` last."""
        return asdict(self)

    @classmethod
    def of(cls, path: Path, name: str, size_bytes: int) -> IndexedRun:
        """Read a run folder. Never raises for what is in it: the row then says what is wrong."""
        try:
            manifest = RunFolder(path).manifest()
            return _row(path, name, manifest, size_bytes)
        except (RunFolderError, OSError, ValueError, TypeError, AttributeError, KeyError) as error:
            return cls(name=name, size_bytes=size_bytes, problem=" ".join(str(error).split()) or type(error).__name__)


def _row(path: Path, name: str, manifest: Manifest, size_bytes: int) -> IndexedRun:
    plan = manifest.plan
    figures, problem = _figures(path / "kpi.json")
    scenario = _table(plan.settings, "scenario")
    control, diagnosis = _table(scenario, "control"), _table(scenario, "diagnosis")
    return IndexedRun(
        name=name,
        started_utc=manifest.started_utc,
        scenario=plan.scenario,
        status=manifest.outcome,
        reason=manifest.reason,
        mode=plan.mode,
        duration_s=_duration_s(manifest, figures),
        period_s=plan.period_s,
        rig=_rig(plan.settings),
        law=str(control.get("law") or ""),
        design=str(control.get("design") or ""),
        detector=str(diagnosis.get("method") or ""),
        seed=plan.seed,
        reconfigure=plan.reconfigure,
        alarms=_count(figures, "alarms"),
        trips=_count(figures, "trips"),
        size_bytes=size_bytes,
        problem=problem,
        figures=figures,
    )


def _rig(settings: Mapping[str, Any]) -> str:
    name = settings.get("rig_file") if isinstance(settings, Mapping) else None
    return Path(name).stem if isinstance(name, str) else ""


def _figures(path: Path) -> tuple[Mapping[str, Any], str]:
    try:
        figures = json.loads(path.read_text(encoding="utf-8"), parse_constant=lambda _name: None)
    except FileNotFoundError:
        return {}, "no kpi.json: `hil report` makes it"
    except (OSError, ValueError) as error:
        return {}, f"kpi.json can't be read ({error}): `hil report` makes it again"
    if not isinstance(figures, dict):
        return {}, "kpi.json is no table: `hil report` makes it again"
    return figures, ""


def _duration_s(manifest: Manifest, figures: Mapping[str, Any]) -> float | None:
    found = figures.get("duration_s")
    if isinstance(found, int | float):
        return float(found)
    if manifest.ended_utc is None or manifest.plan.mode != "live":
        return None
    began, ended = datetime.fromisoformat(manifest.started_utc), datetime.fromisoformat(manifest.ended_utc)
    passed_s = (ended - began).total_seconds()
    return passed_s if passed_s >= 0.0 else None  # the wall clock was set back meanwhile


def _count(figures: Mapping[str, Any], key: str) -> int | None:
    found = figures.get(key)
    return len(found) if isinstance(found, list) else None


def _table(values: Any, key: str) -> Mapping[str, Any]:
    found = values.get(key) if isinstance(values, Mapping) else None
    return found if isinstance(found, Mapping) else {}
