from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from hil.edge.record.manifest import ClockOffsets, versions
from hil.edge.record.record_errors import NoRunFolderError, RunFolderError, RunFolderExistsError
from hil.edge.record.run_folder import RunFolder
from tests.review import toy


def test_an_existing_folder_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    with pytest.raises(RunFolderExistsError, match="exists already") as caught:
        RunFolder.create(tmp_path / "mine", toy.plan())
    assert isinstance(caught.value, FileExistsError)
    assert "\n" not in str(caught.value)
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_an_existing_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("keep")
    with pytest.raises(FileExistsError):
        RunFolder.create(tmp_path / "mine", toy.plan())


def test_a_folder_that_cannot_be_made_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RunFolderError, match=r"run folder|exists already"):
        RunFolder.create(tmp_path / "file" / "run", toy.plan())


def test_a_folder_that_can_not_be_begun_is_not_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever ends it; Ctrl-C, too."""

    def interrupted(*_arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(RunFolder, "_write_manifest", interrupted)
    with pytest.raises(KeyboardInterrupt):
        RunFolder.create(tmp_path / "parent/run", toy.plan())
    assert list(tmp_path.iterdir()) == []


def test_the_zero_of_the_run_is_known_as_far_as_the_clocks_is() -> None:
    assert ClockOffsets(1000.25).with_run_zero(2.5).run_zero_epoch_s == 1002.75
    assert ClockOffsets(0.0).with_run_zero(2.5).run_zero_epoch_s == 2.5
    assert ClockOffsets().with_run_zero(2.5).run_zero_epoch_s is None


def test_manifest_comes_back_as_it_was_written(tmp_path: Path) -> None:
    started = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
    folder = RunFolder.create(tmp_path / "run", toy.plan(), started)
    manifest = RunFolder.open(folder.path).manifest()
    assert manifest.plan == toy.plan()
    assert (manifest.status, manifest.outcome) == ("running", "interrupted")
    assert manifest.started_utc == "2026-01-02T03:04:05.000+00:00"
    assert dict(manifest.versions) == versions()


def test_finish_replaces_the_status_and_leaves_no_other_file(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    folder.finish("tripped", "level of tank 1 above 19 cm", speed_x=3.5)
    manifest = folder.manifest()
    assert (manifest.status, manifest.reason, manifest.speed_x) == ("tripped", "level of tank 1 above 19 cm", 3.5)
    assert manifest.ended_utc is not None
    assert [path.name for path in folder.path.iterdir()] == ["run.json"]


def test_opening_something_else_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(NoRunFolderError, match=r"no run\.json"):
        RunFolder.open(tmp_path)


@pytest.mark.parametrize("text", ["", "{}", '{"format": 2}', "[1]"])
def test_a_damaged_manifest_is_a_clear_error(tmp_path: Path, text: str) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    folder.manifest_path.write_text(text)
    with pytest.raises(RunFolderError, match="not a run's manifest"):
        folder.manifest()


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("format", 0, "run.json has format 0, this program reads 1 and 2"),
        ("format", 3, "run.json has format 3, this program reads 1 and 2"),
        ("status", "asleep", "run.json has the unknown status 'asleep'"),
    ],
)
def test_a_manifest_that_is_whole_but_not_of_ours_is_refused_for_that(
    tmp_path: Path, key: str, value: object, why: str
) -> None:
    """The format was tried with a manifest that lacked everything else, too; the check of it could be removed."""
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    raw = json.loads(folder.manifest_path.read_text())
    folder.manifest_path.write_text(json.dumps({**raw, key: value}))
    with pytest.raises(RunFolderError, match=why):
        folder.manifest()


def test_run_json_has_its_fields_at_the_top(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    raw = json.loads(folder.manifest_path.read_text())
    assert {"status", "reason", "started_utc", "ended_utc", "versions", "seed", "scenario", "windows"} <= set(raw)
    assert {"period_s", "mode", "copies", "settings"} <= set(raw)
    assert raw["windows"][0] == {"name": "gain_fall", "from_s": 200.0, "to_s": 350.0}
