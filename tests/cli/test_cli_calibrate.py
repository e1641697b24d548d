"""`hil calibrate` with points from a file: what it shows, writes and refuses."""

import json
import tomllib
from pathlib import Path

import pytest

from tests.cli.cli_bench import CONFIG, CommandLine, assert_refused, config_copy

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


def test_the_new_rig_file_is_shown_as_a_difference_and_the_old_one_is_left_alone(
    tmp_path: Path, command_line: CommandLine
) -> None:
    out, config = tmp_path / "calibration", config_copy(tmp_path / "config")
    done = command_line("hil", "calibrate", "--points", written(tmp_path), "--out", out, "--config", config)
    new, old = (out / "calibrated.toml").read_text(), (CONFIG / "rig.toml").read_text()
    assert tomllib.loads(new)["sensors"]["gain_V_cm"] == [0.48, 0.5, 0.5, 0.5]
    assert tomllib.loads(new)["sensors"]["offset_V"] == [0.15, 0.0, 0.0, 0.0]
    assert (config / "rig.toml").read_text() == old
    shown = [line for line in done.out.splitlines() if line.startswith(("+g", "+o", "-g", "-o"))]
    assert [line[0] for line in shown] == ["-", "-", "+", "+"]
    assert len(set(new.splitlines()) - set(old.splitlines())) == 2, "comments and all other lines stay"


def test_write_replaces_the_rig_file_and_keeps_a_copy(tmp_path: Path, command_line: CommandLine) -> None:
    config, old = config_copy(tmp_path / "config"), (CONFIG / "rig.toml").read_text()
    command = ("hil", "calibrate", "--points", written(tmp_path), "--config", config, "--write", "--out")
    assert command_line(*command, tmp_path / "first").code == 0
    assert (config / "rig.toml").read_text() == (tmp_path / "first" / "calibrated.toml").read_text()
    (copy,) = config.glob("rig-*.toml")
    assert copy.read_text() == old
    again = command_line(*command, tmp_path / "again")
    assert "says this already" in again.out
    assert len(list(config.glob("rig-*.toml"))) == 1, "nothing was replaced"


def test_falling_sensors_are_calibrated(tmp_path: Path, command_line: CommandLine) -> None:
    points = written(tmp_path, "tank,level_cm,reading_V\n1,4,5.320\n1,30,1.830\n")
    out = tmp_path / "calibration"
    done = command_line("hil", "calibrate", "--points", points, "--out", out, "--rig", "decenter2021")
    assert done.code == 0, done
    sensors = tomllib.loads((out / "calibrated.toml").read_text())["sensors"]
    assert sensors["gain_V_cm"] == [-0.13423, -0.1415, -0.1436, -0.1456]
    assert sensors["offset_V"][0] == pytest.approx(5.8569)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("tank,level_cm,reading_V\n1,2,1.0\n1,3,1.5\n", "too close"),
        ("tank,level_cm,reading_V\n1,2,1.0\n1,30,9.0\n", "level 30 cm is outside 0..20 cm"),
        ("tank,level_cm,reading_V\n1,2,1.0\n1,10,6.0\n1,18,9.0\n", "do not lie on a line"),
        ("tank,level_cm,reading_V\n0,2,1.0\n", "tank = 0"),
        ("tank,level_cm,reading_V\n1,2,3.0\n1,14,10.2\n", "as calibrated: sensor 1 would read 13.2 V at 19 cm"),
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
