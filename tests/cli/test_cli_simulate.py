"""`hil simulate`: what it leaves, that it repeats itself to the byte, and how it ends."""

import json
import os
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from hil.bench import run_options
from hil.bench.assembly import load
from hil.bench.late_faults import late_faults
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import read
from tests.cli.cli_bench import CONFIG, CommandLine, Result, assert_refused, config_copy, run_script, scenario_text

FAULTY = """
[scenario]
name = "faulty"
duration_s = 30.0
[[reference]]
at_s = 5.0
change_V = [0.2, 0.1]
[[fault]]
at_s = 10.0
kind = "pump_effectiveness"
target = 2
value = 0.6
[diagnosis]
method = "ideal"
[[window]]
name = "after_the_fault"
from_s = 10.0
to_s = 25.0
"""
RECORD = ("can.log", "sent.log", "ticks.csv", "events.jsonl")


@pytest.fixture(scope="module")
def faulty_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result, Path]:
    """A run of 30 s with a reference step and a fault, through the console script: folder, and what was printed."""
    folder = tmp_path_factory.mktemp("simulate")
    scenario = folder / "faulty.toml"
    scenario.write_text(FAULTY)
    result = run_script("hil", "simulate", scenario, "--out", folder / "run", "--seed", 7)
    assert result.code == 0, result
    return folder / "run", result, scenario


def figures(folder: Path) -> Any:
    return json.loads((folder / "kpi.json").read_text())


def simulate(command_line: CommandLine, scenario: Path, out: Path, *options: str | int | Path, code: int = 0) -> Path:
    result = command_line("hil", "simulate", scenario, "--out", out, "--no-rerun", "--no-report", *options)
    assert result.code == code, result
    return out


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "faulty.toml"
    path.write_text(FAULTY)
    return path


def test_a_run_leaves_every_file_and_says_where(faulty_run: tuple[Path, Result, Path]) -> None:
    folder, result, _ = faulty_run
    assert {path.name for path in folder.iterdir()} == {*RECORD, "run.json", "run.rrd", "kpi.json", "report.html"}
    assert all(path.stat().st_size > 0 for path in folder.iterdir())
    for name in ("kpi.json", "report.html", "run.rrd"):
        assert str(folder / name) in result.out
    assert "faulty: complete" in result.out
    assert result.err == ""


def test_key_figures_are_complete_and_fit_the_run(faulty_run: tuple[Path, Result, Path]) -> None:
    kpi = figures(faulty_run[0])
    assert set(kpi["iae_Vs"]) == {"after_the_fault"}
    assert all(0.0 < iae < 15.0 * 0.5 for iae in kpi["iae_Vs"]["after_the_fault"])
    assert kpi["iae_covered_s"] == {"after_the_fault": 15.0}
    assert all(3.0 < volts <= 10.0 for volts in kpi["applied_max_V"])
    assert len(kpi["level_max_cm"]) == 4
    assert all(0.0 < level < 19.0 for level in kpi["level_max_cm"])
    assert kpi["trips"] == []
    (alarm,) = kpi["alarms"]
    assert {"detected_s", "kind", "target", "size", "size_std", "onset_s", "isolated_s", "candidates"} <= set(alarm)
    assert (alarm["kind"], alarm["target"], alarm["size"]) == ("pump_effectiveness", 2, 0.6)
    assert alarm["detected_s"] == pytest.approx(11.0, abs=0.11)  # one second of delay, one control period
    assert kpi["ticks"] == 300
    assert kpi["skipped"] == 0
    assert kpi["speed_x"] > 5.0
    assert (kpi["commands"]["commands_lost"], kpi["commands"]["frames_lost"]) == (0, 0)


