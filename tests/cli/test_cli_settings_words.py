"""Wrong settings are said in the words of the file; nothing of the library that checks them shows through."""

from __future__ import annotations

import datetime
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import Field, ValidationError

from firmware_sim import settings as emulator
from hil.campaigns.spec import Spec
from hil.edge.config.complaints import NAME_WORDS, accepted
from hil.edge.config.rig_file import Rig
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import Section, SettingsError, validated
from tests.cli.cli_bench import CONFIG, CommandLine, assert_refused, config_copy

SCENARIO = """
[scenario]
name = "all"
duration_s = 10.0
[[reference]]
at_s = 1.0
change_V = [0.1, 0.1]
[[reference]]
at_s = 2.0
levels_V = [0.1, 0.1]
[[reference]]
at_s = 3.0
levels_cm = [0.1, 0.1]
[[fault]]
at_s = 1.0
kind = "pump_effectiveness"
target = 1
value = 0.5
until_s = 4.0
[[request]]
at_s = 1.0
action = "manual"
voltage_V = [1.0, 1.0]
[[request]]
at_s = 2.0
action = "bypass"
interlock = "dry_run"
for_s = 5.0
[diagnosis]
method = "glr"
delay_s = 1.0
[control]
reconfigure = true
design = "rig"
[[window]]
name = "w"
from_s = 0.0
to_s = 2.0
[rig]
pumps.lag_s = 1.0
[emulator]
pumps.lag_s = 1.0
"""
CAMPAIGN = """
[campaign]
name = "all"
scenarios = ["a.toml"]
first_seed = 1
seeds = 3
duration_s = 4.0
[diagnosis]
method = "glr"
[[fault]]
onset_s = [1.0, 2.0]
lasts_s = 3.0
kind = "leak"
targets = [1, [1, 2]]
values = [1.0]
ramps_s = [1.0]
also.until_s = 1
[pairs]
onset_s = [1.0, 2.0]
lasts_s = 3.0
pool = [{ kind = "leak", targets = [1], value_range = [1.0, 2.0] }, { kind = "leak", targets = [1], also = {} }]
"""
FILES: dict[str, tuple[type[Section], str]] = {
    "rig": (Rig, (CONFIG / "rig.toml").read_text()),
    "scenario": (Scenario, SCENARIO),
    "campaign": (Spec, CAMPAIGN),
}
WRONG: tuple[Any, ...] = (
    None,
    True,
    "no!",
    -3,
    1e9,
    3.5,
    10**400,
    float("inf"),
    float("nan"),
    [],
    [1.0],
    [1.0] * 9,
    ["a"],
)
WRONG += ({}, {"other": 1}, datetime.date(2026, 1, 1))
OF_THE_LIBRARY = r"Input|Field|Value error|valid |[Tt]uple|[Dd]ict|instance|NoneType|pydantic"


