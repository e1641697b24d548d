"""The end of a run, whatever fails while it is closed: one line, a documented exit code, a folder that tells the truth.

A run on a disk that filled up used to end with a traceback of 51 lines and exit code 1; run.json said "running" and
temporary files were left.
"""

from __future__ import annotations

import json
import os
import pickle
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.bench import run_record
from hil.campaigns import campaign_report
from hil.campaigns.store import Store
from hil.cli import exit_codes
from hil.edge.record.new_folder import NewFolder
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.recorder import Recorder
from hil.edge.record.run_folder import RunFolder
from hil.review import run_report
from tests.campaign import campaign_bench
from tests.cli.cli_bench import BIN, CommandLine, Result, scenario_text
from tests.cli.failing_disk import FailingDisk

NOTHING_MOVED, INCOMPLETE = exit_codes.BAD_INPUT, exit_codes.INCOMPLETE
MORE = '[diagnosis]\nmethod = "none"\n\n[[window]]\nname = "all"\nfrom_s = 0.0\nto_s = 0.2\n'


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(scenario_text(duration="0.2", more="") + "\n" + MORE)
    return path


def assert_one_line(result: Result, folder: Path) -> None:
    """It names a file or folder of the run, and the cause."""
    assert re.fullmatch(r"hil: [^\n]+\n", result.err), result.err
    assert str(folder) in result.err
    assert "No space left on device" in result.err


def assert_no_debris(folder: Path) -> None:
    assert list(folder.rglob(".*")) == []


def assert_run_json_is_true(folder: Path, command_line: CommandLine) -> None:
    """It says how the run ended, or `hil report`, with room on the disk again, says that it doesn't."""
    manifest = json.loads((folder / "run.json").read_text())
    if manifest["status"] == "running":
        report = command_line("hil", "report", folder)
        assert (report.code, report.err) == (0, "")
        assert f"{folder}: unfinished" in report.out
    else:
        assert (manifest["status"], manifest["reason"]) == ("complete", "duration over")


def count_operations(command_line: CommandLine, root: Path, *arguments: str | Path | int) -> list[str]:
    disk = FailingDisk(root)
    with pytest.MonkeyPatch.context() as patch:
        disk.install(patch)
        assert command_line("hil", *arguments).code == 0
    return disk.operations


@pytest.mark.parametrize(
    "only_once", [pytest.param(False, id="stays full"), pytest.param(True, id="fails once", marks=pytest.mark.long)]
)
def test_a_disk_that_fills_at_any_write_of_a_run(
    command_line: CommandLine, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, only_once: bool
) -> None:
    """ENOSPC at every operation of a short run, one run for each. Those of the report are tried below."""
    monkeypatch.setattr(run_report, "render", lambda *_: "<html>")  # its figures take longer than all the rest
    root = tmp_path / "disk"
    root.mkdir()
    options = ("--no-rerun",)
    operations = count_operations(command_line, root, "simulate", scenario, "--out", root / "whole", *options)
    files = {operation.split()[1] for operation in operations}
    assert {"can.log", "sent.log", "ticks.csv", "events.jsonl", ".run.json.tmp", ".kpi.json.tmp"} <= files
    assert ".report.html.tmp" in files
    codes = []
    for number in range(1, len(operations) + 1):
        folder = root / f"run{number}"
        disk = FailingDisk(root, number, only_once=only_once)
        with pytest.MonkeyPatch.context() as patch:
            disk.install(patch)
            result = command_line("hil", "simulate", scenario, "--out", folder, *options)
        where = f"{number}: {operations[number - 1]}: {result}"
        assert_one_line(result, folder)
        codes.append(result.code)
        if result.code == NOTHING_MOVED:
            assert not folder.exists(), where
        else:
            assert result.code == INCOMPLETE, where
            assert_no_debris(folder)
            assert_run_json_is_true(folder, command_line)
    assert codes == sorted(codes), "refused while nothing has moved, incomplete from then on"
    assert set(codes) == {NOTHING_MOVED, INCOMPLETE}


@pytest.mark.long
def test_a_disk_that_fills_at_any_write_of_a_report(
    command_line: CommandLine, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_report, "render", lambda *_: "<html>")
    folder = tmp_path / "run"
    assert command_line("hil", "simulate", scenario, "--out", folder, "--no-rerun").code == 0
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    operations = count_operations(command_line, folder, "report", folder)
    assert len(operations) >= 6
    for number in range(1, len(operations) + 1):
        with pytest.MonkeyPatch.context() as patch:
            FailingDisk(folder, number).install(patch)
            result = command_line("hil", "report", folder)
        assert result.code == INCOMPLETE, result
        assert_one_line(result, folder)
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before, "the old ones stay"


