"""The trash of a folder of runs: what is moved can be moved back, and a run that goes on stays."""

from __future__ import annotations

import os
import socket
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from hil.run_index import life_signs
from hil.run_index.index_file import index_of
from hil.run_index.trash import (
    TrashContent,
    TrashError,
    empty_trash,
    move_to_trash,
    run_named,
    trash_content,
    why_running,
)
from tests.run_index.conftest import MakeRun

NOW = datetime(2026, 11, 26, 12, tzinfo=UTC)


def age(path: Path, by_s: float = 1000.0) -> None:
    """Let the files of a folder be old."""
    then_s = time.time() - by_s
    for file in path.iterdir():
        os.utime(file, (then_s, then_s))


def test_a_run_is_moved_whole_and_can_be_moved_back(make_run: MakeRun, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    path = make_run("campaign/phases/01")
    files = {file.name: file.read_bytes() for file in path.iterdir()}
    moved = move_to_trash(runs, "campaign/phases/01", NOW)
    assert moved == runs / ".trash/20261126-120000/campaign/phases/01"
    assert index_of(runs) == ()
    assert trash_content(runs) == TrashContent(1, sum(map(len, files.values())))
    moved.rename(path)
    assert {file.name: file.read_bytes() for file in path.iterdir()} == files
    assert [row.name for row in index_of(runs)] == ["campaign/phases/01"]


def test_two_runs_of_one_name_in_one_second_have_a_place_each(make_run: MakeRun, tmp_path: Path) -> None:
    for _ in range(2):
        make_run("first")
        move_to_trash(tmp_path / "runs", "first", NOW)
    assert trash_content(tmp_path / "runs").runs == 2
    empty_trash(tmp_path / "runs")
    empty_trash(tmp_path / "runs")
    assert trash_content(tmp_path / "runs") == TrashContent(0, 0)


def test_a_run_whose_files_are_open_is_not_moved(make_run: MakeRun, tmp_path: Path) -> None:
    path = make_run("live", status=None)
    age(path)
    with (path / "ticks.csv").open("a"), pytest.raises(TrashError, match="still runs"):
        move_to_trash(tmp_path / "runs", "live", NOW)
    assert move_to_trash(tmp_path / "runs", "live", NOW).is_dir()


def test_a_run_that_listens_is_not_moved(make_run: MakeRun) -> None:
    path = make_run("r", status=None)
    before = Path.cwd()
    os.chdir(path)  # a socket's path is short
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind("control.sock")
            server.listen(1)
            age(path)
            assert "control channel" in why_running(Path(), time.time())
        assert why_running(Path(), time.time()) == ""
    finally:
        os.chdir(before)


def test_where_no_process_can_be_seen_a_run_that_writes_is_not_moved(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(life_signs, "PROCESSES", tmp_path / "none")
    path = make_run("live", status=None)
    assert "changed less than 60 s ago" in why_running(path, time.time())
    assert why_running(path, time.time() + 61.0) == ""


def test_a_run_that_has_ended_is_moved_even_while_it_is_viewed(make_run: MakeRun) -> None:
    path = make_run("ended")
    with (path / "ticks.csv").open():
        assert why_running(path, time.time()) == ""


@pytest.mark.parametrize("text", ["first", "../runs/first", "./first"])
def test_a_run_is_named_by_its_name_or_path(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    path = make_run("first")
    monkeypatch.chdir(tmp_path / "runs")
    assert run_named(tmp_path / "runs", text) == "first"
    assert run_named(Path(), str(path)) == "first"


@pytest.mark.parametrize(
    "text", ["frist", "..", ".", "", "../outside", ".trash/20261126-120000/gone", "link", "folder"]
)
def test_what_is_no_run_of_the_folder_is_refused(make_run: MakeRun, tmp_path: Path, text: str) -> None:
    runs = tmp_path / "runs"
    for name in ("first", "../outside", "folder/within", "gone"):
        make_run(name)
    move_to_trash(runs, "gone", NOW)
    (runs / "link").symlink_to(tmp_path / "outside", target_is_directory=True)
    with pytest.raises(TrashError, match=r"no run of this name.*first" if text == "frist" else "no run of this name"):
        run_named(runs, text)


def test_a_trash_that_is_a_link_is_not_emptied(make_run: MakeRun, tmp_path: Path) -> None:
    other = make_run("../elsewhere")
    (tmp_path / "runs/.trash").symlink_to(other, target_is_directory=True)
    with pytest.raises(TrashError, match="link"):
        empty_trash(tmp_path / "runs")
    assert (other / "run.json").is_file()
