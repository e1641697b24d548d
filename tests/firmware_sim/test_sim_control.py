"""The way of commands into the emulator: sockets by hand, the process with its standard input."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_sim import cli, command_server
from firmware_sim.command_server import LINE_MAX, CommandServer, Lines, listen_unix
from firmware_sim.links import listen
from firmware_sim.rig import Rig
from tests.firmware_sim.fault_bench import rig_with
from tests.firmware_sim.sim_bench import SECOND, run_emulator
from tests.narrowing import not_none


def test_lines_come_cut_anywhere_and_long_ones_are_cut_off() -> None:
    lines = Lines()
    assert lines.feed(b"fail") == []
    assert lines.feed(b"ure pump ok\r\n\n failure ") == ["failure pump ok"]
    assert lines.feed(b"help\n") == ["failure help"]
    assert lines.feed(b"x" * 5000) == []
    assert lines.feed(b"y" * 5000 + b"\nfailure help\n") == ["x" * LINE_MAX, "failure help"]
    assert lines.feed(b"\xff\n") == ["\ufffd"]


@pytest.fixture(params=["tcp", "unix"])
def control(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[CommandServer]:
    rig = rig_with()
    rig.advance(SECOND)
    listener = listen(0) if request.param == "tcp" else listen_unix(tmp_path / "control")
    control = CommandServer(rig, listener)

    yield control
    control.close()


def connected(control: CommandServer) -> socket.socket:
    address = not_none(control.address)
    if address.startswith("/"):
        client = socket.socket(socket.AF_UNIX)
        client.connect(address)
    else:
        client = socket.create_connection(("127.0.0.1", int(address.split(":")[1])))
    client.settimeout(5.0)
    return client


def test_each_line_gets_its_answer_on_its_own_socket(control: CommandServer) -> None:
    with connected(control) as first, connected(control) as second:
        first.sendall(b"failure pump off -i 1\nfailure pump garbage\n")
        second.sendall(b"failure help\n")
        control.read(SECOND)
        assert first.recv(1000).decode().splitlines() == [
            "ok pump_dead 1",
            "error: pump has no failure type 'garbage': one of ok, wrong, off, stuck, slow, pump_effectiveness, "
            "pump_dead, pump_stuck_on, pump_lag",
        ]
        assert second.recv(1000).startswith(b"ok failure")
        rig = control._rig
        assert isinstance(rig, Rig)
        assert rig.truth().effectiveness == (0.0, 1.0)
        assert len(control.filenos()) == 3
    control.read(SECOND)
    assert len(control.filenos()) == 1


def test_a_host_that_never_reads_is_dropped(control: CommandServer) -> None:
    with connected(control) as client:
        control.read(SECOND)
        client.setblocking(False)
        for _ in range(3000):
            try:
                client.send(b"failure help\n" * 50)
            except OSError:
                break
            control.read(SECOND)
            if len(control.filenos()) == 1:
                break
        assert len(control.filenos()) == 1


def test_a_path_in_use_is_refused_and_an_abandoned_one_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "control"
    first = listen_unix(path)
    with pytest.raises(OSError, match="in use"):
        listen_unix(path)
    first.close()
    CommandServer(rig_with(), listen_unix(path)).close()
    assert not path.exists()
    path.write_text("precious")
    with pytest.raises(OSError, match="in use"):
        listen_unix(path)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("where", ["/nowhere/at/all", "99999"])
def test_a_control_address_that_can_not_be_had_is_a_usage_error(where: str) -> None:
    with pytest.raises(cli.UsageError, match=f"--control {where}: "):
        cli._command_server(rig_with(), where)


@pytest.mark.parametrize("where", ["/nowhere/at/all", "99999"])
def test_a_control_address_that_can_not_be_had_is_one_line(where: str) -> None:
    done = run_emulator("--pty", "--control", where)
    assert done.returncode == 2
    assert done.stderr.startswith(f"firmware-sim: --control {where}: ")
    assert done.stderr.count("\n") == 1


def test_a_line_of_standard_input_is_answered_on_standard_output(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    read_end, write_end = os.pipe()
    monkeypatch.setattr(command_server, "STDIN", read_end)
    server = CommandServer(rig_with(), with_stdin=True)
    os.write(write_end, b"failure pump ok\nfailure nonsense\n")
    server.read(SECOND)
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("ok")
    assert second.startswith("error: ")
    os.close(write_end)
    server.read(SECOND)
    os.close(read_end)
    server.read(SECOND)  # what has ended is not read again
    server.close()
