"""What can't be exported is an error of one line, and leaves nothing behind; a killed run can be."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from hil.cli.app import app
from hil.edge.record.record_errors import IncompleteRecordError, NoRunFolderError, RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.export import columnar_files
from hil.export.formats import FORMATS, compress_logs, export_run


@pytest.fixture
def killed(bench_run: RunFolder, tmp_path: Path) -> Path:
    """As a run is left that was killed: no end in run.json, half lines at the ends of all files."""
    run = tmp_path / "killed"
    shutil.copytree(bench_run.path, run)
    manifest = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**manifest, "status": "running", "ended_utc": None}))
    for name, most in (("can.log", 20_003), ("sent.log", 1_003), ("ticks.csv", 20_003), ("events.jsonl", 150)):
        (run / name).write_bytes((run / name).read_bytes()[:most])
        os.utime(run / name, (1e9, 1e9))
    return run


@pytest.mark.parametrize("to", list(FORMATS))
def test_a_killed_run_is_exported_without_its_half_lines(killed: Path, tmp_path: Path, to: str) -> None:
    out = export_run(killed, to)
    assert out == tmp_path / f"killed{FORMATS[to].suffix}"
    if to == "candump":
        assert out.read_bytes() == (killed / "can.log").read_bytes().rpartition(b"\n")[0] + b"\n"
    if to == "parquet":
        assert len(pd.read_parquet(out / "ticks.parquet")) == (killed / "ticks.csv").read_bytes().count(b"\n") - 1
        assert pd.read_parquet(out / "ticks.parquet").attrs["status"] == "interrupted"


@pytest.mark.parametrize("to", list(FORMATS))
def test_a_run_killed_before_its_first_step_is_exported(killed: Path, tmp_path: Path, to: str) -> None:
    manifest = json.loads((killed / "run.json").read_text())
    manifest["clock"]["run_zero_epoch_s"] = None
    (killed / "run.json").write_text(json.dumps(manifest))
    (killed / "ticks.csv").write_text((killed / "ticks.csv").read_text().partition("\n")[0] + "\n")
    (killed / "events.jsonl").write_text("")
    (killed / "sent.log").write_text("")
    out = export_run(killed, to, tmp_path / "out")
    if to == "parquet":
        assert pd.read_parquet(out / "frames.parquet")["t_s"].isna().all()


def test_a_record_of_format_1_keeps_who_sent_a_frame(tmp_path: Path) -> None:
    """All of its frames counted as received: it has marks in can.log, and no sent.log."""
    stored = Path(__file__).parents[1] / "review" / "format1" / "live"
    lines = (stored / "can.log").read_text().splitlines()
    frames = pd.read_parquet(export_run(stored, "parquet", tmp_path / "out") / "frames.parquet")
    assert frames["is_sent"].tolist() == [line.endswith(" T") for line in lines]
    assert frames["is_sent"].any()
    plain = export_run(stored, "candump", tmp_path / "can.log").read_text().splitlines()
    assert plain == [line[:-2] for line in lines], "Wireshark reads no line with a mark"


def test_what_exists_is_not_overwritten(bench_run: RunFolder, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(
        RunFolderError, match="taken exists already; an export never overwrites, name another with --out"
    ):
        export_run(bench_run.path, "mat", tmp_path / "taken")
    assert (tmp_path / "taken").read_text() == "mine"
    with pytest.raises(RunFolderError, match=r"there is no folder .*nowhere"):
        export_run(bench_run.path, "mat", tmp_path / "nowhere" / "run.mat")


def test_a_folder_without_run_json_is_none(tmp_path: Path) -> None:
    with pytest.raises(NoRunFolderError, match=r"is not a run folder: it has no run\.json"):
        export_run(tmp_path, "csv")


@pytest.mark.parametrize("to", ["mf4", "mcap"])
def test_a_missing_library_is_named_with_its_extra(
    bench_run: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(RunFolderError, match=rf"pip install 'fourtank-hil\[{to}\]'"):
        export_run(bench_run.path, to, tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_written_leaves_nothing(
    bench_run: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(columnar_files, "binary_values", full)
    with pytest.raises(IncompleteRecordError, match="out can't be written: No space left on device"):
        export_run(bench_run.path, "parquet", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_a_damaged_log_is_named_with_its_line(killed: Path, tmp_path: Path) -> None:
    lines = (killed / "can.log").read_text().splitlines(keepends=True)
    (killed / "can.log").write_text("".join([*lines[:9], "(1.000000) can0 20\n", *lines[9:]]))
    os.utime(killed / "can.log", (1e9, 1e9))
    for to in ("csv", "candump"):
        with pytest.raises(RunFolderError, match=r"can\.log, line 10 is not a frame"):
            export_run(killed, to, tmp_path / "out")
    with pytest.raises(RunFolderError, match=r"can\.log, line 10 is not a frame"):
        compress_logs(killed, "zst")
    assert (killed / "can.log").exists()
    assert not [path for path in killed.iterdir() if path.name.startswith(".")]


def test_logs_of_a_run_that_may_go_on_are_not_compressed(killed: Path) -> None:
    os.utime(killed / "can.log")
    with pytest.raises(RunFolderError, match="the run goes on; compress its logs after its end"):
        compress_logs(killed, "zst")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "xlsx"], "--to xlsx is not a format: parquet, csv, mf4"),
        (["--to", "mat", "--compress", "gz"], "--compress is for --to candump"),
        (["--to", "candump", "--compress", "xz"], "--compress xz is not a compression: zst, gz"),
        (["--to", "candump", "--in-place"], "--in-place needs --compress: zst, gz"),
        (["--to", "mat", "--in-place"], "--in-place is for --to candump without --out"),
    ],
)
def test_options_that_do_not_fit_are_refused(bench_run: RunFolder, options: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["export", str(bench_run.path), *options])
    assert isinstance(result.exception, RunFolderError)
    assert message in str(result.exception)


def test_the_command_names_what_it_wrote(bench_run: RunFolder, tmp_path: Path) -> None:
    out = tmp_path / "frames.log.zst"
    result = CliRunner().invoke(
        app, ["export", str(bench_run.path), "--to", "candump", "--compress", "zst", "--out", str(out)]
    )
    assert (result.exit_code, result.stdout.replace("\n", "")) == (0, str(out))
    assert out.stat().st_size > 1000


def test_help_and_docs_name_every_format() -> None:
    page = (Path(__file__).parents[2] / "docs/how-to/export.md").read_text(encoding="utf-8")
    shown = CliRunner().invoke(app, ["export", "--help"], env={"COLUMNS": "200"}).stdout
    for name, chosen in FORMATS.items():
        assert name in shown
        assert f"| `{name}` | {chosen.content} | {chosen.opened_by} |" in page


def test_the_table_of_formats_needs_no_library_of_a_format() -> None:
    """The help and every command would wait for them."""
    heavy = ("asammdf", "mcap", "pandas", "pyarrow", "scipy.io")
    code = f"import hil.export.formats, sys; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60.0)
    assert done.stdout.strip() == "[]"