@pytest.mark.long
def test_a_disk_that_fills_at_any_write_of_a_campaign(
    command_line: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rows that were written stay; started again with room on the disk, it goes on behind them."""
    pytest.importorskip("pyarrow")
    root = tmp_path / "disk"
    root.mkdir()
    (tmp_path / "short.toml").write_text(campaign_bench.SHORT.replace("12.0", "0.5").replace("4.05", "0.25"))
    arguments = ("campaign", tmp_path / "short.toml", "--seeds", 2, "--processes", 1)
    operations = count_operations(command_line, root, *arguments, "--out", root / "whole")
    files = {operation.split()[1] for operation in operations}
    assert {".campaign.json.tmp", "outcomes.jsonl", ".outcomes.parquet.tmp", ".report.html.tmp"} <= files
    monkeypatch.setattr(campaign_report, "render", lambda *_: "<html>")
    for number in range(1, len(operations) + 1):
        folder = root / f"campaign{number}"
        with pytest.MonkeyPatch.context() as patch:
            FailingDisk(root, number).install(patch)
            result = command_line("hil", *arguments, "--out", folder)
        assert_one_line(result, folder)
        is_started = number > sum("campaign.json" in operation for operation in operations)
        assert result.code == (INCOMPLETE if is_started else NOTHING_MOVED), (operations[number - 1], result)
        assert_no_debris(folder)
    again = command_line("hil", *arguments, "--out", folder)
    assert again.code == 0
    assert "Already there: 2 of 2 runs." in again.out


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 600 kB: enough to begin."""
    folder = tmp_path / "small"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=600k", "tmpfs", str(folder)]
    mount = shutil.which("mount")
    if mount is None or subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip("may not mount a tmpfs here")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def run_whole(*arguments: object, **options: Any) -> Result:
    command = [str(BIN / "hil"), *map(str, arguments)]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False, timeout=60.0, **options)
    return Result(done.returncode, done.stdout or "", done.stderr)


@pytest.mark.long
def test_a_real_disk_that_is_too_small(small_disk: Path, tmp_path: Path, command_line: CommandLine) -> None:
    """With Rerun, which writes by itself and used to say so in four lines of its own."""
    scenario = tmp_path / "long.toml"
    scenario.write_text(scenario_text(duration="120.0", more=""))
    folder = small_disk / "run"
    result = run_whole("simulate", scenario, "--out", folder, stdout=subprocess.PIPE)
    assert result.code == INCOMPLETE, result
    assert_one_line(result, folder)
    assert "the run: complete, duration over" in result.err
    assert_no_debris(small_disk)
    assert json.loads((folder / "run.json").read_text())["status"] in ("running", "complete")
    report = run_whole("report", folder, stdout=subprocess.PIPE)
    assert report.code == INCOMPLETE, report
    assert_one_line(report, folder)
    assert_no_debris(small_disk)
    copy = shutil.copytree(folder, tmp_path / "elsewhere")
    assert command_line("hil", "report", copy).code == 0, "what there is can be read"


@pytest.mark.parametrize(
    "free",
    [pytest.param(70_000, id="room for run.json", marks=pytest.mark.long), pytest.param(0, id="no room")],
)
def test_a_disk_that_is_full_at_the_start(small_disk: Path, scenario: Path, free: int) -> None:
    """Rerun, whose writer a full disk had ended, used to wait for it for ever: at the start, and at the exit.

    Later the line said only that Rerun had not answered, and the empty folders above the run's were left.
    """
    (small_disk / "filler").write_bytes(bytes(600 * 1024 - free))
    folder = small_disk / "new" / "folders" / "run"
    result = run_whole("simulate", scenario, "--out", folder, stdout=subprocess.PIPE)
    assert result.code == NOTHING_MOVED, result
    assert_one_line(result, folder)
    assert [path.name for path in small_disk.iterdir()] == ["filler"]


