"""`hil identify RUN... --check`: the verdict of recorded runs on the rig file, and its exit code."""

import json
from pathlib import Path

import pytest

from tests.cli.cli_bench import CommandLine, assert_refused, config_copy

SCENARIO = """
[scenario]
name = "weaker"
duration_s = 70.0

[[reference]]
at_s = 10.0
change_V = [0.5, -0.4]

[[reference]]
at_s = 40.0
change_V = [-0.3, 0.4]

[emulator]
pumps.gain_cm3_Vs = [3.2301, 3.35]
"""


def test_a_pump_that_gives_less_than_its_file_is_beyond_a_limit(tmp_path: Path, command_line: CommandLine) -> None:
    """The pump gives 3 % less. The file that the run has used claims 3 %, the other one 0.2 %."""
    (tmp_path / "weaker.toml").write_text(SCENARIO)
    config = config_copy(tmp_path / "config", file="rig.toml", old="pump_gain = 0.03 ", new="pump_gain = 0.002 ")
    run = tmp_path / "run"
    assert (
        command_line("hil", "simulate", tmp_path / "weaker.toml", "--out", run, "--no-rerun", "--no-report").code == 0
    )
    kpi = json.loads((run / "kpi.json").read_text())
    assert kpi["parameters"]["k1"]["shift_sd"] == pytest.approx(-1.0, abs=0.15)
    assert kpi["parameters"]["k1"]["estimate"] == pytest.approx(3.2301, rel=0.005)
    within = command_line("hil", "identify", run, "--check")
    assert within.code == 0
    assert "Nothing has moved by more than 3 standard deviations" in within.out
    out = tmp_path / "check"
    beyond = command_line("hil", "identify", run, "--check", "--config", config, "--out", out)
    assert beyond.code == 5
    assert "Pump 1 gives 3" in beyond.out
    assert max(map(len, beyond.out.splitlines()[:8])) <= 80
    assert json.loads((out / "check.json").read_text())["beyond"] == ["k1"]
    assert (out / "trend.png").read_bytes().startswith(b"\x89PNG")


def test_check_wants_runs(tmp_path: Path, command_line: CommandLine) -> None:
    assert_refused(command_line("hil", "identify", "--check"), "name their folders")
    assert_refused(command_line("hil", "identify", tmp_path, "--check"), "is not a run folder")
