"""`hil calibrate` against the emulator in a process of its own: two sessions at two levels make one calibration."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.live.live_bench import BIN, CONFIG, emulator

pytestmark = pytest.mark.live


def session(folder: Path, start_V: float, points: str, out: Path) -> subprocess.CompletedProcess[str]:
    """A session at the levels of these pump voltages: the emulator holds them until its pump node runs."""
    config = shutil.copytree(CONFIG, folder / f"config {start_V}")
    text = (config / "emulator.toml").read_text()
    assert "start_V = [3.0, 3.0]" in text
    (config / "emulator.toml").write_text(text.replace("start_V = [3.0, 3.0]", f"start_V = [{start_V}, {start_V}]"))
    file = folder / f"wanted {start_V}.csv"
    file.write_text(points)
    with emulator(folder / f"{start_V}.jsonl", "--config", config) as node:
        command = ["calibrate", "-i", "slcan", "-c", node.channel, "--points", str(file), "--out", str(out)]
        done = subprocess.run(
            [BIN / "hil", *command], input="\n", capture_output=True, text=True, timeout=60.0, check=False
        )
        assert not node.commanded()
        assert not node.has_ever_applied()
    return done


def test_a_second_session_completes_the_points_of_the_first(tmp_path: Path) -> None:
    """The levels are the equilibria at 3 V and 2 V of both pumps."""
    first = session(tmp_path, 3.0, "tank,level_cm\n1,12.263\n", tmp_path / "first")
    kept = tmp_path / "first" / "points.csv"
    assert first.returncode == 2, first.stdout + first.stderr
    assert "1 point at one level" in first.stderr
    assert f"the points are kept in {kept}" in " ".join(first.stderr.split())
    second = session(tmp_path, 2.0, kept.read_text() + "1,5.450,,,\n", tmp_path / "second")
    assert second.returncode == 0, second.stdout + second.stderr
    figures = json.loads((tmp_path / "second" / "calibration.json").read_text())["parameters"]
    assert figures["sensor_gain1"]["value"] == pytest.approx(0.5, rel=2e-3)
    assert figures["sensor_offset1"]["value"] == pytest.approx(0.0, abs=0.01)