def test_what_a_full_disk_leaves_of_the_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folders made for a record go, those of others stay; campaigns, too."""
    mine = tmp_path / "empty"
    mine.mkdir()
    with pytest.raises(FileExistsError):
        NewFolder.make(mine)
    assert mine.is_dir(), "an empty folder of the user's is not ours"
    new = NewFolder.make(mine / "a" / "b" / "run")
    (mine / "a" / "note.txt").write_text("of another program")
    new.remove()
    assert [path.name for path in (mine / "a").iterdir()] == ["note.txt"]
    FailingDisk(tmp_path, 1).install(monkeypatch)
    with pytest.raises(RunFolderError, match=r"campaign\.json can't be written: No space left on device"):
        Store.open(tmp_path / "c" / "d", {"name": "any"})
    assert not (tmp_path / "c").exists()


@pytest.mark.long
def test_no_file_may_grow_beyond_a_limit(tmp_path: Path) -> None:
    """The same where no file system can be mounted: EFBIG instead of ENOSPC, by RLIMIT_FSIZE."""
    scenario = tmp_path / "long.toml"
    scenario.write_text(scenario_text(duration="200.0", more=""))
    folder = tmp_path / "run"
    command = f"ulimit -f 900; exec {BIN / 'hil'} simulate {scenario} --out {folder}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=60.0)
    assert done.returncode == INCOMPLETE, done
    assert re.fullmatch(rf"hil: {folder}[^\n]+ File too large[^\n]+\n", done.stderr), done.stderr
    manifest = json.loads((folder / "run.json").read_text())
    assert (manifest["status"], manifest["reason"]) == ("complete", "duration over")
    assert any(error.startswith("can.log") for error in manifest["recorder"]["errors"])
    assert_no_debris(folder)


@pytest.mark.parametrize("command", [pytest.param("simulate", marks=pytest.mark.long), "design", "--help"])
def test_standard_output_on_a_full_device(scenario: Path, tmp_path: Path, command: str) -> None:
    """It used to be a traceback, and with it a run without a report."""
    folder = tmp_path / "run"
    arguments = ("simulate", scenario, "--out", folder, "--no-rerun") if command == "simulate" else (command,)
    with Path("/dev/full").open("w") as full:
        result = run_whole(*arguments, stdout=full)
    assert (result.code, result.err) == (INCOMPLETE, "hil: standard output: No space left on device\n")
    if command == "simulate":
        assert json.loads((folder / "run.json").read_text())["status"] == "complete"
        assert {"kpi.json", "report.html"} <= {path.name for path in folder.iterdir()}


@pytest.mark.long
def test_a_pipe_that_is_closed(scenario: Path, tmp_path: Path) -> None:
    """`hil simulate ... | head -1`: the run and its record are complete."""
    folder, line = tmp_path / "run", tmp_path / "stderr"
    command = f"{BIN / 'hil'} simulate {scenario} --out {folder} --no-rerun 2>{line} | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=60.0)
    assert (done.returncode, line.read_text()) == (INCOMPLETE, "hil: standard output: Broken pipe\n")
    assert (folder / "report.html").exists()
    assert json.loads((folder / "run.json").read_text())["status"] == "complete"


@pytest.mark.long
def test_both_outputs_on_a_full_device(scenario: Path, tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        command = [str(BIN / "hil"), "simulate", str(scenario), "--out", str(tmp_path / "run"), "--no-rerun"]
        assert subprocess.run(command, stdout=full, stderr=full, check=False, timeout=60.0).returncode == INCOMPLETE


def test_a_folder_that_is_removed_during_the_run(
    command_line: CommandLine, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, real = tmp_path / "run", Recorder.tick

    def remove(recorder: Recorder, *arguments: Any, **options: Any) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        real(recorder, *arguments, **options)

    monkeypatch.setattr(Recorder, "tick", remove)
    result = command_line("hil", "simulate", scenario, "--out", folder, "--no-rerun")
    assert result.code == INCOMPLETE, result
    assert re.fullmatch(rf"hil: {folder}: the record is incomplete: run\.json[^\n]+ duration over\n", result.err)
    assert not folder.exists()


def test_a_folder_that_is_removed_before_its_report_is_written(
    command_line: CommandLine, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A traceback, since the key figures had been there; and without one the exit code would say that nothing moved."""
    folder, real = tmp_path / "run", run_report.write_report

    def remove(run: RunFolder) -> Path:
        shutil.rmtree(folder)
        return real(run)

    monkeypatch.setattr(run_report, "write_report", remove)
    result = command_line("hil", "simulate", scenario, "--out", folder, "--no-rerun")
    assert result.code == INCOMPLETE, result
    assert re.fullmatch(rf"hil: {folder}: the record is incomplete: [^\n]+ duration over\n", result.err)


def test_a_stop_while_the_record_is_closed_waits_for_that(
    command_line: CommandLine, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C during the last writes used to leave run.json saying that the run went on."""
    folder, real = tmp_path / "run", Recorder.close

    def interrupted(recorder: Recorder, *arguments: Any, **options: Any) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        real(recorder, *arguments, **options)

    monkeypatch.setattr(Recorder, "close", interrupted)
    result = command_line("hil", "simulate", scenario, "--out", folder, "--no-rerun")
    assert (result.code, result.err) == (130, "hil: interrupted\n")
    assert json.loads((folder / "run.json").read_text())["status"] == "complete"
    assert_no_debris(folder)


def test_a_second_stop_does_not_wait(
    command_line: CommandLine, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that no longer answers must not hold the program for ever; the folder is then unfinished."""

    def stuck(*_: object, **__: object) -> None:
        for _number in (1, 2):
            os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("the second one was not taken")

    monkeypatch.setattr(Recorder, "close", stuck)
    folder = tmp_path / "run"
    result = command_line("hil", "simulate", scenario, "--out", folder, "--no-rerun")
    assert (result.code, result.err) == (130, "hil: interrupted\n")
    assert f"{folder}: unfinished" in command_line("hil", "report", folder).out


def test_a_run_that_tripped_keeps_its_exit_code(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    error = run_record.incomplete(folder, "tripped", "high_level", ["can.log: full", "ticks.csv: full"])
    assert str(error) == (
        f"{folder.path}: the record is incomplete: can.log: full (and 1 more); the run: tripped, high_level"
    )
    handed_on = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own; hil demo's runs are other processes
    assert (str(handed_on), handed_on.status) == (str(error), "tripped")
    assert exit_codes.of_run(error.status, error.reason, is_incomplete=True) == 3
    assert exit_codes.of_run("stopped", "SIGTERM", is_incomplete=True) == 143
    assert exit_codes.of_run("complete", "duration over", is_incomplete=True) == 5
