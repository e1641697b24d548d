"""Case 55: configuration that can't be right."""

from pathlib import Path

import pytest

from tests.cli.cli_bench import CommandLine, assert_refused, config_copy
from tests.faults.faults_bench import OFF, contract, play, scenario_data


@pytest.fixture
def command_line(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> CommandLine:
    monkeypatch.chdir(tmp_path)
    return CommandLine(monkeypatch, capfd)


HEAD = '[scenario]\nname = "short"\nduration_s = 5.0\n'
SCENARIOS = {
    "unknown key": (HEAD + "speed = 3\n", "speed"),
    "NaN": (HEAD.replace("5.0", "nan"), "duration_s"),
    "path escape": (HEAD.replace('"short"', '"../escape"'), "name"),
    "infinite reference": (HEAD + "[[reference]]\nat_s = 1.0\nchange_V = [inf, 0.0]\n", "change_V"),
    "unknown fault": (HEAD + '[[fault]]\nat_s = 1.0\nkind = "gremlin"\n', "kind"),
}
FILES = {
    "unknown key": ("rig.toml", "[pumps]", "[pumps]\ncolour = 3", "colour"),
    "NaN": ("rig.toml", "lag_s = 0.2", "lag_s = nan", "lag_s"),
    "swapped limits": ("rig.toml", "range_V = [0.0, 10.0]", "range_V = [10.0, 0.0]", "range_V"),
    "limit above the rim": ("rig.toml", "level_max_cm = 19.0", "level_max_cm = 25.0", "level_max_cm"),
    "other DBC": ("bench.dbc", "BO_ 513 ", "BO_ 514 ", "bench.dbc"),
}


@pytest.mark.parametrize("command", ["simulate", "run"])
@pytest.mark.parametrize("which", SCENARIOS)
def test_case_55_bad_scenario(command_line: CommandLine, tmp_path: Path, which: str, command: str) -> None:
    """Refused before anything starts: one line that names file and key, exit code 2, no run folder."""
    text, key = SCENARIOS[which]
    file = tmp_path / "bad.toml"
    file.write_text(text)
    bus = ("-i", "virtual", "-c", "none") if command == "run" else ()
    assert_refused(command_line("hil", command, file, *bus), "bad.toml", key)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.toml"]


@pytest.mark.parametrize("which", FILES)
def test_case_55_bad_bench(command_line: CommandLine, tmp_path: Path, which: str) -> None:
    """The rig's file or the wire's contract: the same."""
    file, old, new, key = FILES[which]
    config = config_copy(tmp_path / "config", file=file, old=old, new=new)
    scenario = tmp_path / "good.toml"
    scenario.write_text(HEAD)
    assert_refused(command_line("hil", "simulate", scenario, "--config", config), file, key)
    assert not (tmp_path / "runs").exists()


def test_case_55_node_of_another_dbc() -> None:
    """A node that was built for another contract is never armed."""
    run = play(scenario_data(rig={"safety": {"arm_timeout_s": 1.0}}), fingerprint=contract().fingerprint ^ 1)
    assert run.outcome.status == "failed"
    assert "another DBC" in run.outcome.reason
    assert all(change.applied_V == OFF for change in run.keeper.changes if change.node == "pump")
