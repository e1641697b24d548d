"""Commands called in an empty working directory."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for `cli_bench`
sys.path.insert(0, str(Path(__file__).parents[1] / "live"))  # for `live_bench`

from cli_bench import CommandLine


@pytest.fixture
def command_line(monkeypatch, capfd, tmp_path):
    monkeypatch.chdir(tmp_path)
    return CommandLine(monkeypatch, capfd)