def places(value: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Every key and entry below a value."""
    below = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, one in below:
        yield (*at, key)
        yield from places(one, (*at, key))


def changed(value: Any, at: tuple[str | int, ...], *new: Any) -> Any:
    """A copy with another value at this place; without the place when there is no new value."""
    key, *rest = at
    items = value.items() if isinstance(value, dict) else enumerate(value)
    kept = {k: v for k, v in items if k != key or rest or new}
    if key in kept:
        kept[key] = changed(kept[key], tuple(rest), *new) if rest else new[0]
    return kept if isinstance(value, dict) else list(kept.values())


@pytest.mark.parametrize("name", FILES)
def test_every_wrong_value_of_every_key_is_said_in_the_files_words(name: str) -> None:
    """Messages used to be the library's: "Field required (and 11 more)", "Input should be a valid tuple"."""
    model, text = FILES[name]
    data = tomllib.loads(text)
    model.model_validate(data)
    kinds: set[str] = set()
    for place in places(data):
        for wrong in [changed(data, place), *(changed(data, place, value) for value in WRONG)]:
            try:
                model.model_validate(wrong)
            except ValidationError as error:
                kinds.update(detail["type"] for detail in error.errors())
                with pytest.raises(SettingsError) as refusal:
                    validated(model, wrong, "file.toml")
                line = str(refusal.value)
                assert not re.search(OF_THE_LIBRARY, line), line
                assert re.match(r"file\.toml: (missing: )?[a-z]", line), line
                assert len(line) < 800, line
    assert {"missing", "extra_forbidden", "model_type", "float_type", "finite_number", "tuple_type"} <= kinds


@pytest.mark.parametrize(
    ("name", "place", "value", "line"),
    [
        (
            "rig",
            "pumps",
            {"lag_s": -1},
            "missing: pumps.gain_cm3_Vs, pumps.valve_split, pumps.range_V, pumps.rate_V_s (and 1 more to correct)",
        ),
        (
            "rig",
            "pumps.range_V",
            [1.0],
            "pumps.range_V = [1.0]: must be a list of 2, each a number at least 0 and at most 10",
        ),
        ("rig", "pumps.gain_cm3_Vs", [1.0, "a"], "pumps.gain_cm3_Vs[1] = 'a': must be a number above 0"),
        ("rig", "pumps.colour", 1, "pumps.colour = 1: unknown key"),
        ("rig", "bus.bitrate", 5, "bus.bitrate = 5: must be a whole number at least 10000 and at most 1000000"),
        (
            "rig",
            "control.output_poles",
            [-1.0, -1.0, -20.0, 1.0],
            "control.output_poles[2] = -20.0: must be a number at least -10 and below 0 (and 1 more to correct)",
        ),
        ("rig", "safety.dead_pump", "maybe", "safety.dead_pump = 'maybe': must be one of 'continue', 'stop'"),
        ("scenario", "scenario", 3, "scenario = 3: must be a table"),
        (
            "scenario",
            "scenario.duration_s",
            float("inf"),
            "scenario.duration_s = inf: must be finite: a number above 0 and at most 10000000 or 'open'",
        ),
        (
            "scenario",
            "scenario.name",
            "a b",
            f"scenario.name = 'a b': {NAME_WORDS}",
        ),
        ("scenario", "control.reconfigure", "yes", "control.reconfigure = 'yes': must be true or false"),
        (
            "campaign",
            "pairs.onset_s",
            [[1], 2.0],
            "pairs.onset_s[0] = [1]: must be a number at least 0",
        ),
        (
            "campaign",
            "campaign.scenarios",
            [],
            "campaign.scenarios = []: must be a list, each entry a text, with at least 1",
        ),
    ],
)
def test_lines(name: str, place: str, value: object, line: str) -> None:
    model, text = FILES[name]
    table, *key = place.split(".")
    data = tomllib.loads(text)
    wrong = {**data, table: {**data[table], key[0]: value} if key else value}
    with pytest.raises(SettingsError) as refusal:
        validated(model, wrong, "file.toml")
    assert str(refusal.value) == f"file.toml: {line}"


def test_an_alternative_is_said_as_one_thing() -> None:
    """The library names each alternative of a union in a message of its own."""
    with pytest.raises(SettingsError) as refusal:
        validated(
            Spec, {**tomllib.loads(CAMPAIGN), "fault": [{"onset_s": [1, 2], "kind": "leak", "targets": [1.5]}]}, "c"
        )
    assert str(refusal.value) == (
        "c: fault[0].targets[0] = 1.5: must be a whole number or a text or a list, each entry a whole number or a text"
    )
    assert accepted(Annotated[float, Field(gt=0.0)] | None) == "a number above 0"


FILES_OF = {
    "rig.toml": "a rig file",
    "emulator.toml": "an emulator file",
    "scenarios/paper.toml": "a scenario",
    "campaigns/leaks.toml": "a campaign",
}


@pytest.mark.parametrize("file", FILES_OF)
def test_a_file_of_another_kind_is_named_as_that(file: str, command_line: CommandLine, tmp_path: Path) -> None:
    """A rig file given as a scenario used to be "scenario: Field required (and 6 more)"."""
    path, said = CONFIG / file, f"{file}: is {FILES_OF[file]}, not a"
    if FILES_OF[file] != "a scenario":
        assert_refused(command_line("hil", "simulate", path), said, "not a scenario; ")
        assert_refused(command_line("firmware-sim", "--pty", "--scenario", path), said, "not a scenario")
    if FILES_OF[file] in ("a rig file", "an emulator file"):
        assert_refused(command_line("hil", "campaign", path), said, "not a campaign; it is used ")
    config = config_copy(tmp_path / "config")
    for name in {"rig.toml", "emulator.toml"} - {file}:
        (config / name).write_bytes(path.read_bytes())
        result = command_line("hil", "simulate", "paper", "--config", config)
        assert_refused(result, f"{name}: is {FILES_OF[file]}, not {FILES_OF[name]}")
        (config / name).write_bytes((CONFIG / name).read_bytes())


def test_a_wrong_truth_value_of_the_emulator(tmp_path: Path) -> None:
    """It used to be "input should be a valid boolean"."""
    config = config_copy(
        tmp_path / "config", file="emulator.toml", old="hold_until_run = true", new="hold_until_run = 1"
    )
    with pytest.raises(emulator.SettingsError, match=r"tanks\.hold_until_run = 1: must be true or false"):
        emulator.load(config / "emulator.toml")
