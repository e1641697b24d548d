"""One recorded run for many tests: 30 s in lockstep, with a loss that is found, and operator's requests."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.bench import assembly, lockstep_run
from hil.bench.run_options import RunOptions

SCENARIO = """
[scenario]
name = "replayed"
duration_s = 24.0

[[reference]]
at_s = 4.0
change_V = [0.2, 0.1]

[[fault]]
at_s = 8.0
kind = "pump_effectiveness"
target = 1
value = 0.4

[[request]]
at_s = 20.0
action = "manual"

[[request]]
at_s = 22.0
action = "auto"

[diagnosis]
method = "glr"

[control]
reconfigure = true
design = "rig"
"""


@pytest.fixture(scope="session")
def recorded_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder that no test changes."""
    place = tmp_path_factory.mktemp("replayed")
    (place / "replayed.toml").write_text(SCENARIO)
    bench = assembly.load(place / "replayed.toml")
    lockstep_run.simulate(bench, RunOptions(place / "run", rerun=False))
    return place / "run"
