"""`hil compare` as a user types it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.cli_bench import CommandLine, assert_refused
from tests.review import toy


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs a and b, and one that was killed before its first step."""
    folder = tmp_path_factory.mktemp("runs")
    for name, reconfigure in (("a", True), ("b", False), ("killed", True)):
        toy.record_run(folder / name, until_s=203.0, period_s=1.0, reconfigure=reconfigure)
    ticks = folder / "killed/ticks.csv"
    ticks.write_text(ticks.read_text().partition("\n")[0] + "\n")
    return folder


def test_the_tables(command_line: CommandLine, recorded: Path) -> None:
    result = command_line("hil", "compare", recorded, "--align", "200", "--no-report")
    assert result.code == 0
    assert result.err == "hil: killed: no control step was recorded: it is in the tables only\n"
    assert result.out.startswith("3 runs, aligned at 200 s of each run\n")
    assert result.out.index("Nothing differs") < result.out.index("Key figures")
    assert any(line.split()[:3] == ["alarms", "2", "0"] for line in result.out.splitlines())


@pytest.mark.long
def test_the_report(command_line: CommandLine, recorded: Path, tmp_path: Path) -> None:
    result = command_line("hil", "compare", recorded, "--align", "200", "--out", "out")
    assert result.out.endswith("out/report.html\n")
    page = (tmp_path / "out/report.html").read_text()
    assert page.index("What differs") < page.index("Key figures") < page.index("Alarms and trips") < page.index("<svg")
    assert page.count("<svg") == 12
    output = page[page.index('aria-label="Output 1"') : page.index("</svg>")]
    assert all(f"stroke: {color}" in output for color in ("#1f6fb2", "#cc5a24"))
    assert "killed: no control step" in page
    written = json.loads((tmp_path / "out/compare.json").read_text())
    assert [run["aligned_at_s"] for run in written["runs"]] == [200.0, 200.0, 0.0]


def test_json_alone(command_line: CommandLine, recorded: Path, tmp_path: Path) -> None:
    result = command_line("hil", "compare", recorded / "a", recorded / "b", "--json", "--no-report")
    found = json.loads(result.out)
    assert [run["name"] for run in found["runs"]] == ["a", "b"]
    assert next(row for row in found["figures"] if row["key"] == "alarms")["ratios"] == [1.0, 0.0]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["a"], "two or more"),
        (["a", "none"], "none is not a run folder"),
        (["a", "b", "--align", "trip"], "--align trip"),
    ],
)
def test_what_can_not_be_compared_is_one_line(
    command_line: CommandLine, recorded: Path, arguments: list[str], said: str
) -> None:
    named = [recorded / one if one in ("a", "b", "none") else one for one in arguments]
    assert_refused(command_line("hil", "compare", *named), said)
