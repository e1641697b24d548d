"""Short toy runs, recorded once: with and without reconfiguration, another period, killed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.review import toy


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the runs `first`, `fixed`, `slow` (half as many steps), `killed` (cut off), `bare` (no step)."""
    folder = tmp_path_factory.mktemp("compare")
    toy.record_run(folder / "first", until_s=212.0, period_s=0.5)
    toy.record_run(folder / "fixed", until_s=212.0, period_s=0.5, reconfigure=False)
    toy.record_run(folder / "slow", until_s=230.0, period_s=1.0)
    killed = folder / "killed"
    shutil.copytree(folder / "first", killed)
    manifest = json.loads((killed / "run.json").read_text())
    manifest["status"], manifest["ended_utc"] = "running", None
    (killed / "run.json").write_text(json.dumps(manifest))
    ticks = (killed / "ticks.csv").read_bytes()
    (killed / "ticks.csv").write_bytes(ticks[: int(0.98 * len(ticks))])
    bare = folder / "bare"
    shutil.copytree(killed, bare)
    (bare / "ticks.csv").write_bytes(ticks[: ticks.index(b"\n") + 1])
    return folder
