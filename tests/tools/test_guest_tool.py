"""The guest's command line where there is no guest to be had: one line that says why, and an error only on CI."""

from pathlib import Path
from typing import NoReturn

import pytest

from tools.guest import __main__ as cli
from tools.guest import host, kernel, machine, tests

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A host without AF_CAN, without programs, with an empty cache."""
    monkeypatch.setattr(host, "has_can", lambda: False)
    monkeypatch.setattr(host, "SYSTEM_PATH", "")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv(host.CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.setattr("sys.argv", ["guest", "test"])


@pytest.mark.usefixtures("bare")
def test_without_its_packages_the_tests_are_skipped_with_a_line_that_names_them(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main() == 0
    said = capsys.readouterr().out
    assert said.count("\n") == 1
    assert said.startswith(
        "socketcan tests skipped: this kernel has no AF_CAN, and qemu-system-x86_64 is missing; as root: "
    )
    assert all(package in said for package in host.PACKAGES.values())


@pytest.mark.usefixtures("bare")
def test_on_ci_they_never_skip(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", "true")
    assert cli.main() == cli.NO_GUEST
    assert "is missing" in capsys.readouterr().err


@pytest.mark.usefixtures("bare")
def test_a_guest_that_breaks_is_no_skip(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(*_: object) -> NoReturn:
        raise machine.GuestLostError("the guest ended without an exit code")

    monkeypatch.setattr(cli, "_kernel", lambda: None)
    monkeypatch.setattr(machine, "run", breaks)
    assert cli.main() == cli.NO_GUEST
    assert "without an exit code" in capsys.readouterr().err


@pytest.mark.usefixtures("bare")
def test_another_processor_is_told_of_before_anything_is_fetched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    with pytest.raises(host.GuestError, match="this is aarch64"):
        kernel.fetch(host.cache_dir())
    assert not host.cache_dir().exists()


def test_the_cache_is_where_the_variable_says_or_in_the_users_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv(host.CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert host.cache_dir() == tmp_path / "fourtank-hil" / "guest"
    monkeypatch.setenv(host.CACHE_VARIABLE, str(tmp_path / "here"))
    assert host.cache_dir() == tmp_path / "here"


def test_every_file_with_the_marker_is_run() -> None:
    files = {word for word in tests.command(ROOT, []) if word.endswith(".py")}
    assert "tests/bus/test_bus_port_contract.py" in files
    assert {"tests/socketcan/test_socketcan_port.py", "tests/socketcan/test_socketcan_runs.py"} <= files
