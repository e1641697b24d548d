"""`hil test`: scenarios with limits, a table of verdicts, a JUnit file, exit code 6."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.cli.cli_bench import CommandLine, assert_refused, scenario_text

GOOD = '[[accept]]\nname = "no trip"\nno_trip = true\n'
BAD = '[[accept]]\nname = "dry tanks"\nlevel_max_cm = 0.1\n'


def scenario(folder: Path, name: str, limits: str) -> Path:
    folder.mkdir(exist_ok=True)
    file = folder / f"{name}.toml"
    file.write_text(f"{scenario_text(duration='2.0', name=name)}{limits}")
    return file


def test_a_folder_of_scenarios_is_judged(tmp_path: Path, command_line: CommandLine) -> None:
    scenario(tmp_path / "mine", "good", GOOD)
    scenario(tmp_path / "mine", "bad", GOOD + BAD)
    scenario(tmp_path / "mine", "unlimited", "")
    junit = tmp_path / "out.xml"
    done = command_line("hil", "test", tmp_path / "mine", "--junit", junit, "--out", tmp_path / "runs")
    assert done.code == 6, done
    assert "good: passed" in done.out
    assert "bad: FAILED" in done.out
    assert "at most 0.1 cm" in done.out
    assert "1 of 2 scenarios passed" in done.out
    assert "unlimited.toml: no [[accept]] table, not run" in " ".join(done.out.split())
    assert (tmp_path / "runs" / "bad" / "kpi.json").is_file()
    root = ElementTree.parse(junit).getroot()  # noqa: S314 - written by the command above
    assert [(one.get("name"), one.get("tests"), one.get("failures")) for one in root.findall("testsuite")] == [
        ("bad", "2", "1"),
        ("good", "1", "0"),
    ]

    done = command_line("hil", "test", tmp_path / "mine" / "good.toml", "--out", tmp_path / "again")
    assert done.code == 0, done


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        ("", "[[accept]]"),
        ('[[accept]]\nname = "it"\niae_V_s = 1.0\nwindow = "fall"\n', "fall"),
        ('[[accept]]\nname = "it"\n', "accept"),
        (GOOD + GOOD, "repeat"),
    ],
)
def test_what_can_not_be_judged_is_refused_before_the_first_run(
    tmp_path: Path, command_line: CommandLine, limits: str, named: str
) -> None:
    scenario(tmp_path / "mine", "first", GOOD)
    file = scenario(tmp_path / "mine", "second", limits)
    done = command_line("hil", "test", tmp_path / "mine" / "first.toml", file, "--out", tmp_path / "runs")
    assert_refused(done, file, named)
    assert not (tmp_path / "runs").exists()


def test_a_scenario_without_an_end_is_refused(tmp_path: Path, command_line: CommandLine) -> None:
    """In simulated time nobody ends it: it ran for ever."""
    file = tmp_path / "endless.toml"
    text = scenario_text(duration='"open"', name="endless")
    file.write_text(f"{text}{GOOD}")
    assert_refused(command_line("hil", "test", file, "--out", tmp_path / "runs"), file, "open")


def test_an_empty_folder_and_two_of_one_name_are_refused(tmp_path: Path, command_line: CommandLine) -> None:
    (tmp_path / "empty").mkdir()
    assert_refused(command_line("hil", "test", tmp_path / "empty"), "empty", "no scenario")
    files = [scenario(tmp_path / folder, "same", GOOD) for folder in ("a", "b")]
    assert_refused(command_line("hil", "test", *files), "same")
