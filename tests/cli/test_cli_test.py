"""`hil test`: scenarios with limits, a table of verdicts, a JUnit file, exit code 6."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.bench.acceptance_run import AcceptanceRun
from hil.cli import test_command
from hil.review.judged_scenario import JudgedScenario
from tests.cli.cli_bench import CommandLine, assert_refused, config_copy, scenario_text
from tests.review.junit_file import checked

GOOD = '[[accept]]\nname = "no trip"\nno_trip = true\n'
BAD = '[[accept]]\nname = "dry tanks"\nlevel_max_cm = 0.1\n'


def scenario(folder: Path, name: str, limits: str) -> Path:
    folder.mkdir(exist_ok=True)
    file = folder / f"{name}.toml"
    file.write_text(f"{scenario_text(duration='2.0', name=name)}{limits}")
    return file


def suites(junit: Path) -> list[tuple[str | None, ...]]:
    root = checked(junit.read_bytes())
    return [tuple(one.get(key) for key in ("name", "tests", "failures", "errors", "skipped")) for one in root]


def test_a_folder_of_scenarios_is_judged(tmp_path: Path, command_line: CommandLine) -> None:
    scenario(tmp_path / "mine", "good", GOOD)
    scenario(tmp_path / "mine", "bad", GOOD + BAD)
    scenario(tmp_path / "mine", "unlimited", "")
    junit = tmp_path / "out.xml"
    files = ("--junit", junit, "--out", tmp_path / "runs")
    done = command_line("hil", "test", tmp_path / "mine", "--processes", "1", *files)
    assert done.code == 6, done
    assert "good: passed" in done.out
    assert "bad: FAILED" in done.out
    assert "at most 0.1 cm" in done.out
    assert "1 of 2 scenarios passed" in done.out
    assert "unlimited: no [[accept]] table, not run" in " ".join(done.out.split())
    assert (tmp_path / "runs" / "bad" / "kpi.json").is_file()
    assert suites(junit) == [
        ("bad", "2", "1", "0", "0"),
        ("good", "1", "0", "0", "0"),
        ("unlimited", "1", "0", "0", "1"),
    ]

    done = command_line("hil", "test", tmp_path / "mine" / "good.toml", "--out", tmp_path / "again")
    assert done.code == 0, done
    done = command_line("hil", "test", tmp_path / "mine" / "good.toml", "--out", tmp_path / "again", "--junit", junit)
    assert done.code == 6, "the folder is there: the run can't be recorded"
    assert suites(junit) == [("good", "1", "0", "1", "0")]


@pytest.mark.long
def test_runs_beside_each_other_are_shown_in_the_order_of_their_files(
    tmp_path: Path, command_line: CommandLine
) -> None:
    """The first is the slowest."""
    first = scenario(tmp_path / "mine", "first", GOOD)
    first.write_text(first.read_text().replace("2.0", "60.0"))
    for name in ("second", "third"):
        scenario(tmp_path / "mine", name, BAD)
    junit = tmp_path / "out.xml"
    html = tmp_path / "out.html"
    files = ("--junit", junit, "--html", html, "--out", tmp_path / "runs")
    done = command_line("hil", "test", tmp_path / "mine", "--processes", "2", *files)
    assert done.code == 6, done
    assert [one[0] for one in suites(junit)] == ["first", "second", "third"]
    places = [done.out.index(text) for text in ("first: passed", "second: FAILED", "third: FAILED")]
    assert places == sorted(places)
    assert 'href="runs/second/report.html"' in html.read_text()
    assert (tmp_path / "runs" / "second" / "report.html").is_file()


def test_a_run_that_does_not_go_to_its_end_is_an_error_unless_a_limit_expects_it(
    tmp_path: Path, command_line: CommandLine
) -> None:
    """A run that tripped at once kept every upper limit, and passed."""
    trip = '[[fault]]\nat_s = 0.5\nkind = "node_reboot"\ntarget = "pump"\n'
    low = '[[accept]]\nname = "low"\nlevel_max_cm = 19.0\n'
    scenario(tmp_path / "mine", "expected", f'{trip}{low}[[accept]]\nname = "it"\ntrip = "node_rebooted"\n')
    scenario(tmp_path / "mine", "surprise", trip + low)
    files = ("--junit", tmp_path / "out.xml", "--out", tmp_path / "runs")
    done = command_line("hil", "test", tmp_path / "mine", "--processes", "1", *files)
    assert done.code == 6, done
    assert suites(tmp_path / "out.xml") == [("expected", "2", "0", "0", "0"), ("surprise", "2", "0", "1", "0")]
    assert "surprise: the run did not go to its end: tripped" in done.out


@pytest.fixture
def _hangup_ends() -> Iterator[None]:
    """A SIGHUP that was ignored when the tests began, as below nohup, would end nothing."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("_hangup_ends")
