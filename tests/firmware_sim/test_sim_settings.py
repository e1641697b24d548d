"""Settings: every wrong input is one line that names file, key, value and what is allowed."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from pydantic import BaseModel

from firmware_sim.faults.catalogue import KINDS, as_text
from firmware_sim.settings import (
    EmulatorSettings,
    SettingsError,
    default_config_dir,
    equilibrium_cm,
    load,
    load_fingerprint,
)
from tests.firmware_sim.sim_bench import CONFIG, run_emulator

EMULATOR = (CONFIG / "emulator.toml").read_text()

BAD_EMULATOR = [
    ("lag_s = 0.2", "lag_s = 0.2\ncolour = 3", ["pumps.colour", "unknown key"]),
    ("[tanks]", "[extra]\n[tanks]", ["extra", "unknown key"]),
    ("height_cm = 20.0", "", ["tanks.height_cm", "missing"]),
    ("height_cm = 20.0", "height_cm = nan", ["tanks.height_cm = nan", "1 .. 1000"]),
    ("height_cm = 20.0", "height_cm = inf", ["tanks.height_cm = inf", "1 .. 1000"]),
    ("height_cm = 20.0", 'height_cm = "20"', ["tanks.height_cm = '20'", "number in 1 .. 1000"]),
    ("height_cm = 20.0", "height_cm = true", ["tanks.height_cm = True", "number in 1 .. 1000"]),
    ("height_cm = 20.0", "height_cm = 0.5", ["tanks.height_cm = 0.5", "outside 1 .. 1000"]),
    ("area_cm2 = [28.0,", "area_cm2 = [-1.0,", ["tanks.area_cm2[0] = -1.0", "0.1 .. 100000"]),
    ("start_V = [3.0, 3.0]", "start_V = [3.0]", ["tanks.start_V = [3.0]", "list of 2"]),
    ("start_V = [3.0, 3.0]", "start_V = [3.0, 10.5]", ["tanks.start_V[1] = 10.5", "0 .. 10"]),
    ("start_V = [3.0, 3.0]", "start_V = [9.0, 9.0]", ["tanks.start_V", "0 .. 20 cm"]),
    ("hold_until_run = true", "hold_until_run = 1", ["tanks.hold_until_run = 1", "true or false"]),
    ("valve_split = [0.70,", "valve_split = [1.70,", ["pumps.valve_split[0] = 1.7", "0 .. 1"]),
    ("dac_bits = 12", "dac_bits = 11", ["pumps.dac_bits = 11", "0, 8, 10, 12, 14, 16"]),
    ("adc_bits = 12", "adc_bits = 12.0", ["sensors.adc_bits = 12.0", "0, 12, 16"]),
    ("watchdog_s = 0.25", "watchdog_s = -0.25", ["nodes.watchdog_s = -0.25", "0.01 .. 10"]),
    ("[nodes]", "[nodes", ["not valid TOML"]),
    ("parameter_spread = 0.0", "parameter_spread = 0.6", ["emulator.toml: parameter_spread = 0.6", "0 .. 0.5"]),
    ("lag_s = 0.2", "lag_s = [0.2]", ["pumps.lag_s = [0.2]", "number in 0 .. 60, or a list of 2"]),
    ("lag_s = 0.2", "lag_s = [0.2, 61.0]", ["pumps.lag_s = [0.2, 61.0]", "number in 0 .. 60, or a list of 2"]),
    ("lag_spread = 0.0", "lag_spread = -0.1", ["pumps.lag_spread = -0.1", "0 .. 1"]),
    ("wear_per_h = 0.0", "wear_per_h = true", ["pumps.wear_per_h = True", "number in 0 .. 10, or a list of 2"]),
    ("scale_error = 0.0", "scale_error = nan", ["sensors.scale_error = nan", "-0.5 .. 0.5"]),
    ("scale_error = 0.0", "scale_error = [0.1, 0.1]", ["sensors.scale_error = [0.1, 0.1]", "a list of 4"]),
    ("sqrt_s = 0.0", "sqrt_s = -1.0", ["tanks.turbulence_cm3_sqrt_s = -1.0", "0 .. 100"]),
]

BAD_SCENARIO = [
    ("[emulator]\npumps.lag_s = -1.0", ["emulator.pumps.lag_s = -1.0", "0 .. 60"]),
    ("[emulator]\npumps.nix = 1", ["emulator.pumps.nix = 1", "unknown key"]),
    ("[emulator]\nnix = 1", ["emulator.nix = 1", "unknown key"]),
    ("[emulator]\npumps = 3", ["emulator.pumps = 3", "table"]),
    ("[emulator]\ntanks.start_V = [9.0, 9.0]", ["tanks.start_V", "0 .. 20 cm"]),
    ("[emulator]\npumps.valve_split = [0.5, 2.0]", ["emulator.pumps.valve_split[1] = 2.0", "0 .. 1"]),
    ("emulator = 3", ["emulator = 3", "table"]),
    ("fault = 3", ["fault = 3", "[[fault]]"]),
    ("fault = [3]", ["fault[0] = 3", "table"]),
    ("[[fault]]\nat_s = 1.0\ntarget = 1\nvalue = 0.4", ["fault[0].kind", "missing"]),
    (
        '[[fault]]\nat_s = 1.0\ntarget = 1\nvalue = 0.4\nkind = "flood"',
        ["fault[0].kind = 'flood'", "pump_effectiveness"],
    ),
    ("GOOD\n[[fault]]\nat_s = nan\ntarget = 1\nvalue = 0.4\nKIND", ["fault[1].at_s = nan", "0 .. 1e+07"]),
    ("[[fault]]\nat_s = 1.0\ntarget = 3\nvalue = 0.4\nKIND", ["fault[0].target = 3", "1, 2"]),
    ("[[fault]]\nat_s = 1.0\ntarget = 1\nvalue = 1.4\nKIND", ["fault[0].value = 1.4", "0 .. 1"]),
    ("[[fault]]\nat_s = 1.0\ntarget = 1\nvalue = 0.4\nsize = 2\nKIND", ["fault[0].size = 2", "unknown key"]),
    ("[[fault]]\nat_s = 1.0\nuntil_s = 1.0\ntarget = 1\nvalue = 0.4\nKIND", ["fault[0].until_s = 1.0", "later than"]),
    ("[emulator", ["not valid TOML"]),
    ("[emulator]\nparameter_spread = 2.0", ["emulator.parameter_spread = 2.0", "0 .. 0.5"]),
    ('[[fault]]\nat_s = 1.0\ntarget = 1\nkind = "pump_lag"', ["fault[0].value", "missing"]),
    ('[[fault]]\nat_s = 1.0\nvalue = 1\ntarget = 1\nkind = "pump_dead"', ["fault[0].value = 1", "unknown key"]),
    ('[[fault]]\nat_s = 1.0\ntarget = 5\nkind = "sensor_open"', ["fault[0].target = 5", "1, 2, 3, 4"]),
    ('[[fault]]\nat_s = 1.0\nvalue = -11\ntarget = 1\nkind = "sensor_bias"', ["value = -11", "-10.24 .. 10.24"]),
    ('[[fault]]\nat_s = 1.0\ntarget = "Levels"\nkind = "frame_reorder"', ["target = 'Levels'", "LowerLevels", "all"]),
    ('[[fault]]\nat_s = 1.0\nvalue = 1.5\ntarget = "all"\nkind = "frame_burst"', ["value = 1.5", "whole number"]),
    ('[[fault]]\nat_s = 1.0\nvalue = 0\ntarget = "all"\nkind = "frame_burst"', ["value = 0", "1 .. 100000"]),
    ('[[fault]]\nat_s = 1.0\ntarget = 1\nkind = "node_reboot"', ["fault[0].target = 1", "pump, level"]),
    ('[[fault]]\nat_s = 1.0\nvalue = 9000\nkind = "babble"', ["fault[0].value = 9000", "0.1 .. 4000"]),
    ("[[fault]]\nat_s = 1.0\nkind = 3", ["fault[0].kind = 3", "must be one of"]),
]
KIND = 'kind = "pump_effectiveness"'
GOOD_FAULT = f"[[fault]]\nat_s = 1.0\ntarget = 1\nvalue = 0.4\n{KIND}"


def complaint(file: Path, base: Path, scenario: Path | None = None) -> str:
    with pytest.raises(SettingsError) as caught:
        load(base, scenario)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{file}: ")
    return message


@pytest.mark.parametrize(("old", "new", "expected"), BAD_EMULATOR)
def test_bad_emulator_file(tmp_path: Path, old: str, new: str, expected: list[str]) -> None:
    file = tmp_path / "emulator.toml"
    assert old in EMULATOR
    file.write_text(EMULATOR.replace(old, new, 1))
    message = complaint(file, file)
    assert all(part in message for part in expected), message


@pytest.mark.parametrize(("text", "expected"), BAD_SCENARIO)
def test_bad_scenario_file(tmp_path: Path, text: str, expected: list[str]) -> None:
    file = tmp_path / "scenario.toml"
    file.write_text(text.replace("GOOD", GOOD_FAULT).replace("KIND", KIND))
    message = complaint(file, CONFIG / "emulator.toml", file)
    assert all(part in message for part in expected), message


def test_a_fault_of_the_base_file_is_not_blamed_on_the_scenario(tmp_path: Path) -> None:
    base, scenario = tmp_path / "emulator.toml", tmp_path / "scenario.toml"
    base.write_text(EMULATOR.replace("height_cm = 20.0", "height_cm = -1.0"))
    scenario.write_text("[emulator]\ntanks.gravity_cm_s2 = 981.0")
    assert "tanks.height_cm = -1.0" in complaint(base, base, scenario)


def test_missing_files_are_named(tmp_path: Path) -> None:
    nothing = tmp_path / "nothing.toml"
    assert "No such file" in complaint(nothing, nothing)
    assert "No such file" in complaint(nothing, CONFIG / "emulator.toml", nothing)
    nothing.write_bytes(b"\xff\xfe")
    assert "UTF-8" in complaint(nothing, nothing)


def test_scenario_overrides_deeply_and_leaves_the_rest() -> None:
    plain, none = load(CONFIG / "emulator.toml")
    ideal, faults = load(CONFIG / "emulator.toml", CONFIG / "scenarios/paper_ideal.toml")
    assert none == ()
    assert (ideal.pumps.lag_s, ideal.pumps.dac_bits, ideal.sensors.adc_bits) == (0.0, 0, 0)
    assert ideal.pumps.gain_cm3_Vs == plain.pumps.gain_cm3_Vs
    assert ideal.tanks == plain.tanks
    assert [(fault.at_s, fault.target, getattr(fault, "value", None)) for fault in faults] == [
        (200.0, 1, 0.4),
        (200.0, 2, 0.4),
    ]
    assert equilibrium_cm(ideal) == equilibrium_cm(plain)


def test_tables_of_the_controller_are_not_looked_at(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text("[control]\nnonsense = true\n[rig]\npumps.lag_s = -3.0\n" + GOOD_FAULT)
    assert len(load(CONFIG / "emulator.toml", scenario)[1]) == 1


def test_a_byte_order_mark_is_read_as_if_it_were_not_there(tmp_path: Path) -> None:
    """Editors of Windows put one at the start of a file; TOML then had an invalid statement in line 1, column 1."""
    mark = b"\xef\xbb\xbf"
    scenario = CONFIG / "scenarios/paper_ideal.toml"
    marked = {}
    for file in (CONFIG / "emulator.toml", scenario, CONFIG / "bench.dbc"):
        marked[file.name] = tmp_path / file.name
        marked[file.name].write_bytes(mark + file.read_bytes())
    assert load(marked["emulator.toml"], marked["paper_ideal.toml"]) == load(CONFIG / "emulator.toml", scenario)
    assert load_fingerprint(marked["bench.dbc"]) == load_fingerprint(CONFIG / "bench.dbc")
    marked["bench.dbc"].write_bytes(mark + b"other" + (CONFIG / "bench.dbc").read_bytes())
    assert load_fingerprint(marked["bench.dbc"]) != load_fingerprint(CONFIG / "bench.dbc")


def test_config_directory_of_a_checkout_is_found() -> None:
    assert default_config_dir() == CONFIG


def test_help_begins_with_an_example() -> None:
    command = [sys.executable, "-m", "firmware_sim", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 0
    assert "\n\n  Example: firmware-sim --slcan 29536 --scenario paper\n\n" in done.stdout


def test_the_fault_kinds_are_listed_with_their_ranges() -> None:
    done = run_emulator("--faults")
    assert done.returncode == 0
    assert done.stdout == as_text()
    assert [line.split()[0] for line in done.stdout.splitlines()] == list(KINDS)


COMMAND_LINES = [
    ([], "exactly one of --slcan, --pty and -i"),
    (["--pty", "--slcan", "0"], "exactly one of --slcan, --pty and -i"),
    (["--slcan", "70000"], "--slcan"),
    (["--slcan", "zero"], "--slcan"),
    (["--pty", "-b", "500000"], "-c and -b belong to -i"),
    (["-i", "virtual"], "needs a channel"),
    (["-i", "no_such", "-c", "x"], "-i no_such -c x"),
    (["-i", "slcan", "-c", "/nowhere/tty"], "-i slcan -c /nowhere/tty"),
    (["--pty", "--scenario", "no_such"], "--scenario no_such: no such file, and no shipped name"),
    (["--pty", "--config", "/nowhere"], "/nowhere/emulator.toml: cannot be read"),
    (["--pty", "--record", "/nowhere/x.jsonl"], "--record /nowhere/x.jsonl"),
    (["--pty", "--seed", "-1"], "--seed"),
    (["--what"], "--what"),
]


@pytest.mark.parametrize(("arguments", "expected"), COMMAND_LINES, ids=lambda part: str(part))
def test_bad_command_line_is_exit_code_2_and_one_line(arguments: list[str], expected: str) -> None:
    done = run_emulator(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert expected in done.stderr


def test_bad_settings_are_exit_code_2_and_one_line_and_leave_no_record(tmp_path: Path) -> None:
    (tmp_path / "emulator.toml").write_text(EMULATOR.replace("lag_s = 0.2", "lag_s = nan"))
    (tmp_path / "bench.dbc").write_text("")
    record = tmp_path / "changes.jsonl"
    done = run_emulator("--pty", "--config", tmp_path, "--record", record)
    assert done.returncode == 2
    assert done.stderr == f"firmware-sim: {tmp_path}/emulator.toml: pumps.lag_s = nan: is outside 0 .. 60\n"
    assert not record.exists()


def test_an_existing_record_is_refused_and_left_alone(tmp_path: Path) -> None:
    record = tmp_path / "changes.jsonl"
    record.write_text("precious")
    done = run_emulator("--pty", "--record", str(record))
    assert done.returncode == 2
    assert "File exists" in done.stderr
    assert record.read_text() == "precious"


def test_a_key_that_may_be_left_out_is_what_the_shipped_file_says(tmp_path: Path) -> None:
    """A file from before the key was there describes the same rig."""
    lines = (CONFIG / "emulator.toml").read_text().splitlines(keepends=True)
    shipped, _ = load(CONFIG / "emulator.toml")
    left_out = []
    for number, line in enumerate(lines):
        key = line.partition(" = ")[0]
        file = tmp_path / "emulator.toml"
        file.write_text("".join(lines[:number] + lines[number + 1 :]))
        with suppress(SettingsError):  # the key is required, or the line is a table's head
            if load(file)[0] == shipped:
                left_out.append(key)
    assert set(optional_keys(EmulatorSettings)) <= set(left_out)


def optional_keys(table: type[BaseModel]) -> Iterator[str]:
    for key, field in table.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from optional_keys(field.annotation)
        elif not field.is_required():
            yield key
