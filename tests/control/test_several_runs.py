"""Two runs at once: `hil ctl` and `hil panel` say which there are, and talk to the one that is named."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hil.cli import exit_codes
from hil.cli.commands.panel import panel
from hil.edge.control import socket_path
from hil.edge.control.client import find_run
from hil.edge.control.socket_path import ControlError
from tests.control.control_bench import Bench, control_bench, ctl
from tests.waiting import wait_for


def test_two_runs_are_listed_and_one_that_is_named_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(socket_path, "_without_session", socket_path.runtime_dir)  # runs of other tests are there
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    with control_bench(first) as one:
        with control_bench(second, os.getppid()) as other:
            assert ctl("status") == exit_codes.NOT_DONE
            told = capsys.readouterr().err
            assert told.count("\n") == 1, "one line"
            assert f"{first} (process {os.getpid()})" in told
            assert f"{second} (process {os.getppid()})" in told
            assert "--run" in told
            with pytest.raises(ControlError, match="more than one run"):
                find_run()
            for web in (False, True):  # at once: the line of a panel is too short for the list
                with pytest.raises(ControlError, match="name one: ") as refused:
                    panel(web=web)
                assert all(f"{run} (process" in str(refused.value) for run in (first, second))
            assert find_run(second) == other.path
            with other.connect() as client:
                client.send("mark", name="here")
                wait_for(lambda: has_recorded(other), 5.0)
            assert "operator" not in one.codes()
        assert find_run() == one.path, "the only one again"


def has_recorded(bench: Bench) -> bool:
    """Whether a request has come to the run by its next step."""
    bench.step()
    return "operator" in bench.codes()
