"""The index of run folders: it says what the folders say, whatever happens to it."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import pytest

from hil.edge.record.record_errors import NoRunFolderError
from hil.run_index.index_file import INDEX_NAME, index_of
from hil.run_index.indexed_run import NOT_READABLE, IndexedRun
from tests.run_index.conftest import FIGURES, MakeRun


def test_a_row_says_what_the_folder_says(make_run: MakeRun, tmp_path: Path) -> None:
    path = make_run("first", seed=7)
    (row,) = index_of(tmp_path / "runs")
    assert (row.name, row.scenario, row.status, row.mode, row.seed) == ("first", "toy", "complete", "lockstep", 7)
    assert (row.rig, row.law, row.design, row.detector) == ("bench2", "state_feedback", "lqr", "glr")
    assert (row.duration_s, row.period_s, row.alarms, row.trips) == (500.0, 0.1, 1, 0)
    assert row.started_utc.startswith("2026-11-20T08:00")
    assert row.figures == FIGURES
    assert row.size_bytes == sum(file.stat().st_size for file in path.iterdir())
    assert row.problem == ""
    json.dumps(row.as_dict(), allow_nan=False)


def test_a_run_without_key_figures_and_a_killed_run_are_rows(make_run: MakeRun, tmp_path: Path) -> None:
    make_run("killed", status=None, figures=None)
    (row,) = index_of(tmp_path / "runs")
    assert (row.status, row.alarms, row.duration_s) == ("interrupted", None, None)
    assert "hil report" in row.problem


@pytest.mark.parametrize(
    ("ended", "expected"), [("2026-11-20T08:01:00+00:00", 60.0), ("2026-11-20T06:01:00+00:00", None)]
)
def test_a_wall_clock_that_was_set_back_makes_no_negative_duration(
    make_run: MakeRun, tmp_path: Path, ended: str, expected: float | None
) -> None:
    """Of a live run without key figures, whose duration is only known from its beginning and end."""
    manifest = make_run("set_back", figures=None) / "run.json"
    raw = json.loads(manifest.read_text())
    manifest.write_text(json.dumps(raw | {"mode": "live", "ended_utc": ended}))
    (row,) = index_of(tmp_path / "runs")
    assert row.duration_s == expected


def test_runs_within_folders_are_found_but_not_those_that_are_hidden_or_too_deep(
    make_run: MakeRun, tmp_path: Path
) -> None:
    for name in ("plain", "campaign/phases/01_fill", ".trash/gone", "a/b/c/d/e/f/deep", "plain/inside"):
        make_run(name)
    (tmp_path / "runs/link").symlink_to(tmp_path / "runs/campaign", target_is_directory=True)
    assert [row.name for row in index_of(tmp_path / "runs")] == ["plain", "campaign/phases/01_fill"]
    assert [row.name for row in index_of(tmp_path / "runs", 0)] == []


def test_a_run_folder_itself_is_one_row(make_run: MakeRun) -> None:
    assert [row.name for row in index_of(make_run("one"))] == ["."]


def test_only_new_and_changed_folders_are_read_again(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = tmp_path / "runs"
    make_run("first")
    second = make_run("second")
    before = index_of(runs)
    read: list[str] = []
    of = IndexedRun.of

    def counted(path: Path, name: str, size_bytes: int) -> IndexedRun:
        read.append(name)
        return of(path, name, size_bytes)

    monkeypatch.setattr(IndexedRun, "of", counted)
    assert index_of(runs) == before
    assert read == []
    (second / "kpi.json").write_text(json.dumps(FIGURES | {"skipped": 3}))
    make_run("third")
    rows = {row.name: row for row in index_of(runs)}
    assert sorted(read) == ["second", "third"]
    assert rows["second"].figures["skipped"] == 3
    (second / "run.json").unlink()
    assert [row.name for row in index_of(runs)] == ["first", "third"]


@pytest.mark.parametrize(
    "damage", [b"", b"no database", b"SQLite format 3\x00" + bytes(200)], ids=["empty", "text", "cut"]
)
def test_a_damaged_index_is_built_again(make_run: MakeRun, tmp_path: Path, damage: bytes) -> None:
    make_run("first")
    before = index_of(tmp_path / "runs")
    (tmp_path / "runs" / INDEX_NAME).write_bytes(damage)
    assert index_of(tmp_path / "runs") == before
    assert (tmp_path / "runs" / INDEX_NAME).read_bytes() != damage


@pytest.mark.parametrize("statement", ["UPDATE runs SET fields = '[1]'", "DROP TABLE runs", "PRAGMA user_version = 99"])
def test_an_index_with_foreign_content_is_built_again(make_run: MakeRun, tmp_path: Path, statement: str) -> None:
    make_run("first")
    before = index_of(tmp_path / "runs")
    connection = sqlite3.connect(tmp_path / "runs" / INDEX_NAME)
    with connection:
        connection.execute(statement)
    connection.close()
    assert index_of(tmp_path / "runs") == before


def test_a_folder_that_can_not_be_written_has_no_index(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_run("first")

    def refuse(*_: object, **__: object) -> sqlite3.Connection:
        raise sqlite3.OperationalError("unable to open database file")

    monkeypatch.setattr("sqlite3.connect", refuse)
    assert [row.name for row in index_of(tmp_path / "runs")] == ["first"]
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == ["first"]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": 9}', "\udcff"])
def test_a_run_that_can_not_be_read_is_a_row_that_says_so(make_run: MakeRun, tmp_path: Path, text: str) -> None:
    path = make_run("first")
    (path / "run.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    (row,) = index_of(tmp_path / "runs")
    assert row.status == NOT_READABLE
    assert row.problem


def test_no_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(NoRunFolderError, match="no such folder"):
        index_of(tmp_path / "nothing")


def test_a_run_that_goes_on_is_running_while_its_files_are_open(make_run: MakeRun, tmp_path: Path) -> None:
    """It used to be shown as interrupted. The index does not keep it: no file changes when a process is killed."""
    path = make_run("live", status=None)
    with (path / "ticks.csv").open("a"):
        assert [row.status for row in index_of(tmp_path / "runs")] == ["running"]
    assert [row.status for row in index_of(tmp_path / "runs")] == ["interrupted"]
