"""Something else listens where a run should, or a run of another version: one line, and a stop gets through."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from hil.cli import exit_codes
from hil.cli.ctl_command import CtlOptions, run
from hil.edge.control.socket_path import RunningRun, announce

HELLO = b'{"v": 1, "hello": {"folder": "/data/run"}}\n'


@contextmanager
def answering(path: Path, said: bytes) -> Iterator[None]:
    """Something that greets every client, and says this to whatever it asks."""
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()

        def serve() -> None:
            with suppress(OSError):
                while True:
                    client, _ = server.accept()
                    with client, suppress(OSError):
                        client.sendall(HELLO)
                        client.recv(4096)
                        client.sendall(said)
                        client.recv(4096)

        threading.Thread(target=serve, daemon=True).start()
        yield
        server.shutdown(socket.SHUT_RDWR)


ANSWERS = {
    "no JSON": b"220 smtp ready\n",
    "nested": b"[" * 100_000 + b"\n",
    "no answer in it": b'{"v": 1, "id": 1, "ok": true}\n',
    "another state": b'{"v": 1, "id": 1, "ok": true, "text": ""}\n{"v": 2, "state": {"level": 3}}\n',
    "a state that is none": b'{"v": 1, "id": 1, "ok": true, "text": ""}\n{"v": 1, "state": 7}\n',
}


def ctl(action: str, path: Path) -> int:
    return run(CtlOptions(action, (), False, False, 0.0, False, None, path))


@pytest.mark.parametrize("said", ANSWERS.values(), ids=list(ANSWERS))
def test_an_answer_of_something_else_is_one_line(
    tmp_path: Path, said: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was a traceback."""
    path = tmp_path / "c.sock"
    with answering(path, said):
        assert ctl("status", path) == exit_codes.NOT_DONE
    assert capsys.readouterr().err.count("\n") == 1


def test_a_stop_reaches_a_run_of_another_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path, process = tmp_path / "c.sock", subprocess.Popen(["sleep", "60"])
    try:
        announce(RunningRun(process.pid, str(tmp_path), str(path), "toy", "2026-01-01T00:00:00+00:00"))
        with answering(path, json.dumps({"v": 2, "id": 1, "done": True}).encode() + b"\n"):
            assert ctl("stop", path) == 0
        assert process.wait(5.0) == -signal.SIGTERM
    finally:
        process.kill()
        process.wait()
