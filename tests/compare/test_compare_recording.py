"""The recording of a comparison, read back with Rerun's own tool."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hil.compare.compare_recording import tree_names
from hil.compare.compared_run import CompareError
from hil.compare.comparison import Comparison


def test_a_recording_has_a_tree_for_each_run(runs: Path, tmp_path: Path) -> None:
    path = tmp_path / "new/all.rrd"
    Comparison.of([runs / name for name in ("first", "slow", "killed", "bare")], "200").write_recording(path)
    shown = subprocess.run(
        [sys.executable, "-m", "rerun_cli", "rrd", "print", str(path)], capture_output=True, text=True, check=True
    ).stdout
    for tree in ("first", "slow", "killed"):
        for entity in ("levels/tank1", "pumps/pump2", "states/mode", "log", "overlaid/output1"):
            assert f"/{tree}/{entity}" in shown
    assert "/bare" not in shown
    assert "/view/5c0dca6a-e63f-9cf7-f657-2602590474cc/TimeAxis" in shown, "the range that all plots share"


def test_names_of_trees_are_plain_and_different() -> None:
    assert tree_names(["a b", "a/b", "ok-1", ""]) == ["a_b", "a_b_2", "ok-1", "run"]


def test_a_recording_that_can_not_be_written_is_one_line(runs: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(CompareError, match="can't be written"):
        Comparison.of([runs / "first", runs / "slow"]).write_recording(tmp_path / "file/all.rrd")
