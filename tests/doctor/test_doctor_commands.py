"""Doctor and conformance check as commands: what they refuse. On a running emulator they are tested in tests/live."""

from pathlib import Path

import pytest

from tests.cli.cli_bench import CommandLine, assert_refused
from tests.live.live_bench import row


@pytest.fixture
def command_line(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> CommandLine:
    monkeypatch.chdir(tmp_path)
    return CommandLine(monkeypatch, capfd)


def test_a_bus_that_cannot_be_opened_is_a_failed_check_with_the_host_s_beside_it(command_line: CommandLine) -> None:
    result = command_line("hil", "doctor", "-i", "slcan", "-c", "socket://127.0.0.1:1")
    assert result.code == 4
    assert " fail " in row(result.out, "bus opens")
    assert "disk space" in result.out


def test_a_socketcan_link_that_is_not_there_is_a_failed_check(command_line: CommandLine) -> None:
    result = command_line("hil", "doctor", "-i", "socketcan", "-c", "can97")
    assert result.code == 4
    assert " fail " in row(result.out, "link state")
    assert "ip link set can97 up type can bitrate 500000" in " ".join(result.out.replace("│", " ").split())


def test_conformance_of_a_bus_that_cannot_be_opened_is_refused(command_line: CommandLine) -> None:
    assert_refused(command_line("hil", "conformance", "-i", "slcan", "-c", "socket://127.0.0.1:1"), "slcan", "500000")


def test_no_json_is_overwritten(command_line: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "told.json"
    file.write_text("mine")
    assert_refused(command_line("hil", "conformance", "--json", file), "--json", file, "exists already")
    assert file.read_text() == "mine"
    assert_refused(command_line("hil", "conformance", "--json", tmp_path / "no/x.json"), "--json", "no folder")


@pytest.mark.parametrize("seconds", ["0.5", "-1", "nan", "4000"])
def test_listening_time_has_a_range(command_line: CommandLine, seconds: str) -> None:
    assert_refused(command_line("hil", "doctor", "--seconds", seconds), "--seconds")


def test_a_bad_rig_file_is_refused_before_the_bus_is_opened(command_line: CommandLine, tmp_path: Path) -> None:
    assert_refused(command_line("hil", "doctor", "--config", tmp_path), "rig.toml", "can't be read")
    assert_refused(command_line("hil", "conformance", "--config", tmp_path), "rig.toml", "can't be read")
