"""`hil runs` as a user types it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.edge.record.run_folder import RunFolder
from tests.cli.cli_bench import CommandLine, assert_refused
from tests.review import toy
from tests.run_index.conftest import FIGURES


@pytest.fixture
def three_runs(tmp_path: Path) -> Path:
    """Two whole runs and a killed one, in runs/."""
    for name, status in (("one", "complete"), ("two", "tripped"), ("nested/killed", None)):
        folder = RunFolder.create(tmp_path / "runs" / name, toy.plan())
        if status is not None:
            folder.finish("complete" if status == "complete" else "tripped", "end")
            folder.kpi_path.write_text(json.dumps(FIGURES))
    return tmp_path / "runs"


@pytest.mark.usefixtures("three_runs")
def test_the_table_has_a_row_for_each_run_and_a_total(command_line: CommandLine) -> None:
    result = command_line("hil", "runs")
    assert result.code == 0
    for name, status in (("one", "complete"), ("two", "tripped"), ("nested/killed", "interrupted")):
        (line,) = [line for line in result.out.splitlines() if line.strip().startswith(f"{name} ")]
        assert status in line
    assert "6.5, 6.75" in result.out, "sum of the windows' IAE"
    assert "3 runs" in result.out
    assert "nested/killed: no kpi.json: `hil report` makes it" in result.out


@pytest.mark.usefixtures("three_runs")
def test_a_narrow_terminal_gets_lines(command_line: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("FORCE_COLOR", "1")
    out = command_line("hil", "runs").out
    assert "status tripped" in out
    assert "─" not in out


@pytest.mark.usefixtures("three_runs")
def test_json_has_what_the_table_leaves_out(command_line: CommandLine) -> None:
    found = json.loads(
        command_line("hil", "runs", "--json", "--where", "iae.gain_fall[0] < 1", "--sort", "-started_utc").out
    )
    assert [run["name"] for run in found["runs"]] == ["two", "one"]
    assert found["runs"][0]["figures"] == FIGURES
    assert found["all_runs"] == 3
    assert found["all_size_bytes"] > sum(run["size_bytes"] for run in found["runs"])


@pytest.mark.usefixtures("three_runs")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--where", "statsu == 1"], "--where statsu: no run here has this; did you mean status"),
        (["--sort", "sice"], "--sort sice"),
        (["nothing"], "nothing: there is no such folder"),
        (["--trash", "on"], "did you mean one"),
        (["--trash", "one"], "--yes"),
        (["--trash", "one", "--json"], "--json"),
        (["--trash", "nested/killed", "--yes"], "still runs"),
    ],
)
def test_what_can_not_be_done_is_one_line(command_line: CommandLine, arguments: list[str], said: str) -> None:
    assert_refused(command_line("hil", "runs", *arguments), said)


def test_trash_and_empty_trash(command_line: CommandLine, three_runs: Path) -> None:
    assert "the trash is empty" in command_line("hil", "runs", "--empty-trash").out
    result = command_line("hil", "runs", "--trash", "one", "--trash", "runs/two", "--yes")
    assert result.code == 0
    assert not (three_runs / "one").exists()
    assert not (three_runs / "two").exists()
    assert "in the trash: 2 runs" in command_line("hil", "runs").out
    assert "2 runs" in command_line("hil", "runs", "--empty-trash", "--yes").out
    assert not (three_runs / ".trash").exists()


@pytest.mark.parametrize(("answer", "code"), [(True, 0), (False, 4)])
def test_the_trash_asks(
    command_line: CommandLine, three_runs: Path, monkeypatch: pytest.MonkeyPatch, answer: bool, code: int
) -> None:
    asked: list[str] = []

    def confirm(question: str) -> bool:
        asked.append(question)
        return answer

    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("typer.confirm", confirm)
    result = command_line("hil", "runs", "--trash", "one")
    assert result.code == code
    assert len(asked) == 1
    assert "runs/one" in asked[0]
    assert (three_runs / "one").exists() is not answer
