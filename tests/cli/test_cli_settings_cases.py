"""Settings that used to arm, move pumps and trip: each is refused before anything moves, with file, key, value, why."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.cli_bench import CONFIG, CommandLine, Result, assert_refused, config_copy, scenario_text

OTHER_PHASE = """
[rig]
pumps.gain_cm3_Vs = [3.14, 3.29]
pumps.valve_split = [0.43, 0.34]
control.operating_point_V = [3.15, 3.15]

[control]
design = "calibrated"
"""
"""Johansson's non-minimum-phase setting of the valves."""


@pytest.fixture
def simulate(command_line: CommandLine, tmp_path: Path) -> Callable[..., Result]:
    def call(more: str, *options: str) -> Result:
        path = tmp_path / "case.toml"
        path.write_text(scenario_text(duration="5.0", more=more))
        return command_line("hil", "simulate", path, "--out", "run", "--no-rerun", "--no-report", *options)

    return call


@pytest.mark.parametrize("splits", ["[0.5, 0.5]", "[0.3, 0.7]", "[0.504, 0.504]", "[0.9, 0.0951]"])
def test_valve_splits_that_add_up_to_one_are_refused(
    simulate: Callable[..., Result], tmp_path: Path, splits: str
) -> None:
    """They used to arm and to trip `controller_failed`: at 1 the two lower levels can't be set apart."""
    result = simulate(f"[rig]\npumps.valve_split = {splits}\n")
    assert_refused(result, "case.toml", "pumps.valve_split", splits, "add up to", "no control can set them apart")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("splits", ["[0.52, 0.5]", "[0.51, 0.51]"])
def test_valve_splits_a_little_above_one_run(simulate: Callable[..., Result], splits: str) -> None:
    assert simulate(f"[rig]\npumps.valve_split = {splits}\n[emulator]\npumps.valve_split = {splits}\n").code in (0, 3)


@pytest.mark.parametrize("period", [0.21, 0.3, 1.0, 10.0])
def test_a_period_over_the_watchdog_is_refused(simulate: Callable[..., Result], tmp_path: Path, period: float) -> None:
    """It used to arm, to command 3 V once, and to trip by the pump node's watchdog."""
    result = simulate(f"[rig]\ncontrol.period_s = {period}\n")
    assert_refused(result, "case.toml", f"control.period_s = {period}", "at most 0.2 s", "watchdog trips 0.25 s after")
    assert not (tmp_path / "run").exists()


AGES = [("levels", 0.19), ("status", 0.22), ("heartbeat", 0.27), ("echo", 0.22)]


@pytest.mark.parametrize(("name", "age_s"), AGES)
def test_ages_shorter_than_a_period_and_a_cycle_are_refused(
    simulate: Callable[..., Result], name: str, age_s: float
) -> None:
    """One late step would have tripped the run."""
    key = f"safety.{name}_age_max_s"
    ages = "".join(f"safety.{other}_age_max_s = 1.0\n" for other, _ in AGES if other != name)
    result = simulate(f"[rig]\ncontrol.period_s = 0.18\n{ages}{key} = {age_s}\n")
    assert_refused(result, "case.toml", f"{key} {age_s:g} s", "control.period_s 0.18 s", "one late step")


def test_the_longest_period_with_ages_to_match_runs_without_a_trip(simulate: Callable[..., Result]) -> None:
    ages = "".join(f"safety.{name}_age_max_s = 1.0\n" for name, _ in AGES)
    assert simulate(f"[rig]\ncontrol.period_s = 0.2\n{ages}").code == 0


def test_a_calibrated_gain_on_another_rig_is_refused_with_its_pole(
    simulate: Callable[..., Result], tmp_path: Path
) -> None:
    """The paper's gain on other valves used to run, unstable."""
    result = simulate(OTHER_PHASE)
    assert_refused(
        result, "case.toml", "design 'calibrated'", "does not stabilise this rig", "+0.012", "must be negative"
    )
    assert not (tmp_path / "run").exists()


def test_the_rigs_own_design_follows_its_valves(simulate: Callable[..., Result]) -> None:
    """It used to be refused with gamma1 + gamma2 < 1."""
    emulator = "[emulator]\npumps.gain_cm3_Vs = [3.14, 3.29]\npumps.valve_split = [0.43, 0.34]\n"
    result = simulate(OTHER_PHASE.replace("calibrated", "rig") + emulator)
    assert result.code == 0
    assert "0 alarms, 0 trips" in result.out


@pytest.mark.parametrize("file", ["rig.toml", "bench.dbc"])
def test_a_byte_order_mark_in_a_file_of_the_bench_is_left_out(
    simulate: Callable[..., Result], tmp_path: Path, file: str
) -> None:
    """Some editors put one in front of UTF-8; it used to be an invalid statement in line 1, column 1."""
    config = config_copy(tmp_path / "config")
    (config / file).write_bytes(b"\xef\xbb\xbf" + (CONFIG / file).read_bytes())
    assert simulate("", "--config", config).code == 0


def test_a_byte_order_mark_in_a_scenario_is_left_out(command_line: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "bom.toml"
    path.write_bytes(b"\xef\xbb\xbf" + scenario_text(duration="1.0").encode())
    assert command_line("hil", "simulate", path, "--out", "run", "--no-rerun", "--no-report").code == 0
    assert command_line("hil", "campaign", path, "--out", "all", "--seeds", 1, "--processes", 1).code == 0


@pytest.mark.parametrize("name", ["steps", "steps.toml"])
def test_shipped_scenarios_go_by_name(command_line: CommandLine, name: str) -> None:
    result = command_line("hil", "simulate", name, "--out", "run", "--duration", 1, "--no-rerun", "--no-report")
    assert (result.code, result.err) == (0, "")


@pytest.mark.parametrize("command", ["simulate", "run", "campaign"])
def test_an_unknown_name_lists_the_shipped_ones(command_line: CommandLine, command: str) -> None:
    shipped = "pump_losses" if command == "campaign" else "paper, paper_glr"
    assert_refused(command_line("hil", command, "papier"), "papier: no such file", shipped)


def test_a_file_beside_the_command_wins_over_a_shipped_name(command_line: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "paper").write_text(scenario_text(duration="1.0", name="mine"))
    result = command_line("hil", "simulate", "paper", "--out", "run", "--no-rerun", "--no-report")
    assert "mine: complete" in result.out


def test_scenarios_of_the_configuration_in_use_go_by_name_too(command_line: CommandLine, tmp_path: Path) -> None:
    config = config_copy(tmp_path / "config")
    (config / "scenarios" / "mine.toml").write_text(scenario_text(duration="1.0", name="mine"))
    options = ("--config", config, "--out", "run", "--no-rerun", "--no-report")
    assert "mine: complete" in command_line("hil", "simulate", "mine", *options).out
