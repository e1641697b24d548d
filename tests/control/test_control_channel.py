"""The process that serves the clients, and the control thread's end: no client delays a step or fills memory."""

from __future__ import annotations

import json
import os
import signal
import socket
import stat
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from hil.edge.control.client import find_run
from hil.edge.control.control_channel import ControlChannel
from hil.edge.control.socket_path import ControlError, is_listening, place_of, running_runs
from tests.control.control_bench import CONFIG, Bench, answer, settings
from tests.waiting import wait_for


def test_a_request_is_taken_answered_recorded_and_seen(bench: Bench) -> None:
    with bench.connect() as client:
        assert client.hello["scenario"] == "toy"
        client.ask("subscribe", rate_hz=20.0)
        said = answer(bench, client, "reference", change_V=[0.1, None])
        assert (said["ok"], str(said["text"])[:13]) == (True, "references to"), said
        bench.step()
        state = client.state()
        assert state["mode"] == "RUNNING"
        assert state["reference_cm"][0] == pytest.approx(12.46, abs=0.01)
        assert answer(bench, client, "clear")["reason"] == "not while RUNNING"
    event = next(event for event in bench.events if event.code == "operator")
    assert (event.data["pid"], event.data["request"]) == (os.getpid(), {"do": "reference", "change_V": [0.1, None]})
    assert "refused" in bench.codes()


def test_the_socket_is_for_this_user_alone(bench: Bench) -> None:
    assert stat.S_IMODE(bench.path.stat().st_mode) == 0o600


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_another_user_is_refused(bench: Bench) -> None:
    code = (
        "import os, socket, sys\nos.setgid(65534); os.setuid(65534)\nsocket.socket(socket.AF_UNIX).connect(sys.argv[1])"
    )
    for folder in (bench.path.parent, *bench.path.parent.parents[:2]):
        folder.chmod(0o755)
    done = subprocess.run([sys.executable, "-c", code, bench.path], capture_output=True, text=True, check=False)
    assert "PermissionError" in done.stderr, done.stderr


def test_a_run_is_found_and_its_end_removes_socket_and_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = tmp_path / "control.sock"
    with ControlChannel() as channel:
        channel.open(settings(path), CONFIG)
        assert [run.socket for run in running_runs()] == [str(path)]
        assert find_run() == path
    assert not path.exists()
    assert running_runs() == []
    with pytest.raises(ControlError, match="no run goes on"):
        find_run()


def test_a_socket_that_a_killed_run_has_left_is_replaced_but_not_one_in_use(tmp_path: Path, bench: Bench) -> None:
    left = tmp_path / "left.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(left))
    with ControlChannel() as channel:
        channel.open(settings(left), CONFIG)
        assert is_listening(left)
    with ControlChannel() as second, pytest.raises(ControlError, match="another run listens there"):
        second.open(settings(bench.path), CONFIG)
    assert is_listening(bench.path), "the first one's is still there"
    (tmp_path / "file").write_text("mine")
    with ControlChannel() as third, pytest.raises(ControlError, match="a file is there that is no socket"):
        third.open(settings(tmp_path / "file"), CONFIG)
    assert (tmp_path / "file").read_text() == "mine"


def test_a_path_that_is_too_long_is_an_error_or_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    long = tmp_path / ("x" * 100)
    long.mkdir()
    assert place_of(long, None, 5) == tmp_path / "fourtank-hil" / "5.sock"
    with pytest.raises(ControlError, match="bytes, a socket's path may have 107"):
        place_of(tmp_path, long / "control.sock", 5)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_that_dies_or_stands_does_not_stop_the_run(bench: Bench, number: signal.Signals) -> None:
    pid = bench.channel._process.pid
    os.kill(pid, number)
    longest_s = 0.0
    for _ in range(400):  # some 4 MB if the states were kept
        begun_s = time.perf_counter()
        bench.step()
        longest_s = max(longest_s, time.perf_counter() - begun_s)
    assert longest_s < 1.0, "no step has waited for it"
    assert bench.output is not None
    assert bench.output.command.enable
    assert len(bench.channel._events) <= 200
    if number is signal.SIGKILL:
        bench.channel._process.wait(5.0)
        bench.step(2)
        assert bench.codes().count("control_lost") == 1
        assert not bench.channel.is_open
        return
    assert bench.channel.is_open, "it may go on"
    os.kill(pid, signal.SIGCONT)
    with bench.connect() as client:
        assert answer(bench, client, "note", text="there again")["ok"]


def test_a_line_that_is_too_long_ends_the_connection(bench: Bench) -> None:
    connection = bench.raw()
    with suppress(OSError):
        connection.sendall(b"x" * 10_000_000)
    received = b""
    with suppress(ConnectionError):
        while data := connection.recv(4096):
            received += data
    assert received == b"" or json.loads(received)["reason"] == "too_long"
    with bench.connect() as client:
        assert answer(bench, client, "note", text="still there")["ok"]


def test_a_client_that_asks_too_much_is_refused_and_a_stop_is_still_taken(bench: Bench) -> None:
    connection = bench.raw()
    connection.sendall(b'{"do": "note", "text": "x"}\n' * 60)
    wait_for(lambda: b"too_many" in connection.recv(65536), 5.0)
    before = len(bench.events)
    bench.step(10)
    assert len(bench.events) - before <= 21
    with bench.connect() as client:
        assert answer(bench, client, "stop")["ok"]
    assert bench.state.supervision.stopped_by


def test_a_client_that_never_reads_loses_states_and_is_disconnected_in_the_end(bench: Bench) -> None:
    connection = bench.raw()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.sendall(b'{"do": "subscribe", "rate_hz": 20}\n')
    bench.step(200)
    for _ in range(60):  # answers of 430 bytes each, which can't be left out as states can
        with suppress(OSError):
            connection.sendall(b'{"do": "explode' + b"x" * 3000 + b'"}\n')
    with bench.connect() as client:
        assert answer(bench, client, "note", text="others are served")["ok"]
    connection.close()


def test_what_is_no_request_reaches_nobody(bench: Bench) -> None:
    with bench.connect() as client:
        assert client.ask("explode")["reason"] == "bad_request"
        assert "for_s = -1.0: must be" in client.ask("bypass", interlock="dry_run", for_s=-1.0)["text"]
    bench.step(3)
    assert bench.codes() == []
