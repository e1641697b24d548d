"""Bad input: exit code 2, one line that names file and key, nothing left behind, nothing moved."""

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.cli.cli_bench import CONFIG, CommandLine, assert_refused, config_copy, run_script, scenario_text
from tests.live.live_bench import lone_adapter

BAD_SCENARIOS = {
    "unknown table": ("[surprise]\nx = 1", "surprise"),
    "unknown key of a table": ("[diagnosis]\nmethods = 'ideal'", "diagnosis.methods", "unknown key"),
    "unknown key of the rig": ("[rig]\npumps.colour = 1", "[rig]", "pumps.colour", "unknown key"),
    "NaN": ("[rig]\npumps.lag_s = nan", "pumps.lag_s = nan", "finite"),
    "infinity": ("[[reference]]\nat_s = 1.0\nchange_V = [inf, 0.0]", "reference[0].change_V[0] = inf", "finite"),
    "NaN as a share": (
        "[[fault]]\nat_s = 1.0\nkind = 'pump_effectiveness'\ntarget = 1\nvalue = nan",
        "fault[0].value = nan",
    ),
    "endless run": ("[scenario]\nname = 'x'\nduration_s = inf", "scenario.duration_s = inf"),
    "no run": (
        "[scenario]\nname = 'x'\nduration_s = 0.0",
        "scenario.duration_s = 0.0",
        "must be a number above 0 and at most 10000000",
    ),
    "text for a number": (
        "[scenario]\nname = 'x'\nduration_s = '5'",
        "scenario.duration_s = '5'",
        "must be a number above 0",
    ),
    "number for a table": ("[rig]\npumps = 1", "pumps = 1"),
    "number for text": ("[scenario]\nname = 5\nduration_s = 5.0", "scenario.name = 5"),
    "truth value for a number": ("[rig]\npumps.lag_s = true", "pumps.lag_s = True"),
    "missing key": ("[scenario]\nname = 'x'", "missing: scenario.duration_s"),
    "misspelt key": (
        "[scenario]\nname = 'x'\nduration = 5.0",
        "missing: scenario.duration_s; unknown key: scenario.duration",
    ),
    "fault without its value": (
        "[[fault]]\nat_s = 1.0\nkind = 'pump_effectiveness'\ntarget = 1",
        "fault[0].value: ",
        "is missing",
    ),
    "short list": ("[rig]\ncontrol.operating_point_V = [3.0]", "control.operating_point_V"),
    "swapped pump range": ("[rig]\npumps.range_V = [10.0, 0.0]", "pumps.range_V = [10.0, 0.0]", "lower limit 10"),
    "swapped sensor range": ("[rig]\nsensors.range_V = [10.24, 1.0]", "sensors.range_V", "lower limit 10.24"),
    "swapped window": (
        "[[window]]\nname = 'w'\nfrom_s = 4.0\nto_s = 2.0",
        "window[0]",
        "to_s 2 is not after from_s 4",
    ),
    "repeated window": (2 * "[[window]]\nname = 'w'\nfrom_s = 1.0\nto_s = 2.0\n", "window names", "repeat"),
    "references out of order": (
        "[[reference]]\nat_s = 5.0\nchange_V = [0.1, 0.1]\n[[reference]]\nat_s = 2.0\nchange_V = [0.1, 0.1]",
        "reference times [5.0, 2.0] do not ascend",
    ),
    "reference said twice": (
        "[[reference]]\nat_s = 5.0\nchange_V = [0.1, 0.1]\nlevels_cm = [12.0, 12.0]",
        "reference[0]",
        "change_V, levels_cm",
    ),
    "operating point above the pumps": (
        "[rig]\ncontrol.operating_point_V = [11.0, 3.0]",
        "control.operating_point_V[0] = 11.0",
        "10",
    ),
    "operating point over the rim": (
        "[rig]\ncontrol.operating_point_V = [9.0, 9.0]",
        "control.operating_point_V [9.0, 9.0]",
        "0..19 cm",
    ),
    "operating point with empty tanks": (
        "[rig]\ncontrol.operating_point_V = [0.0, 0.0]",
        "control.operating_point_V [0.0, 0.0]",
        "0..19 cm",
    ),
    "reference above the range in V": (
        "[[reference]]\nat_s = 1.0\nlevels_V = [11.0, 3.0]",
        "reference[0]: leads to 11, 3 V",
        "outside 0..9.5 V",
    ),
    "reference over the rim in cm": (
        "[[reference]]\nat_s = 1.0\nlevels_cm = [12.0, 25.0]",
        "reference[0]: leads to 6, 12.5 V",
        "outside 0..9.5 V",
    ),
    "references that add up over the rim": (
        "[[reference]]\nat_s = 1.0\nchange_V = [3.0, 0.0]\n[[reference]]\nat_s = 2.0\nchange_V = [3.0, 0.0]",
        "reference[1]",
        "outside 0..9.5 V",
    ),
    "references that add up below the floor": (
        "[[reference]]\nat_s = 1.0\nchange_V = [0.0, -9.0]",
        "reference[0]",
        "outside 0..9.5 V",
    ),
    "fault of a pump that is not there": (
        "[[fault]]\nat_s = 1.0\nkind = 'pump_effectiveness'\ntarget = 3\nvalue = 0.5",
        "fault[0].target = 3",
        "1",
        "2",
    ),
    "pump better than new": (
        "[[fault]]\nat_s = 1.0\nkind = 'pump_effectiveness'\ntarget = 1\nvalue = 1.5",
        "fault[0].value = 1.5",
        "1",
    ),
    "fault of an unknown kind": (
        "[[fault]]\nat_s = 1.0\nkind = 'pump_on_fire'\ntarget = 1\nvalue = 0.5",
        "fault[0].kind = 'pump_on_fire'",
        "pump_effectiveness",
    ),
    "fault that ends before it began": (
        "[[fault]]\nat_s = 5.0\nuntil_s = 2.0\nkind = 'pump_effectiveness'\ntarget = 1\nvalue = 0.5",
        "fault[0]",
        "at_s",
    ),
    "unknown design": ("[control]\ndesign = 'magic'", "control.design = 'magic'", "calibrated"),
    "unknown method": ("[diagnosis]\nmethod = 'oracle'", "diagnosis.method = 'oracle'", "ideal"),
    "name that leaves the folder": ("[scenario]\nname = '../x'\nduration_s = 5.0", "scenario.name = '../x'"),
    "absolute name": ("[scenario]\nname = '/tmp/x'\nduration_s = 5.0", "scenario.name = '/tmp/x'"),
    "hidden name": ("[scenario]\nname = '.x'\nduration_s = 5.0", "scenario.name = '.x'"),
    "name with a line end": ('[scenario]\nname = "x\\n"\nduration_s = 5.0', r"scenario.name = 'x\n'"),
    "poles that can't be had": (
        "[rig]\ncontrol.output_poles = [-0.2, -0.2, -0.2, -0.2]",
        "rig.toml",
        "control",
        "pole -0.2",
    ),
    "pole on the wrong side": (
        "[rig]\ncontrol.output_poles = [-0.2, -0.1, -0.05, 0.01]",
        "control.output_poles[3] = 0.01",
    ),
    "noise bound that can't be met": ("[rig]\ncontrol.noise_gain_max = 1e-9", "rig.toml", "noise gain 1e-09"),
    "valves that can't be decoupled": ("[rig]\npumps.valve_split = [0.5, 0.49]", "rig.toml", "too near to 1"),
    "trip level over the rim": ("[rig]\nsafety.level_max_cm = 25.0", "safety.level_max_cm 25", "tanks.height_cm 20"),
    "not TOML": ("hello [scenario] world", "is not TOML", "line 1"),
}

