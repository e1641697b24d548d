"""CAN interfaces come from one table: settings check, help, messages and guide name the same ones."""

import re
import tomllib
from pathlib import Path

import can
import pytest
from can.interfaces import VALID_INTERFACES
from typer.testing import CliRunner

from hil.cli.app import app
from hil.edge.can import adapters
from hil.edge.can.adapters import ADAPTERS, Adapter
from hil.edge.can.bus import BusAddress, BusError
from hil.edge.config.rig_file import load_rig
from hil.edge.config.settings_file import SettingsError
from tests.bus.bus_bench import BITRATE, IDS

ROOT = Path(__file__).resolve().parents[2]
UNKNOWN = ["sockectan", "SOCKETCAN", "slcan ", "", "can0"]


def rig_with(folder: Path, interface: str) -> Path:
    text = (ROOT / "config/rig.toml").read_text()
    assert tomllib.loads(text)["bus"]["interface"] == "socketcan"
    path = folder / "rig.toml"
    path.write_text(re.sub(r'interface = "socketcan"', f'interface = "{interface}"', text))
    return path


@pytest.mark.parametrize("interface", UNKNOWN)
def test_an_unknown_interface_is_refused_with_the_list_of_known_ones(interface: str) -> None:
    """It used to reach python-can, which names no other; a typing error looked like a missing driver."""
    with pytest.raises(BusError, match=f"bus interface {interface!r} is unknown") as caught:
        BusAddress(interface, "can0", BITRATE)
    for name in VALID_INTERFACES:
        assert re.search(rf"\b{name}\b", str(caught.value)), name


@pytest.mark.parametrize("interface", UNKNOWN)
def test_the_rig_file_refuses_it_too_with_file_and_key(tmp_path: Path, interface: str) -> None:
    path = rig_with(tmp_path, interface)
    with pytest.raises(SettingsError) as caught:
        load_rig(path)
    assert str(path) in str(caught.value)
    assert "bus.interface" in str(caught.value)
    assert "socketcan, slcan, virtual" in str(caught.value)


@pytest.mark.parametrize("interface", sorted(VALID_INTERFACES))
def test_the_rig_file_takes_every_interface_of_the_table_and_of_python_can(tmp_path: Path, interface: str) -> None:
    assert load_rig(rig_with(tmp_path, interface)).bus.interface == interface
    assert adapters.find(interface).needs


def test_every_row_of_the_table_is_an_interface_of_python_can() -> None:
    assert set(ADAPTERS) <= VALID_INTERFACES


@pytest.mark.parametrize("interface", sorted(VALID_INTERFACES - set(ADAPTERS) - {"udp_multicast"}))
def test_an_interface_of_python_can_without_its_driver_is_one_clear_error(interface: str) -> None:
    """Backends without their driver raise errors of every kind: NameError, AttributeError, ImportError..."""
    with pytest.raises(BusError) as caught:
        BusAddress(interface, "no such channel", BITRATE).open(IDS)
    assert str(caught.value).startswith(f"bus {interface} 'no such channel' at 500000 bit/s can't be opened: ")
    assert str(caught.value).endswith(f"(see python-can's documentation of {interface} for its driver and channel)")


@pytest.mark.parametrize(
    ("interface", "number"), [(name, number) for name, adapter in ADAPTERS.items() for number in adapter.hints]
)
def test_each_error_that_is_known_has_its_hint(interface: str, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    row = ADAPTERS[interface]

    def failing(*_: object) -> can.BusABC:
        raise OSError(number, "the system says no")

    failing_row = Adapter(row.channel, row.needs, failing, row.hints, row.default_hint)
    monkeypatch.setitem(ADAPTERS, interface, failing_row)
    with pytest.raises(BusError) as caught:
        BusAddress(interface, "x", BITRATE).open(IDS)
    assert str(caught.value).endswith(f"the system says no ({row.hints[number]})")


@pytest.mark.parametrize("command", ["run", "doctor", "conformance"])
def test_the_help_names_every_row_and_what_its_channel_may_be(command: str) -> None:
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "400", "NO_COLOR": "1"}).output
    words = " ".join(re.sub(r"[^ -~]", " ", shown).split())
    assert adapters.known() in words
    assert adapters.channels() in words


def test_the_guide_has_the_rows_of_the_table() -> None:
    text = (ROOT / "docs/how-to/real-bus.md").read_text()
    for name, adapter in ADAPTERS.items():
        assert f"| `{name}` | {adapter.channel} | {adapter.needs} |" in text
