"""The emulator's command line: which port it serves, and what it says about it (live runs: test_sim_live)."""

from typing import Any

import pytest

from firmware_sim import cli
from firmware_sim.command_server import CommandServer
from firmware_sim.ports import PtyPort, TcpPort
from firmware_sim.rig import Rig
from tests.firmware_sim.fault_bench import rig_with


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, str]]:
    """What would be served and where, in place of serving it."""
    ports: list[tuple[Any, str]] = []

    def keep(_rig: Rig, _commands: object, port: Any, where: str) -> None:
        ports.append((port, where))
        port.close()

    monkeypatch.setattr(cli, "_run", keep)
    return ports


def test_without_a_port_number_a_pseudo_terminal_is_served(served: list[tuple[Any, str]]) -> None:
    commands: Any = None
    cli._serve_slcan(rig_with(), commands, None)
    ((port, where),) = served
    assert isinstance(port, PtyPort)
    assert where == f"slcan on {port.path}"


def test_port_0_is_a_free_tcp_port(served: list[tuple[Any, str]]) -> None:
    commands: Any = None
    cli._serve_slcan(rig_with(), commands, 0)
    ((port, where),) = served
    assert isinstance(port, TcpPort)
    assert where.startswith("slcan on socket://127.0.0.1:")
    assert int(where.rpartition(":")[2]) > 0


@pytest.mark.parametrize(
    ("error", "code"),
    [(OSError("gone"), 1), (RuntimeError("gone"), 1), (KeyboardInterrupt(), 1), (ValueError("no"), 2)],
)
def test_an_error_is_an_exit_code(monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int) -> None:
    def fail(**_options: object) -> None:
        raise error

    monkeypatch.setattr(cli, "app", fail)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == code


def test_an_error_without_words_is_named_by_its_type(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_arguments: object, **_options: object) -> None:
        raise NotImplementedError

    monkeypatch.setattr("can.Bus", fail)
    with pytest.raises(cli.UsageError, match="cannot open the bus: NotImplementedError"):
        cli._serve_bus(rig_with(), CommandServer(rig_with()), "virtual", "somewhere", None)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--slcan", "70000"], "'--slcan': 70000: must be a whole number, 0 to 65535"),
        (["--slcan", "x"], "'--slcan': x: must be a whole number, 0 to 65535"),
        (["--pty", "--seed", "-1"], "'--seed': -1: must be a whole number, 0 or more"),
        (["-i", "virtual", "-c", "a", "-b", "0"], "'-b' / '--bitrate': 0: must be a whole number, 1 or more"),
    ],
)
def test_a_number_that_an_option_does_not_take_is_named_with_what_it_takes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    """It named the limit, but not the value."""
    monkeypatch.setattr("sys.argv", ["firmware-sim", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 2
    assert capsys.readouterr().err == f"firmware-sim: Invalid value for {said}\n"
