"""Run folders with a few files in them; none is the record of a loop."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from hil.edge.record.manifest import Status
from hil.edge.record.run_folder import RunFolder
from tests.review import toy

BEGAN = datetime(2026, 11, 20, 8, tzinfo=UTC)
FIGURES = {
    "status": "complete",
    "iae_Vs": {"gain_fall": [0.5, 0.25], "reference_step": [6.0, 6.5]},
    "alarms": [{"kind": "pump_effectiveness", "target": 1}],
    "trips": [],
    "duration_s": 500.0,
    "skipped": 0,
    "dry_run": None,
}

MakeRun = Callable[..., Path]


@pytest.fixture
def make_run(tmp_path: Path) -> MakeRun:
    """Make a run folder `name` below tmp_path/runs. figures : None leaves kpi.json out."""
    made: list[str] = []

    def make(
        name: str, *, status: Status | None = "complete", figures: dict[str, Any] | None = FIGURES, seed: int = 1
    ) -> Path:
        settings = toy.SETTINGS | {
            "rig_file": "bench2.toml",
            "scenario": {"control": {"law": "state_feedback", "design": "lqr"}, "diagnosis": {"method": "glr"}},
        }
        plan = replace(toy.plan(), seed=seed, settings=settings)
        began = BEGAN + timedelta(hours=len(made))
        made.append(name)
        folder = RunFolder.create(tmp_path / "runs" / name, plan, began)
        if status is not None:
            folder.finish(status, "duration over", ended=began + timedelta(minutes=1))
        if figures is not None:
            folder.kpi_path.write_text(json.dumps(figures))
        folder.ticks_path.write_text("t_s\n" + "0.0\n" * 250)
        return folder.path

    return make
