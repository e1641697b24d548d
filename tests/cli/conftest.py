"""Commands called in an empty working directory."""

import pytest

from tests.cli.cli_bench import CommandLine


@pytest.fixture
def command_line(monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    return CommandLine(monkeypatch, capfd)