def test_the_record_of_a_run_holds_the_configuration_it_ran_on(faulty_run: tuple[Path, Result, Path]) -> None:
    folder, _, scenario = faulty_run
    run = json.loads((folder / "run.json").read_text())
    assert (run["status"], run["mode"], run["seed"], run["scenario"]) == ("complete", "lockstep", 7, "faulty")
    assert run["copies"] == {
        "scenarios/faulty.toml": scenario.read_text(),
        **{name: (CONFIG / name).read_text() for name in ("rig.toml", "emulator.toml", "bench.dbc")},
    }


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(
    faulty_run: tuple[Path, Result, Path], command_line: CommandLine, scenario: Path, tmp_path: Path
) -> None:
    """Across processes: the fixture's run was made by the console script, these are not."""
    first = faulty_run[0]
    again = simulate(command_line, scenario, tmp_path / "again", "--seed", 7)
    other = simulate(command_line, scenario, tmp_path / "other", "--seed", 8)
    for name in RECORD:
        assert (again / name).read_bytes() == (first / name).read_bytes(), name
    for name in ("can.log", "ticks.csv"):
        assert (other / name).read_bytes() != (first / name).read_bytes(), name


def test_a_second_run_into_the_same_folder_is_refused_and_changes_nothing(
    faulty_run: tuple[Path, Result, Path], command_line: CommandLine
) -> None:
    folder, _, scenario = faulty_run
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert_refused(command_line("hil", "simulate", scenario, "--out", folder), folder, "exists already")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_duration_cuts_the_run_short(command_line: CommandLine, scenario: Path, tmp_path: Path) -> None:
    kpi = figures(simulate(command_line, scenario, tmp_path / "cut", "--duration", 6))
    assert kpi["ticks"] == 60
    assert (kpi["status"], kpi["alarms"]) == ("complete", [])
    assert kpi["iae_covered_s"] == {"after_the_fault": 0.0}


def test_without_rerun_and_report_only_the_plain_record_is_left(
    command_line: CommandLine, scenario: Path, tmp_path: Path
) -> None:
    folder = simulate(command_line, scenario, tmp_path / "plain", "--duration", 2)
    assert {path.name for path in folder.iterdir()} == {*RECORD, "run.json", "kpi.json"}


def test_a_scenario_of_nothing_but_name_and_length_holds_the_operating_point(
    command_line: CommandLine, tmp_path: Path
) -> None:
    bare = tmp_path / "bare.toml"
    bare.write_text(scenario_text(name="bare"))
    kpi = figures(simulate(command_line, bare, tmp_path / "bare"))
    assert (kpi["iae_Vs"], kpi["alarms"], kpi["trips"]) == ({}, [], [])
    assert all(2.5 < volts < 3.5 for volts in kpi["applied_max_V"])


def test_the_default_folder_lies_below_runs_and_carries_the_name(command_line: CommandLine, tmp_path: Path) -> None:
    bare = tmp_path / "bare.toml"
    bare.write_text(scenario_text(name="bare", duration="2.0"))
    assert command_line("hil", "simulate", bare, "--no-rerun", "--no-report").code == 0
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.endswith("_bare")


def test_runs_that_start_in_the_same_second_have_folders_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = []
    for _ in range(3):
        folder = run_options.default_folder("steps", datetime(2026, 1, 1, 12, 0, 0))
        folder.mkdir(parents=True)
        names.append(str(folder))
    assert names == [f"runs/20260101-120000_steps{end}" for end in ("", "_2", "_3")]


def test_the_emulators_table_reaches_the_emulator_and_not_the_controller(
    command_line: CommandLine, tmp_path: Path
) -> None:
    """Tanks that start lower than the controller believes: equilibrium levels go with the square of the voltage."""
    usual, low = tmp_path / "usual.toml", tmp_path / "low.toml"
    usual.write_text(scenario_text(duration="2.0"))
    low.write_text(scenario_text(duration="2.0", more="[emulator]\ntanks.start_V = [2.7, 2.7]"))
    runs = [read(RunFolder.open(simulate(command_line, path, tmp_path / path.stem)))[0] for path in (usual, low)]
    levels_cm = [run.stack("true_h1_cm", "true_h2_cm", "true_h3_cm", "true_h4_cm")[0] for run in runs]
    assert levels_cm[1] == pytest.approx(0.81 * levels_cm[0], rel=1e-6)
    assert list(runs[1].stack("r1_V", "r2_V")[0]) == list(runs[0].stack("r1_V", "r2_V")[0])


