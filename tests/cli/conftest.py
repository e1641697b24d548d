"""Commands called in an empty working directory."""

from pathlib import Path

import pytest

from tests.cli.cli_bench import CommandLine


@pytest.fixture
def command_line(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> CommandLine:
    monkeypatch.chdir(tmp_path)
    return CommandLine(monkeypatch, capfd)
