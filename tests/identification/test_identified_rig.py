"""From an identification to a rig file: values, digits, uncertainty, and what must follow them."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hil.core.identification.parameters import RigModel
from hil.core.identification.result import FittedParameter
from hil.core.sensors import LevelSensors
from hil.core.tanks import TankModel, equilibrium
from hil.edge.config.identified_rig import FLOORS, identified_rig, rounded
from hil.edge.config.rig_file_writer import read_rig_text
from hil.edge.config.settings_file import SettingsError
from tests.identification.result_bench import TRUE, fitted, identification, undetermined, with_value

RIG = Path(__file__).resolve().parents[2] / "config" / "rig.toml"


def _parameter(value: float, sd: float, was: float = 1.0) -> FittedParameter:
    return FittedParameter("k1", value, value - 1.96 * sd, value + 1.96 * sd, "cm3/Vs", was, "identified")


def _file(**changes: Any) -> dict[str, Any]:
    return tomllib.loads(identified_rig(identification(**changes), read_rig_text(RIG)).text)


def test_the_identified_values_are_in_the_file_and_it_loads() -> None:
    found = identified_rig(identification(), read_rig_text(RIG))
    assert found.rig is not None
    assert found.trouble == ""
    assert found.rig.tank_model.pump_gain_cm3_Vs == TRUE.tanks.pump_gain_cm3_Vs
    assert found.rig.tank_model.valve_split == TRUE.tanks.valve_split
    assert found.rig.tank_model.outlet_cm2 == TRUE.tanks.outlet_cm2
    assert found.rig.lags_s == TRUE.lag_s
    assert found.rig.pump_path.dead_zone_V == (0.31, 0.0)
    assert "+gain_cm3_Vs = [3.057, 3.41]" in found.diff()


@pytest.mark.parametrize(
    ("value", "sd", "written"),
    [
        (3.0512345, 0.003, 3.051),
        (3.0512345, 0.0003, 3.0512),
        (0.07123456, 1e-5, 0.071235),
        (0.3123, 0.4, 0.3),
        (3.0512345678, 1e-9, 3.05123),
        (3.0512345678, 0.0, 3.05123),
        (3.0512345678, math.inf, 3.05123),
    ],
)
def test_no_more_digits_than_the_interval_justifies(value: float, sd: float, written: float) -> None:
    assert rounded(_parameter(value, sd)) == written
    assert sd in (0.0, 1e-9) or abs(written - value) <= 0.25 * sd


def test_a_value_that_stayed_keeps_its_digits() -> None:
    assert rounded(_parameter(3.3333333, 0.1, was=3.3333333)) == 3.3333333


def test_uncertainty_is_that_of_the_intervals_but_no_less_than_the_floor() -> None:
    wide = with_value(identification(), "k1", low=3.057 - 1.96 * 0.0612, high=3.057 + 1.96 * 0.0612)
    table = tomllib.loads(identified_rig(wide, read_rig_text(RIG)).text)["uncertainty"]
    assert table["pump_gain"] == [0.021, FLOORS["pump_gain"]], "rounded up"
    assert table["outlet"] == FLOORS["outlet"]


def test_uncertainty_of_what_is_not_identifiable_stays() -> None:
    table = tomllib.loads(identified_rig(undetermined(), read_rig_text(RIG)).text)["uncertainty"]
    assert table["pump_gain"] == 0.03


def test_a_very_uncertain_value_is_within_what_the_file_allows() -> None:
    table = _file(parameters=tuple(replace(one, low=-9.0, high=9.0) for one in fitted(TRUE)))["uncertainty"]
    assert table["valve_split"] == 1.0
    assert table["lag"] == 5.0


def test_operating_voltages_stay_where_their_levels_are_in_the_tanks() -> None:
    found = identified_rig(identification(), read_rig_text(RIG))
    assert found.rig is not None
    assert found.rig.control.operating_point_V == (3.0, 3.0)
    assert found.notes == ()


def _with_model(model: RigModel) -> Any:
    return identification(model=model, parameters=fitted(model))


def test_operating_voltages_that_would_fill_a_tank_are_replaced_by_those_that_hold_the_old_levels() -> None:
    strong = replace(TRUE, tanks=replace(TRUE.tanks, pump_gain_cm3_Vs=(4.4, 4.3)))
    found = identified_rig(_with_model(strong), read_rig_text(RIG))
    assert found.rig is not None
    before_cm = equilibrium(TankModel(), (3.0, 3.0))
    now_cm = equilibrium(found.rig.tank_model, found.rig.operating_drives)
    assert now_cm[:2] == pytest.approx(before_cm[:2], rel=0.02)
    (note,) = found.notes
    assert "The old operating voltages 3, 3 V would hold" in note
    assert "hold the old levels of tanks 1 and 2: 12.3, 12.8 cm" in note


def test_a_rig_that_can_not_hold_the_old_levels_gets_lower_ones() -> None:
    """Nearly all water of pump 1 goes to tank 1, which is nearly blocked; tank 2 gets little."""
    model = replace(TRUE, tanks=replace(TRUE.tanks, valve_split=(0.95, 0.9), outlet_cm2=(0.03, 0.2, 0.072, 0.056)))
    found = identified_rig(_with_model(model), read_rig_text(RIG))
    (note,) = found.notes
    assert "lower levels than before" in note or "no voltages were found" in note
    assert (found.rig is None) == ("no voltages were found" in note)


def test_a_file_that_no_run_can_use_says_why() -> None:
    model = replace(TRUE, tanks=replace(TRUE.tanks, valve_split=(0.5, 0.5)))
    found = identified_rig(_with_model(model), read_rig_text(RIG))
    assert found.rig is None
    assert "within 0.01 of 1" in found.trouble


def test_the_trip_level_falls_where_a_sensor_can_not_show_it() -> None:
    """With a gain 5 % larger and an offset, sensor 3 would leave its range below the old trip level."""
    sensors = LevelSensors((0.5, 0.5, 0.53, 0.5), (0.0, 0.0, 0.3, 0.0))
    found = identified_rig(_with_model(replace(TRUE, sensors=sensors)), read_rig_text(RIG))
    assert found.rig is not None
    assert found.rig.safety.level_max_cm == 18.7
    assert "Sensor 3 can't show a level above 18.75 cm" in found.notes[0]


def test_noise_is_written_when_it_has_changed() -> None:
    assert _file(model=replace(TRUE, noise_V=(0.0052, 0.005, 0.0049, 0.005)))["sensors"]["noise_V"] == 0.005
    other = _file(model=replace(TRUE, noise_V=(0.00812, 0.005, 0.0049, 0.005)))
    assert other["sensors"]["noise_V"] == [0.0081, 0.005, 0.0049, 0.005]


def test_what_a_rig_file_can_not_say_is_said() -> None:
    found = with_value(identification(), "overflow3", value=0.6, low=0.5, high=0.7, status="identified")
    assert "overflow3 = 0.6" in identified_rig(found, read_rig_text(RIG)).notes[0]


def test_another_gain_of_the_level_signals_is_said() -> None:
    old = read_rig_text(RIG).replace("gain_V_cm = 0.5 ", "gain_V_cm = 0.45")
    model = replace(TRUE, sensors=LevelSensors((0.45, 0.46, 0.45, 0.45)))
    assert "0.5 V/cm now and had 0.45 V/cm" in identified_rig(_with_model(model), old).notes[-1]


def test_a_file_of_another_kind_is_refused() -> None:
    with pytest.raises(SettingsError, match="the old rig file"):
        identified_rig(identification(), "[scenario]\nname = 'x'\n")
