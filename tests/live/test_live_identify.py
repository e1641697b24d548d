"""`hil identify` on a bus: Ctrl-C in a phase stops the pumps, and the same command goes on to the result."""

import json
import signal
from pathlib import Path

import pytest

from tests.live.live_bench import emulator, start
from tests.waiting import wait_for

pytestmark = pytest.mark.live

EMPTY = """
[scenario]
name = "empty"
duration_s = 60.0

[emulator]
tanks.start_V = [0.0, 0.0]
"""


def command(channel: str, out: Path) -> list[str | Path | int]:
    options = ["--yes", "--no-rerun", "--minutes", "0.4"]
    return ["hil", "identify", "-i", "slcan", "-c", channel, "--out", out, *options]


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "empty.toml"
    path.write_text(EMPTY)
    return path


def test_ctrl_c_stops_the_pumps(tmp_path: Path, scenario: Path) -> None:
    out = tmp_path / "identified"
    with emulator(tmp_path / "changes.jsonl", scenario=scenario) as node:
        process = start(command(node.channel, out))
        wait_for(node.has_ever_applied, timeout_s=40.0)
        process.send_signal(signal.SIGINT)
        said, error = process.communicate(timeout=30.0)
        assert process.returncode == 130, error
        assert node.pump()[-1]["applied_V"] == [0.0, 0.0]
    assert "fill: pumps at 0 V until the tanks are empty" in said
    assert json.loads((out / "phases" / "01_fill" / "run.json").read_text())["reason"] == "SIGINT"


@pytest.mark.long
def test_the_same_command_goes_on_after_ctrl_c(tmp_path: Path, scenario: Path) -> None:
    out = tmp_path / "identified"
    with emulator(tmp_path / "changes.jsonl", scenario=scenario) as node:
        process = start(command(node.channel, out))
        steps = out / "phases" / "02_steps" / "can.log"
        wait_for(steps.exists, timeout_s=40.0)
        runs = len(node.commanded())
        wait_for(lambda: len(node.commanded()) > runs, timeout_s=20.0)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=30.0)
        assert process.returncode == 130, error
        assert "the same command goes on" in " ".join(error.split())
        assert node.pump()[-1]["applied_V"] == [0.0, 0.0]
        assert json.loads((steps.parent / "run.json").read_text())["status"] == "stopped"

        second = start(command(node.channel, out))
        said, error = second.communicate(timeout=90.0)
        assert second.returncode == 0, said + error
        assert "fill: is recorded" in said
        assert node.pump()[-1]["applied_V"] == [0.0, 0.0]
    figures = json.loads((out / "identification.json").read_text())["parameters"]
    # 24 seconds of experiment: enough for a per cent
    assert figures["k1"]["value"] == pytest.approx(3.33, rel=0.02)
    assert figures["a1"]["value"] == pytest.approx(0.071, rel=0.1)
    assert sorted(path.name for path in (out / "phases").iterdir())[:3] == ["01_fill", "02_steps", "02_steps_2"]
