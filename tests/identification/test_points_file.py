"""Known levels from a file: both formats, and errors that name file, line, value and range."""

from pathlib import Path

import pytest

from hil.core.identification.calibration import LevelPoint
from hil.edge.config.points_file import load_points, points_csv
from hil.edge.config.settings_file import SettingsError


def written(folder: Path, text: str, name: str = "points.csv") -> Path:
    file = folder / name
    file.write_text(text)
    return file


def test_csv_and_toml_have_the_same_points(tmp_path: Path) -> None:
    from_csv = load_points(written(tmp_path, "tank, level_cm, reading_V\n1, 3, 1.5\n\n4, 15.0,\n"))
    toml = "[[point]]\ntank = 1\nlevel_cm = 3.0\nreading_V = 1.5\n[[point]]\ntank = 4\nlevel_cm = 15.0\n"
    assert from_csv == load_points(written(tmp_path, toml, "points.toml"))
    assert from_csv[0].point == LevelPoint(0, 3.0, 1.5)
    assert from_csv[1].point is None


def test_points_that_were_written_are_read_again(tmp_path: Path) -> None:
    points = [LevelPoint(2, 3.25, 1.62512, 0.05, 0.0004)]
    assert [one.point for one in load_points(written(tmp_path, points_csv(points)))] == points


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("tank,level\n1,3\n", r"points\.csv line 1: columns tank, level; wanted tank, level_cm"),
        ("tank,level_cm\n5,3\n", r"points\.csv line 2: tank = 5: must be .* at most 4"),
        ("tank,level_cm\n1,3\n1,high\n", r"points\.csv line 3: level_cm = 'high'"),
        ("tank,level_cm\n1,-3\n", r"line 2: level_cm = -3\.0"),
        ("tank,level_cm\n1\n", r"line 2: 1 values for 2 columns"),
        ("tank,level_cm\n", "has no points"),
    ],
)
def test_a_bad_file_is_refused(tmp_path: Path, text: str, why: str) -> None:
    with pytest.raises(SettingsError, match=why):
        load_points(written(tmp_path, text))
