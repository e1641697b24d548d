"""A rig file as the emulator's truth: which values are the rig's, which stay, and what wrong files are told."""

import tomllib
from pathlib import Path

import pytest

from firmware_sim.rig_file import OPTIONAL, REQUIRED, find_rig
from firmware_sim.settings import EmulatorSettings, SettingsError, equilibrium_cm, load
from tests.firmware_sim.sim_bench import CONFIG

EMULATOR = CONFIG / "emulator.toml"
MINUS = CONFIG / "rigs" / "johansson_minus.toml"
PLUS = CONFIG / "rigs" / "johansson_plus.toml"


def rig_file(folder: Path, old: str = "", new: str = "") -> Path:
    text = MINUS.read_text()
    assert old in text
    file = folder / "mine.toml"
    file.write_text(text.replace(old, new, 1))
    return file


def test_tanks_pumps_and_sensors_are_those_of_the_rig() -> None:
    settings, _ = load(EMULATOR, None, PLUS)
    rig = tomllib.loads(PLUS.read_text())
    for table, key in REQUIRED:
        value = rig[table][key]
        assert getattr(getattr(settings, table), key) == (tuple(value) if isinstance(value, list) else value)
    assert settings.tanks.start_V == (3.15, 3.15)
    assert equilibrium_cm(settings) == pytest.approx((12.6, 13.0, 4.8, 4.9), abs=0.2), (
        "the levels that the paper prints"
    )


def test_what_a_rig_file_cannot_say_stays_as_in_the_emulators_file(tmp_path: Path) -> None:
    emulator = tmp_path / "emulator.toml"
    text = EMULATOR.read_text()
    for old, new in (
        ("dac_bits = 12", "dac_bits = 8"),
        ("wave_V = 0.0", "wave_V = 0.003"),
        ("turbulence_cm3_sqrt_s = 0.0", "turbulence_cm3_sqrt_s = 0.2"),
        ("hold_until_run = true", "hold_until_run = false"),
        ("dead_zone_V = 0.0", "dead_zone_V = 0.7"),
        ("boot_s = 0.2", "boot_s = 0.5"),
    ):
        assert old in text
        text = text.replace(old, new)
    emulator.write_text(text)
    settings, _ = load(emulator, None, MINUS)
    assert (settings.pumps.dac_bits, settings.sensors.wave_V, settings.nodes.boot_s) == (8, 0.003, 0.5)
    assert (settings.tanks.turbulence_cm3_sqrt_s, settings.tanks.hold_until_run) == (0.2, False)
    assert settings.pumps.dead_zone_V == 0.0, (
        "a rig is written once: what its file leaves out is the rig file's default"
    )


def test_a_scenario_has_priority_over_the_rig(tmp_path: Path) -> None:
    scenario = tmp_path / "own.toml"
    scenario.write_text('[scenario]\nname = "own"\nduration_s = 1.0\n[emulator]\npumps.lag_s = [0.4, 0.6]\n')
    settings, _ = load(EMULATOR, scenario, PLUS)
    assert settings.pumps.lag_s == (0.4, 0.6)
    assert settings.pumps.gain_cm3_Vs == (3.14, 3.29)


def test_every_optional_key_is_one_of_the_emulator() -> None:
    for table, key in (*REQUIRED, *OPTIONAL):
        fields = {name: EmulatorSettings.model_fields[name].annotation for name in ("tanks", "pumps", "sensors")}
        assert key in fields[table].model_fields  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("area_cm2 = [28.0,", "area_cm2 = [-1.0,", ["mine.toml: tanks.area_cm2[0] = -1.0", "0.1 .. 100000"]),
        ("lag_s = 0.2", "lag_s = 99.0", ["mine.toml: pumps.lag_s = 99.0", "0 .. 60"]),
        ("lag_s = 0.2", "", ["mine.toml: pumps.lag_s: key is missing"]),
        ("[3.0, 3.0]", "[3.0, 11.0]", ["mine.toml: control.operating_point_V[1] = 11.0", "0 .. 10"]),
        (
            "[3.0, 3.0]",
            "[9.0, 9.0]",
            ["mine.toml: control.operating_point_V = [9.0, 9.0]: gives a level of", "0 .. 20"],
        ),
        ("[tanks]", "tanks = 3\n[other]", ["mine.toml: tanks = 3: must be a table"]),
    ],
)
def test_a_wrong_rig_is_named_with_its_own_key(tmp_path: Path, old: str, new: str, named: list[str]) -> None:
    with pytest.raises(SettingsError) as error:
        load(EMULATOR, None, rig_file(tmp_path, old, new))
    assert all(part in str(error.value) for part in named), error.value


def test_another_kind_of_file_is_named_as_that() -> None:
    with pytest.raises(SettingsError, match=r"rest\.toml: is a scenario, not a rig file"):
        load(EMULATOR, None, CONFIG / "scenarios" / "rest.toml")


def test_rigs_are_found_by_path_and_by_name(tmp_path: Path) -> None:
    assert find_rig("johansson_plus", CONFIG, CONFIG) == PLUS
    assert find_rig("johansson_plus.toml", tmp_path, CONFIG) == PLUS
    assert find_rig(str(MINUS), tmp_path, CONFIG) == MINUS
    (tmp_path / "rigs").mkdir()
    own = tmp_path / "rigs" / "mine.toml"
    own.write_text(MINUS.read_text())
    assert find_rig("mine", tmp_path, CONFIG) == own
    with pytest.raises(
        SettingsError, match=r"johanson: no such file, and no shipped name; shipped rigs: .*johansson_plus"
    ):
        find_rig("johanson", CONFIG, CONFIG)