BAD_EMULATOR_TABLES = {
    "unknown key": ("[emulator]\npumps.colour = 1", "emulator.pumps.colour = 1", "unknown key"),
    "NaN": ("[emulator]\npumps.lag_s = nan", "emulator.pumps.lag_s = nan", "0 .. 60"),
    "wrong type": ("[emulator]\nnodes.boot_s = 'soon'", "emulator.nodes.boot_s = 'soon'"),
    "wrong bits": ("[emulator]\npumps.dac_bits = 13", "emulator.pumps.dac_bits = 13", "12"),
    "start above the pumps": ("[emulator]\ntanks.start_V = [11.0, 3.0]", "emulator.tanks.start_V[0] = 11.0", "0 .. 10"),
    "start over the rim": ("[emulator]\ntanks.start_V = [9.0, 9.0]", "tanks.start_V = [9.0, 9.0]", "0 .. 20 cm"),
}

BAD_FILES = {
    "rig.toml": {
        "unknown key": ("[pumps]", "[pumps]\ncolour = 1", "pumps.colour = 1", "unknown key"),
        "unknown table": ("[pumps]", "[extra]\nx = 1\n[pumps]", "extra", "unknown key"),
        "NaN": ("height_cm = 20.0", "height_cm = nan", "tanks.height_cm = nan", "finite"),
        "infinity": ("period_s = 0.1", "period_s = inf", "control.period_s = inf"),
        "wrong type": ("lag_s = 0.2", "lag_s = 'slow'", "pumps.lag_s = 'slow'", "must be a number at least 0"),
        "swapped limits": ("range_V = [0.0, 10.0]", "range_V = [10.0, 0.0]", "pumps.range_V = [10.0, 0.0]"),
        "missing key": ("gravity_cm_s2 = 981.0", "", "missing: tanks.gravity_cm_s2"),
        "operating point": (
            "operating_point_V = [3.0, 3.0]",
            "operating_point_V = [11.0, 3.0]",
            "control.operating_point_V[0] = 11.0",
        ),
        "bit rate": ("bitrate = 500000", "bitrate = 5", "bus.bitrate = 5", "10000"),
        "not TOML": ("[tanks]", "[tanks", "is not TOML", "line"),
    },
    "emulator.toml": {
        "unknown key": ("[pumps]", "[pumps]\ncolour = 1", "pumps.colour = 1", "unknown key"),
        "infinity": ("watchdog_s = 0.25", "watchdog_s = inf", "nodes.watchdog_s = inf", "0.01 .. 10"),
        "wrong type": ("hold_until_run = true", "hold_until_run = 1", "tanks.hold_until_run = 1"),
        "missing key": ("lag_s = 0.2", "", "pumps.lag_s", "missing"),
        "start over the rim": ("start_V = [3.0, 3.0]", "start_V = [9.0, 9.0]", "tanks.start_V", "0 .. 20 cm"),
        "not TOML": ("[tanks]", "[tanks", "is not valid TOML", "line"),
    },
    "bench.dbc": {
        "frame missing": ("BO_ 385 PumpStatus", "BO_ 385 PumpState", "has no frame PumpStatus"),
        "signal missing": ("SG_ Level1 :", "SG_ Height1 :", "LowerLevels", "Level1"),
        "no data id": ('BA_ "DataId" BO_ 513 10497;', 'BA_ "DataId" BO_ 513 70000;', "PumpCommand", "DataId 70000"),
        "counter of another width": ("SG_ Counter : 36|4@1+", "SG_ Counter : 36|3@1+", "Counter", "0..15"),
        "not a DBC": ("BO_ 513", "hello", "is not a DBC"),
    },
}


