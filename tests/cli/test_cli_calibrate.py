"""`hil calibrate` with points from a file: what it shows, writes and refuses."""

import json
from pathlib import Path

import pytest

from tests.cli.cli_bench import CommandLine, assert_refused

POINTS = "tank,level_cm,reading_V\n1,2,1.11\n1,18,8.79\n3,2,1.0\n3,18,9.0\n"


def written(folder: Path, text: str = POINTS) -> Path:
    file = folder / "points.csv"
    file.write_text(text)
    return file


def test_points_from_a_file_give_gain_and_offset_with_their_uncertainty(
    tmp_path: Path, command_line: CommandLine
) -> None:
    out = tmp_path / "calibration"
    done = command_line("hil", "calibrate", "--points", written(tmp_path), "--out", out)
    assert done.code == 0, done
    assert "0.48000 ± 0.00424" in done.out
    assert "0.1500 ± 0.0543" in done.out
    figures = json.loads((out / "calibration.json").read_text())["parameters"]
    assert set(figures) == {"sensor_gain1", "sensor_offset1", "sensor_gain3", "sensor_offset3"}
    one = figures["sensor_gain1"]
    assert one["low"] < one["value"] < one["high"]
    assert (one["was"], one["unit"], one["status"]) == (0.5, "V/cm", "identified")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("tank,level_cm,reading_V\n1,2,1.0\n1,3,1.5\n", "too close"),
        ("tank,level_cm,reading_V\n1,2,1.0\n1,30,9.0\n", "level 30 cm is outside 0..20 cm"),
        ("tank,level_cm,reading_V\n1,2,1.0\n1,10,6.0\n1,18,9.0\n", "do not lie on a line"),
        ("tank,level_cm,reading_V\n0,2,1.0\n", "tank = 0"),
    ],
)
def test_points_that_give_no_calibration_are_refused_and_leave_nothing(
    text: str, why: str, tmp_path: Path, command_line: CommandLine
) -> None:
    out = tmp_path / "calibration"
    assert_refused(command_line("hil", "calibrate", "--points", written(tmp_path, text), "--out", out), why)
    assert not out.exists()


def test_a_folder_that_exists_is_not_overwritten(tmp_path: Path, command_line: CommandLine) -> None:
    assert_refused(command_line("hil", "calibrate", "--points", written(tmp_path), "--out", tmp_path), "exists already")