RECOVERED_PUMP = """
[[fault]]
at_s = 0.0
until_s = 60.0
kind = "pump_effectiveness"
target = 2
value = 0.4
[diagnosis]
method = "none"
[rig]
safety.level_max_cm = 12.9
"""


def test_a_rig_that_is_about_to_overflow_trips_with_exit_code_3(command_line: CommandLine, tmp_path: Path) -> None:
    """A weak pump, driven up by the integrals and suddenly whole again, lifts the level over a low trip level."""
    scenario = tmp_path / "over.toml"
    scenario.write_text(scenario_text(name="over", duration="90.0", more=RECOVERED_PUMP))
    folder = simulate(command_line, scenario, tmp_path / "over", code=3)
    kpi = figures(folder)
    assert kpi["status"] == "tripped"
    (trip,) = kpi["trips"]
    assert trip["cause"] == "high_level"
    assert json.loads((folder / "run.json").read_text())["reason"] == "high_level"
    assert 12.8 < max(kpi["level_max_cm"]) < 13.1
    assert trip["t_s"] > 60.0


def test_a_rig_that_can_not_be_armed_ends_with_exit_code_4_and_says_why(
    command_line: CommandLine, tmp_path: Path
) -> None:
    scenario = tmp_path / "full.toml"
    more = "[emulator]\ntanks.start_V = [3.6, 3.6]\n[rig]\nsafety.level_max_cm = 13.5\nsafety.arm_timeout_s = 1.0"
    scenario.write_text(scenario_text(name="full", more=more))
    folder = simulate(command_line, scenario, tmp_path / "full", code=4)
    kpi = figures(folder)
    assert (kpi["status"], kpi["ticks"]) == ("failed", 0)
    assert kpi["reason"].startswith("not ready within 1 s: a tank is about to overflow: levels of 1")


def test_both_twins_read_the_configuration_folder_that_is_named(command_line: CommandLine, tmp_path: Path) -> None:
    bare = tmp_path / "bare.toml"
    bare.write_text(scenario_text(name="bare", duration="2.0"))
    config = config_copy(
        tmp_path / "config", file="bench.dbc", old='CM_ SG_ 513 Command1 "', new='CM_ SG_ 513 Command1 "The '
    )
    folder = simulate(command_line, bare, tmp_path / "run", "--config", config)
    assert "The Voltage" in json.loads((folder / "run.json").read_text())["copies"]["bench.dbc"]


def test_report_lays_two_runs_side_by_side(
    faulty_run: tuple[Path, Result, Path], command_line: CommandLine, scenario: Path, tmp_path: Path
) -> None:
    first = faulty_run[0]
    second = simulate(command_line, scenario, tmp_path / "second", "--seed", 8)
    (second / "kpi.json").unlink()
    result = command_line("hil", "report", second, "--compare", first)
    assert (result.code, result.out.strip(), result.err) == (0, str(second / "report.html"), "")
    page = (second / "report.html").read_text()
    assert "this run" in page
    assert "compared run" in page
    assert figures(second)["ticks"] == 300


@pytest.mark.parametrize("command", ["report", "view"])
def test_what_is_no_run_folder_is_refused(command_line: CommandLine, tmp_path: Path, command: str) -> None:
    for folder in (tmp_path / "nothing", tmp_path):
        assert_refused(command_line("hil", command, folder), folder, "not a run folder")