def bad_files(*files: str) -> list[Any]:
    return [
        pytest.param(file, *case[:2], case[2:], id=f"{file}: {name}")
        for file in files
        for name, case in BAD_FILES[file].items()
    ]


def cases(table: dict[str, tuple[str, ...]]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(
        ("text", "named"), [pytest.param(case[0], case[1:], id=name) for name, case in table.items()]
    )


@pytest.fixture
def before(tmp_path: Path) -> Iterator[Path]:
    """Asserts afterwards that the command has made no file or folder."""
    (tmp_path / "scenario.toml").touch()
    yield tmp_path / "scenario.toml"
    assert sorted(p.name for p in tmp_path.iterdir() if p.name != "config") == ["scenario.toml"], "something was left"


@cases({**BAD_SCENARIOS, **{f"emulator, {name}": case for name, case in BAD_EMULATOR_TABLES.items()}})
def test_simulate_refuses_a_bad_scenario(
    command_line: CommandLine, before: Path, text: str, named: tuple[str, ...]
) -> None:
    before.write_text(scenario_text(more=text))
    assert_refused(command_line("hil", "simulate", before), before, *named)


@cases(BAD_SCENARIOS)
def test_run_refuses_a_bad_scenario_before_it_opens_a_bus(
    command_line: CommandLine, before: Path, text: str, named: tuple[str, ...]
) -> None:
    before.write_text(scenario_text(more=text))
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        nobody.setblocking(False)
        channel = f"socket://127.0.0.1:{nobody.getsockname()[1]}"
        assert_refused(command_line("hil", "run", before, "-i", "slcan", "-c", channel), before, *named)
        with pytest.raises(BlockingIOError):
            nobody.accept()


@cases(
    {
        **BAD_EMULATOR_TABLES,
        **{
            name: case
            for name, case in BAD_SCENARIOS.items()
            if "fault" in name or name in ("not TOML", "NaN as a share")
        },
    }
)
def test_the_emulator_refuses_its_part_of_a_bad_scenario(
    command_line: CommandLine, before: Path, text: str, named: tuple[str, ...]
) -> None:
    before.write_text(scenario_text(more=text))
    named = tuple(what for what in named if what != "is not TOML")
    assert_refused(command_line("firmware-sim", "--slcan", 0, "--scenario", before), before, *named)


@pytest.mark.parametrize(("file", "old", "new", "named"), bad_files("rig.toml", "emulator.toml", "bench.dbc"))
def test_simulate_refuses_a_bad_configuration_file(
    command_line: CommandLine, before: Path, tmp_path: Path, file: str, old: str, new: str, named: tuple[str, ...]
) -> None:
    before.write_text(scenario_text())
    config = config_copy(tmp_path / "config", file=file, old=old, new=new)
    assert_refused(command_line("hil", "simulate", before, "--config", config), config / file, *named)


@pytest.mark.parametrize(("file", "old", "new", "named"), bad_files("rig.toml", "bench.dbc"))
def test_run_refuses_a_bad_configuration_file(
    command_line: CommandLine, before: Path, tmp_path: Path, file: str, old: str, new: str, named: tuple[str, ...]
) -> None:
    before.write_text(scenario_text())
    config = config_copy(tmp_path / "config", file=file, old=old, new=new)
    assert_refused(command_line("hil", "run", before, "--config", config), config / file, *named)


@pytest.mark.parametrize(("file", "old", "new", "named"), bad_files("rig.toml"))
@pytest.mark.usefixtures("before")
def test_design_refuses_a_bad_rig_file(
    command_line: CommandLine, tmp_path: Path, file: str, old: str, new: str, named: tuple[str, ...]
) -> None:
    config = config_copy(tmp_path / "config", file=file, old=old, new=new)
    assert_refused(command_line("hil", "design", "--config", config, "--out", tmp_path / "x"), config / file, *named)


@pytest.mark.parametrize(("file", "old", "new", "named"), bad_files("emulator.toml"))
@pytest.mark.usefixtures("before")
def test_the_emulator_refuses_a_bad_file_of_its_own(
    command_line: CommandLine, tmp_path: Path, file: str, old: str, new: str, named: tuple[str, ...]
) -> None:
    config = config_copy(tmp_path / "config", file=file, old=old, new=new)
    arguments = ("--slcan", 0, "--config", config, "--record", tmp_path / "x")
    assert_refused(command_line("firmware-sim", *arguments), config / file, *named)


@pytest.mark.parametrize("file", ["rig.toml", "emulator.toml", "bench.dbc"])
@pytest.mark.parametrize("kind", ["missing", "directory", "not text"])
def test_a_configuration_file_that_can_not_be_read_is_named(
    command_line: CommandLine, before: Path, tmp_path: Path, file: str, kind: str
) -> None:
    before.write_text(scenario_text())
    config = config_copy(tmp_path / "config")
    (config / file).unlink()
    if kind == "directory":
        (config / file).mkdir()
    elif kind == "not text":
        (config / file).write_bytes(b"\xff\xfe\x00")
    assert_refused(command_line("hil", "simulate", before, "--config", config), config / file)
    if file != "rig.toml":
        assert_refused(command_line("firmware-sim", "--slcan", 0, "--config", config), config / file)


@pytest.mark.parametrize("command", [("hil", "simulate"), ("hil", "run"), ("firmware-sim", "--slcan", 0, "--scenario")])
@pytest.mark.parametrize("kind", ["missing", "directory", "not text"])
def test_a_scenario_that_can_not_be_read_is_named(
    command_line: CommandLine, tmp_path: Path, command: tuple[Any, ...], kind: str
) -> None:
    scenario = tmp_path / "there.toml"
    if kind == "directory":
        scenario.mkdir()
    elif kind == "not text":
        scenario.write_bytes(b"\xff\xfe\x00")
    assert_refused(command_line(*command, scenario), scenario)


@pytest.mark.parametrize("command", ["simulate", "run"])
def test_a_folder_that_exists_is_not_touched(command_line: CommandLine, tmp_path: Path, command: str) -> None:
    scenario = tmp_path / "s.toml"
    scenario.write_text(scenario_text())
    out = tmp_path / "taken"
    out.mkdir()
    with lone_adapter() as (channel, sent):
        bus = ("-i", "slcan", "-c", channel) if command == "run" else ()
        assert_refused(command_line("hil", command, scenario, "--out", out, *bus), out, "exists already")
    assert sent == []
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("command", ["simulate", "design"])
def test_a_folder_that_can_not_be_made_is_named(command_line: CommandLine, tmp_path: Path, command: str) -> None:
    """/proc takes no folders from anybody, root included."""
    scenario = tmp_path / "s.toml"
    scenario.write_text(scenario_text())
    out = "/proc/here/x"
    assert_refused(command_line("hil", command, *([scenario] if command == "simulate" else []), "--out", out), out)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_leave_to_write_is_named(command_line: CommandLine, tmp_path: Path) -> None:
    scenario = tmp_path / "s.toml"
    scenario.write_text(scenario_text())
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    assert_refused(command_line("hil", "simulate", scenario, "--out", locked / "x"), locked / "x")


BAD_OPTIONS = {
    "negative duration": ("hil", ("simulate", "{s}", "--duration", "-1"), "--duration"),
    "NaN duration": ("hil", ("simulate", "{s}", "--duration", "nan"), "--duration"),
    "endless duration": ("hil", ("simulate", "{s}", "--duration", "inf"), "--duration"),
    "duration in words": ("hil", ("run", "{s}", "--duration", "long"), "--duration"),
    "negative seed": ("hil", ("simulate", "{s}", "--seed", "-1"), "--seed"),
    "bit rate too low": ("hil", ("run", "{s}", "-b", "5"), "--bitrate", "10000"),
    "bit rate too high": ("hil", ("run", "{s}", "-b", "2000000"), "--bitrate", "1000000"),
    "no scenario": ("hil", ("simulate",), "SCENARIO"),
    "unknown option": ("hil", ("run", "{s}", "--fast"), "--fast"),
    "unknown command": ("hil", ("fly",), "fly"),
    "no folder": ("hil", ("report",), "DIR"),
    "no service": ("firmware-sim", (), "--slcan", "--pty"),
    "two services": ("firmware-sim", ("--slcan", "0", "--pty"), "exactly one"),
    "port too high": ("firmware-sim", ("--slcan", "99999"), "--slcan", "65535"),
    "bus without a channel": ("firmware-sim", ("-i", "virtual"), "-c"),
    "channel without a bus": ("firmware-sim", ("--pty", "-c", "x"), "-i"),
    "record into nowhere": ("firmware-sim", ("--slcan", "0", "--record", "nowhere/x"), "--record nowhere/x"),
    "record over a file": ("firmware-sim", ("--slcan", "0", "--record", "{s}"), "--record {s}", "exists"),
    "emulator on an unknown bus": ("firmware-sim", ("-i", "telepathy", "-c", "x"), "telepathy", "not supported"),
}


@pytest.mark.parametrize("option", ["--slcan", "--control"])
def test_a_port_that_is_taken_is_named_with_what_to_do(command_line: CommandLine, option: str) -> None:
    """It used to be "Address already in use"."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        arguments = ("--slcan", port) if option == "--slcan" else ("--slcan", 0, "--control", port)
        result = command_line("firmware-sim", *arguments)
    assert_refused(result, f"{option} {port}: another program uses it", "end that one, or choose another")


@pytest.mark.parametrize("case", BAD_OPTIONS.values(), ids=BAD_OPTIONS.keys())
def test_a_bad_option_is_refused_in_one_line(command_line: CommandLine, before: Path, case: tuple[Any, ...]) -> None:
    before.write_text(scenario_text())
    name, arguments, *named = case
    filled = [argument.format(s=before) for argument in arguments]
    assert_refused(command_line(name, *filled), *(what.format(s=before) for what in named))


def nobody_listens_there() -> str:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"socket://127.0.0.1:{server.getsockname()[1]}"


BAD_BUSES = {
    "unknown interface": ("telepathy", "mind", (), "telepathy", "socketcan, slcan, virtual"),
    "port nobody listens on": ("slcan", nobody_listens_there(), (), "slcan", "refused"),
    "device that is not there": ("slcan", "/dev/nothing", (), "/dev/nothing", "No such file"),
    "file for a device": ("slcan", str(CONFIG / "rig.toml"), (), "rig.toml"),
    "unknown protocol": ("slcan", "smoke://signal", (), "smoke://signal", "not known"),
}


@pytest.mark.parametrize("case", BAD_BUSES.values(), ids=BAD_BUSES.keys())
def test_run_refuses_a_bus_that_can_not_be_opened(
    command_line: CommandLine, before: Path, case: tuple[Any, ...]
) -> None:
    before.write_text(scenario_text())
    interface, channel, options, *named = case
    assert_refused(command_line("hil", "run", before, "-i", interface, "-c", channel, *options), "bus", *named)


def test_a_bit_rate_that_the_adapter_does_not_know_is_named(command_line: CommandLine, before: Path) -> None:
    before.write_text(scenario_text())
    with socket.create_server(("127.0.0.1", 0)) as server:
        channel = f"socket://127.0.0.1:{server.getsockname()[1]}"
        result = command_line("hil", "run", before, "-i", "slcan", "-c", channel, "-b", 123_456)
    assert_refused(result, channel, "123456", "500000")


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        ("socket://127.0.0.1", "socket://HOST:PORT"),
        ("socket://127.0.0.1:x", "socket://HOST:PORT"),
        ("can0", "-i socketcan"),
        ("/dev/null", "no serial device"),
    ],
)
def test_a_channel_that_slcan_can_not_have_is_explained(
    command_line: CommandLine, before: Path, channel: str, words: str
) -> None:
    """A missing port once gave: '<=' not supported between instances of 'int' and 'NoneType'."""
    before.write_text(scenario_text())
    assert_refused(command_line("hil", "run", before, "-i", "slcan", "-c", channel), channel, words)


def test_an_option_out_of_range_is_named_with_value_and_range(command_line: CommandLine, before: Path) -> None:
    """The message once was the library's, with neither the value nor the other limit."""
    before.write_text(scenario_text())
    result = command_line("hil", "run", before, "-b", 1)
    assert_refused(result, "--bitrate", ": 1:", "at least 10000 and at most 1000000")
    assert_refused(command_line("hil", "simulate", before, "--duration", -5), "--duration", "-5", "at least 0")


def test_the_emulators_console_without_a_panel_is_refused(command_line: CommandLine, before: Path) -> None:
    """The option was accepted and did nothing."""
    before.write_text(scenario_text())
    assert_refused(command_line("hil", "run", before, "--emulator", "emulator.sock"), "emulator.sock", "--panel")


def test_an_unknown_scenario_of_the_emulator_is_answered_by_the_shipped_names(command_line: CommandLine) -> None:
    """It once said only that a file can't be read."""
    result = command_line("firmware-sim", "--slcan", 0, "--scenario", "pumploss")
    assert_refused(result, "pumploss", "pump_loss", "paper_glr")


def test_a_kernel_without_socketcan_is_named(command_line: CommandLine, before: Path) -> None:
    with contextlib.suppress(OSError):
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
        pytest.skip("this kernel has SocketCAN")
    before.write_text(scenario_text())
    assert_refused(command_line("hil", "run", before), "socketcan", "can0", "no SocketCAN")
    assert_refused(command_line("firmware-sim", "-i", "socketcan", "-c", "can0"), "socketcan", "no SocketCAN")


def test_the_console_scripts_themselves_end_in_one_line(tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text(scenario_text(more="[rig]\npumps.colour = 1"))
    out = tmp_path / "x"
    assert_refused(run_script("hil", "simulate", bad, "--out", out), bad, "pumps.colour = 1", "unknown key")
    assert_refused(run_script("hil", "simulate", bad, "--duration", -1), "--duration")
    assert_refused(run_script("firmware-sim", "--slcan", 0, "--scenario", tmp_path), tmp_path)
    assert not out.exists()


def test_hil_alone_shows_its_help(command_line: CommandLine) -> None:
    result = command_line("hil")
    assert result.code == 2
    assert result.err == ""
    assert all(name in result.out for name in ("simulate", "run", "design", "report", "view", "demo"))
