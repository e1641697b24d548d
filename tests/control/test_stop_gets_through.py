"""A stop gets through: beside idle clients, to a run whose folder was removed, and without a control channel."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hil.cli import exit_codes
from hil.edge.control.client import ControlClient, find_run
from hil.edge.control.control_channel import ControlChannel
from hil.edge.control.listening_place import ListeningPlace
from hil.edge.control.server import MAX_CLIENTS, STOP_PLACES
from hil.edge.control.socket_path import ControlError, is_listening, listen, running_runs
from tests.control.control_bench import CONFIG, Bench, answer, control_bench, ctl, settings
from tests.waiting import wait_for


@pytest.fixture
def other_process() -> Iterator[subprocess.Popen[bytes]]:
    """A process that is said to be the run's, and may be stopped."""
    with subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"]) as process:
        yield process
        process.kill()


def test_idle_clients_do_not_keep_a_stop_out(bench: Bench) -> None:
    """32 clients that said nothing kept every other one out, also one that wanted to stop the run."""
    with ExitStack() as stack:
        for _ in range(MAX_CLIENTS + STOP_PLACES + 2):
            stack.enter_context(bench.connect())
        with bench.connect() as watcher:
            refused = watcher.ask("note", text="x")
            assert (refused["reason"], refused["ok"]) == ("too_many", False)
            assert "32 clients are served already" in refused["text"]
        with bench.connect() as operator:
            assert answer(bench, operator, "stop")["ok"]
    assert bench.state.supervision.stopped_by


def test_one_more_is_served_when_another_has_left(bench: Bench) -> None:
    with ExitStack() as stack:
        clients = [stack.enter_context(bench.connect()) for _ in range(MAX_CLIENTS)]
        assert not _is_served(bench)
        clients[0].close()
        wait_for(lambda: _is_served(bench), 5.0)


def _is_served(bench: Bench) -> bool:
    with bench.connect() as client:
        return bool(answer(bench, client, "note", text="x")["ok"])


def test_a_full_queue_of_new_clients_is_no_left_socket(tmp_path: Path) -> None:
    """A run whose server was stopped had its socket taken by the next run, as nobody seemed to listen there."""
    path = tmp_path / "control.sock"
    with listen(path) as server, ExitStack() as stack:
        server.listen(0)
        for _ in range(3):
            waiting = stack.enter_context(socket.socket(socket.AF_UNIX))
            waiting.setblocking(False)
            waiting.connect_ex(str(path))
        assert is_listening(path)
        with pytest.raises(ControlError, match="another run listens there"):
            listen(path)
        with pytest.raises(ControlError, match="no run listens"):
            ControlClient.connect(path, 0.2)


def test_a_run_whose_folder_is_removed_is_still_found_and_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The socket was gone with the folder; only a signal could stop the run."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = tmp_path / "run"
    folder.mkdir()
    with control_bench(folder) as bench:
        shutil.rmtree(folder)
        wait_for(lambda: find_run(folder) != folder / "control.sock", 5.0)
        assert find_run() == find_run(folder) == tmp_path / "fourtank-hil" / f"{os.getpid()}.sock"
        with ControlClient.connect(find_run()) as operator:
            assert answer(bench, operator, "stop")["ok"]
    assert running_runs() == []
    assert list((tmp_path / "fourtank-hil").iterdir()) == []


def test_a_removed_socket_is_made_again_and_that_of_another_run_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path, entry = tmp_path / "control.sock", tmp_path / "fourtank-hil" / f"{os.getpid()}.json"
    place = ListeningPlace(path, settings(path).run)
    assert place.renew() is None
    entry.unlink()
    assert place.renew() is None
    assert entry.exists()
    path.unlink()
    with place.listener, place.renew() or socket.socket() as again:
        assert again.getsockname() == str(path)
        assert is_listening(path)
        path.unlink()
        path.write_text("of another program")
        place.remove()
    assert path.read_text() == "of another program"
    assert not entry.exists()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_run_without_its_channel_is_listed_and_stopped_by_a_signal(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    other_process: subprocess.Popen[bytes],
    number: signal.Signals,
) -> None:
    """`hil ctl stop` said that no run goes on while the pumps ran, when only the channel's process was gone."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with ControlChannel() as channel:
        channel.open(settings(tmp_path / "control.sock", other_process.pid), CONFIG)
        os.kill(channel._process.pid, number)
        if number is signal.SIGKILL:
            channel._process.wait(5.0)
        assert [run.pid for run in running_runs()] == [other_process.pid]
        if number is signal.SIGKILL:
            assert ctl("hold") == exit_codes.NOT_DONE
            assert f"process {other_process.pid} goes on" in capsys.readouterr().err
        assert ctl("stop") == 0
        assert f"SIGTERM sent to process {other_process.pid}" in capsys.readouterr().out
        assert other_process.wait(5.0) == -signal.SIGTERM
        assert running_runs() == []
        channel._process.kill()


def test_nobody_else_can_name_the_process_that_a_stop_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other_process: subprocess.Popen[bytes]
) -> None:
    """A list that others may write to, or an entry whose process is a later one with the same number."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    place = ListeningPlace(tmp_path / "a.sock", settings(tmp_path / "a.sock", other_process.pid).run)
    with place.listener:
        (entry,) = (tmp_path / "fourtank-hil").glob("*.json")
        assert len(running_runs()) == 1
        (tmp_path / "fourtank-hil").chmod(0o777)
        assert running_runs() == []
        (tmp_path / "fourtank-hil").chmod(0o700)
        start = running_runs()[0].process_start
        entry.write_text(entry.read_text().replace(f'"{start}"', '"1"'))
        assert running_runs() == []
    assert other_process.poll() is None