def test_report_refuses_a_second_folder_that_is_none(
    faulty_run: tuple[Path, Result, Path], command_line: CommandLine, tmp_path: Path
) -> None:
    assert_refused(command_line("hil", "report", faulty_run[0], "--compare", tmp_path), tmp_path, "not a run folder")


DAMAGE = {
    "run.json is not text": ("run.json", b"\xff\xfe\x00"),
    "run.json is cut off": ("run.json", b'{"format": 1, '),
    "run.json is of another format": ("run.json", b'{"format": 99}'),
    "ticks.csv is missing": ("ticks.csv", None),
    "ticks.csv is empty": ("ticks.csv", b""),
    "ticks.csv is something else": ("ticks.csv", b"a,b\n1,2\n"),
    "events.jsonl is something else": ("events.jsonl", b"hello\n"),
}


@pytest.mark.parametrize(("file", "content"), DAMAGE.values(), ids=DAMAGE.keys())
def test_report_names_a_damaged_file_in_one_line(
    command_line: CommandLine, tmp_path: Path, file: str, content: bytes | None
) -> None:
    bare = tmp_path / "bare.toml"
    bare.write_text(scenario_text(name="bare", duration="1.0"))
    folder = simulate(command_line, bare, tmp_path / "run")
    (folder / file).unlink()
    if content is not None:
        (folder / file).write_bytes(content)
    named = (folder,) if content == b"\xff\xfe\x00" else (file,)
    assert_refused(command_line("hil", "report", folder), *named)


def test_view_without_a_recording_points_to_the_report(command_line: CommandLine, tmp_path: Path) -> None:
    bare = tmp_path / "bare.toml"
    bare.write_text(scenario_text(name="bare", duration="1.0"))
    folder = simulate(command_line, bare, tmp_path / "run")
    assert_refused(command_line("hil", "view", folder), folder, "no run.rrd", "hil report")


@pytest.mark.skipif("DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ, reason="there is a screen here")
def test_view_without_a_screen_points_to_the_report(
    faulty_run: tuple[Path, Result, Path], command_line: CommandLine
) -> None:
    assert_refused(command_line("hil", "view", faulty_run[0], "--window"), "no screen", faulty_run[0] / "report.html")


def test_design_shows_both_designs_and_writes_its_figures_the_same_ones_again(
    command_line: CommandLine, tmp_path: Path
) -> None:
    result = command_line("hil", "design", "--out", tmp_path / "figures")
    assert (result.code, result.err) == (0, "")
    assert "\nrig: " in result.out
    assert "\ncalibrated: " in result.out
    assert "+0.2089 unstable" in result.out, "the paper's gain with pump 1 at 40 %"
    for name in ("step.svg", "sigma.svg"):
        assert "<svg" in (tmp_path / "figures" / name).read_text()
        assert str(tmp_path / "figures" / name) in result.out
    assert command_line("hil", "design", "--out", tmp_path / "again").code == 0
    assert (tmp_path / "again/step.svg").read_bytes() == (tmp_path / "figures/step.svg").read_bytes()


def test_version_is_shown(command_line: CommandLine) -> None:
    result = command_line("hil", "--version")
    assert (result.code, result.err) == (0, "")
    assert result.out.startswith("hil ")


def test_a_fault_after_the_end_of_the_run_is_a_line_of_warning(command_line: CommandLine, tmp_path: Path) -> None:
    """A shortened run used to look like one whose fault was not found."""
    arguments = ("simulate", "paper", "--no-rerun", "--no-report")
    short = command_line("hil", *arguments, "--out", tmp_path / "short", "--duration", 1)
    assert short.code == 0
    assert short.err == (
        "hil: WARNING: the run ends at 1 s, before these faults begin: "
        "pump_effectiveness 1 at 200 s, pump_effectiveness 2 at 200 s\n"
    )
    assert late_faults(load("paper").scenario) == ""
    assert late_faults(load("paper").scenario, 200.1) == ""
