"""One run on the emulator for all tests of what reads and exports a run's record."""

from __future__ import annotations

import pytest

import hil
from hil.edge.record.run_folder import RunFolder


@pytest.fixture(scope="session")
def bench_run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Six simulated seconds, about 900 frames."""
    out = tmp_path_factory.mktemp("runs") / "bench"
    hil.simulate(hil.load("steps"), out=out, seed=15, duration_s=6.0, rerun=False)
    return RunFolder.open(out)
