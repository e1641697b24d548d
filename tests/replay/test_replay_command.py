"""`hil replay` on the terminal: what it says, and its exit codes."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path

import pytest
from rich.console import Console

from hil.cli import exit_codes, replay_command
from hil.replay.replay_run import ReplayOptions


@pytest.fixture(scope="module")
def begun(recorded_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first fifth of the record, which has no alarm."""
    run = shutil.copytree(recorded_run, tmp_path_factory.mktemp("begun") / "run")
    text = (run / "can.log").read_text()
    (run / "can.log").write_text(text[: len(text) // 5])
    return run


def shown(run: Path, *, update: bool = False, as_json: bool = False, figure: Path | None = None) -> tuple[int, str]:
    console = Console(file=io.StringIO(), width=100)
    code = replay_command.run(console, run, ReplayOptions(update=update), as_json=as_json, figure=figure)
    assert isinstance(console.file, io.StringIO)
    return code, console.file.getvalue()


def test_the_same_is_0_and_a_difference_6(begun: Path, tmp_path: Path) -> None:
    """The first line is the verdict, also as JSON; a new reference is 0; the page is where it was asked for."""
    code, text = shown(begun, figure=tmp_path / "page.html")
    assert (code, text.split(":")[0]) == (0, "same commands as recorded")
    assert (tmp_path / "page.html").read_text().startswith("<!DOCTYPE html>")
    code, text = shown(begun, update=True)
    assert code == 0
    assert f"new reference: {begun / 'reference.json'}" in text
    reference = json.loads((begun / "reference.json").read_text())
    reference["commands"][20][1] += 0.3
    (begun / "reference.json").write_text(json.dumps(reference))
    code, text = shown(begun, as_json=True)
    result = json.loads(text)
    assert code == exit_codes.DIFFERS == 6
    assert result["is_same"] is False
    assert (result["commands"]["first"]["step"], result["commands"]["first"]["signal"]) == (20, "Command2")
    assert result["reference"]
