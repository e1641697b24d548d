"""Runs on a disturbed bus, with trips that are cleared: the replay repeats each of them without a difference."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.bench import assembly, lockstep_run
from hil.bench.run_options import RunOptions
from hil.replay.replay_run import ReplayOptions, replay

SCENARIO = """
[scenario]
name = "disturbed"
duration_s = 20.0

[diagnosis]
method = "none"

[control]
design = "rig"

[[fault]]
at_s = 5.0
kind = "{kind}"
{what}

[[request]]
at_s = 15.0
action = "clear"
"""

FAULTS = {
    "frame_loss": 'target = "all"\nvalue = 0.2',
    "frame_reorder": 'target = "all"',
    "frame_delay": 'target = "all"\nvalue = 0.03',
    "remote_frame": 'target = "LowerLevels"\nuntil_s = 5.3',
    "extended_id": 'target = "LowerLevels"\nuntil_s = 5.2',
    "foreign_command": 'target = "PumpCommand"\nvalue = 3.0',
    "error_frames": 'target = "all"\nvalue = 50.0\nuntil_s = 6.0',
    "bus_off": 'target = "all"',
    "node_reboot": 'target = "pump"',
    "node_silent": 'target = "level"\nuntil_s = 8.0',
    "clock_jump": 'target = "pump"\nvalue = 0.5',
}


@pytest.mark.long
@pytest.mark.parametrize("kind", FAULTS)
def test_a_run_on_a_disturbed_bus_is_repeated(kind: str, tmp_path: Path) -> None:
    """Rejected frames, commands of another controller and steps that sent nothing are in the record as well."""
    (tmp_path / "disturbed.toml").write_text(SCENARIO.format(kind=kind, what=FAULTS[kind]))
    lockstep_run.simulate(assembly.load(tmp_path / "disturbed.toml"), RunOptions(tmp_path / "run", rerun=False))
    result = replay(tmp_path / "run", ReplayOptions(tolerance_V=0.0))
    assert result.is_same, result.summary
    assert result.comparison is not None
    assert result.comparison.rounded == 0
    assert result.comparison.compared == len((tmp_path / "run/sent.log").read_text().splitlines()) > 50
    lines = (tmp_path / "run/events.jsonl").read_text().splitlines()
    assert result.replayed.event_text.splitlines() == lines[:-1], "all but the end of the run"
    assert result.doubts == ()