@pytest.mark.parametrize(
    ("number", "code", "said"),
    [
        (signal.SIGINT, 130, "interrupted"),
        (signal.SIGTERM, 143, "stopped by SIGTERM"),
        (signal.SIGHUP, 129, "stopped by SIGHUP"),
    ],
)
def test_a_test_that_is_interrupted_keeps_the_verdicts_of_the_runs_made(
    tmp_path: Path,
    command_line: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
    code: int,
    said: str,
) -> None:
    """SIGTERM, by which a job of continuous integration is ended, left no JUnit file."""
    for name in ("a", "b", "c"):
        scenario(tmp_path / "mine", name, GOOD)
    made: list[str] = []

    def judge(asked: AcceptanceRun, _bench: object) -> JudgedScenario:
        made.append(asked.out.name)
        if len(made) == 2:
            signal.raise_signal(number)
        return JudgedScenario(asked.out.name)

    monkeypatch.setattr(test_command, "judge_in_lockstep", judge)
    junit = tmp_path / "out.xml"
    done = command_line("hil", "test", tmp_path / "mine", "--processes", "1", "--junit", junit)
    assert (done.code, done.err) == (code, f"hil: {said}\n"), done
    assert [(one[0], one[4]) for one in suites(junit)] == [("a", "0"), ("b", "1"), ("c", "1")]
    assert "1 of 1 scenarios passed, 2 not run" in done.out


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("-i", "slcan", "--processes", "2"), "--processes"),
        (("-c", "can0", "--seed", "2"), "--seed"),
        (("--clear-trip",), "--clear-trip"),
        (("--junit", "nowhere/out.xml"), "nowhere/out.xml"),
        (("--html", "."), "a folder"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    tmp_path: Path, command_line: CommandLine, options: tuple[str, ...], named: str
) -> None:
    file = scenario(tmp_path / "mine", "good", GOOD)
    assert_refused(command_line("hil", "test", file, "--out", tmp_path / "runs", *options), named)
    assert not (tmp_path / "runs").exists()


def test_without_a_path_the_scenarios_of_the_configuration_run(tmp_path: Path, command_line: CommandLine) -> None:
    config = config_copy(tmp_path / "config")
    for file in (config / "scenarios").iterdir():
        file.unlink()
    scenario(config / "scenarios", "good", GOOD)
    done = command_line("hil", "test", "--config", config, "--out", tmp_path / "runs")
    assert done.code == 0, done
    assert "good: passed" in done.out


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        ("", "[[accept]]"),
        ('[[accept]]\nname = "it"\niae_V_s = 1.0\nwindow = "fall"\n', "fall"),
        ('[[accept]]\nname = "it"\n', "accept"),
        ('[[accept]]\nname = "it"\ntrip = "high_levle"\n', "trip = 'high_levle': must be one of stale_levels"),
        ('[[accept]]\nname = "it"\nlevel_max_cm = 1000.0\n', "level_max_cm = 1000: must be at most 20"),
        ('[[accept]]\nname = "it"\ndetected_within_s = 2.0\n', "needs a [[fault]]"),
        ('[[accept]]\nname = "it"\nnamed = ["leak 7"]\n', "must be leak and the number of the tank, from 1 to 4"),
        ('[[accept]]\nname = "it"\nnamed = ["sensor_drfit 1"]\n', "is 'sensor_drift' meant?"),
        ('[[accept]]\nname = "it"\nnamed = ["bus_off"]\n', "no alarm is named so"),
        ('[[accept]]\nname = "it"\nfigure = "iae-Vs"\nmin = 0\n', "must be a path in kpi.json"),
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
