"""What real rigs have beyond eq. (1), by its physics: pump curves, hoses, valves with play, low outlets, sensors."""

import math
import tomllib
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from firmware_sim.rig import Rig
from firmware_sim.sensor_signal import AddedSignal
from firmware_sim.settings import EmulatorSettings, SettingsError, equilibrium_cm, load
from firmware_sim.tanks import Tanks
from tests.firmware_sim.fault_bench import drive, fault, level_volts, rig_with
from tests.firmware_sim.sim_bench import CONFIG, emulator
from tests.narrowing import quad

HEALTHY = [1.0, 1.0]
EMPTY = {"start_V": [0.0, 0.0]}


def ideal(pumps: dict[str, Any] | None = None, **tables: dict[str, Any]) -> EmulatorSettings:
    """A rig without lag and converters."""
    return emulator(pumps={"lag_s": 0.0, "dac_bits": 0, **(pumps or {})}, **tables)


def imbalance_cm3(tanks: Tanks, start_cm3: float) -> float:
    given = tanks.pumped_cm3 + tanks.stirred_cm3 + tanks.caught_cm3 - tanks.drained_cm3 - tanks.spilled_cm3
    return given - (tanks.contents_cm3 - start_cm3)


def pumped_in(rig: Rig, seconds: float) -> float:
    before = rig._tanks_now().pumped_cm3
    rig.advance(rig.now_ns + round(seconds * 1e9))
    return rig._tanks_now().pumped_cm3 - before


@pytest.mark.parametrize("voltage_V", [0.0, 0.5, 0.8, 0.81, 3.0, 10.0])
def test_a_pump_gives_its_gain_times_the_curve_above_its_dead_zone(voltage_V: float) -> None:
    rig = rig_with(settings=ideal({"dead_zone_V": [0.8, 0.0], "curve_1_V": [0.03, -0.02]}))
    drive(rig, 1.0, v=(voltage_V, voltage_V))
    x = max(0.0, voltage_V - 0.8)
    expected = 3.33 * x * (1.0 + 0.03 * x) + 3.35 * voltage_V * (1.0 - 0.02 * voltage_V)
    assert pumped_in(rig, 0.1) == pytest.approx(0.1 * expected, abs=1e-9)


def test_the_rig_starts_in_the_equilibrium_of_its_curve() -> None:
    curved = ideal({"dead_zone_V": 1.0, "curve_1_V": 0.1})
    straight = ideal(tanks={"start_V": [2.0 * 1.2] * 2})
    assert equilibrium_cm(curved) == pytest.approx(equilibrium_cm(straight))
    rig = rig_with(settings=curved)
    drive(rig, 60.0)
    assert rig.truth().levels_cm == pytest.approx(equilibrium_cm(curved), abs=1e-9)


def test_a_stuck_pump_has_its_curve_too() -> None:
    rig = rig_with(fault("pump_stuck_on", 1, 0.9, at_s=0.0), settings=ideal({"dead_zone_V": 1.0}))
    drive(rig, 2.0, v=(5.0, 0.0))
    assert pumped_in(rig, 0.1) == 0.0


def test_what_a_pump_gives_arrives_later_and_otherwise_unchanged() -> None:
    """Levels of the delayed rig are those of the other one, delay_s later; the lag is the same."""
    direct, late = (
        rig_with(settings=emulator(pumps={"lag_s": 0.4, "delay_s": delay_s}, tanks=EMPTY)) for delay_s in (0.0, 0.7)
    )
    seen: dict[str, list[Any]] = {"direct": [], "late": []}
    for tenth in range(1, 60):
        v = (6.0, 4.0) if tenth < 30 else (2.0, 7.0)
        for name, rig in (("direct", direct), ("late", late)):
            drive(rig, tenth / 10, v=v)
            seen[name].append(rig.truth().levels_cm)
    assert all(levels_cm == (0.0, 0.0, 0.0, 0.0) for levels_cm in seen["late"][:7])
    assert np.array(seen["late"][7:]) == pytest.approx(np.array(seen["direct"][:-7]), abs=1e-4)


def test_each_pump_has_its_own_delay_and_a_fault_arrives_with_the_water() -> None:
    rig = rig_with(fault("pump_dead", 1, at_s=2.0), settings=ideal({"delay_s": [0.5, 0.0]}))
    drive(rig, 2.4)
    assert rig.truth().effectiveness == (0.0, 1.0)
    assert pumped_in(rig, 0.05) == pytest.approx(0.05 * 3.0 * (3.33 + 3.35))
    drive(rig, 2.5)
    assert pumped_in(rig, 0.05) == pytest.approx(0.05 * 3.0 * 3.35)


def test_every_tank_has_its_own_rim() -> None:
    tanks = Tanks(ideal(tanks={"height_cm": [20.0, 14.0, 9.0, 3.0]}))
    start_cm3 = tanks.contents_cm3
    tanks.advance(600.0, (6.0, 6.0), HEALTHY)
    assert tanks.levels_cm[1] == 14.0
    assert tanks.levels_cm[3] == 3.0
    assert tanks.spilled_cm3 > 0.0
    assert abs(imbalance_cm3(tanks, start_cm3)) < 1e-6


def low(datum_cm: list[float], **tanks: Any) -> EmulatorSettings:
    return ideal(tanks={"datum_cm": datum_cm, **tanks})


def test_the_outflow_at_level_h_is_that_of_the_head_h_plus_datum() -> None:
    """Against a precise integrator, with a leak, while no tank is empty."""
    datum = np.array([4.0, 2.0, 0.5, 1.0])
    configuration = low(datum.tolist(), outlet_cm2=[0.055, 0.045, 0.05, 0.04])
    tanks = Tanks(configuration)
    area, outlet = np.array(configuration.tanks.area_cm2), np.array(configuration.tanks.outlet_cm2)
    effects = rig_with(fault("leak", 3, 0.3, at_s=0.0))._faults.effects
    effects.leak[2] = 0.3
    tanks.apply_effects(effects)
    start, start_cm3 = tanks.levels_cm, tanks.contents_cm3

    def rates(_t: float, h: Any) -> Any:
        out = outlet * np.sqrt(2.0 * 981.0 * (h + datum))
        flow = np.array([3.33 * 4.0, 3.35 * 2.8])
        into = np.concatenate([[0.7, 0.6] * flow + out[2:], [0.4 * flow[1], 0.3 * flow[0]]])
        return (into - out * [1.0, 1.0, 1.3, 1.0]) / area

    tanks.advance(30.0, (4.0, 2.8), HEALTHY)
    precise = solve_ivp(rates, (0.0, 30.0), start, rtol=1e-10, atol=1e-10).y[:, -1]
    assert min(precise) > 0.1
    assert tanks.levels_cm == pytest.approx(precise, abs=1e-6)
    assert abs(imbalance_cm3(tanks, start_cm3)) < 1e-9


def test_equilibrium_with_low_outlets_stays_and_an_upper_tank_may_be_empty() -> None:
    configuration = low([3.0, 1.0, 40.0, 0.2])
    tanks = Tanks(configuration)
    start = tanks.levels_cm
    assert start[2] == 0.0
    assert start[0] == pytest.approx(equilibrium_cm(ideal())[0] - 3.0)
    tanks.advance(600.0, (3.0, 3.0), HEALTHY)
    assert tanks.levels_cm == pytest.approx(start, abs=1e-9)


@pytest.mark.parametrize("leak", [0.0, 0.5])
def test_an_empty_tank_with_a_low_outlet_passes_on_what_flows_in_and_no_more(leak: float) -> None:
    tanks = Tanks(low([40.0] * 4))
    effects = rig_with()._faults.effects
    effects.leak[2] = leak
    tanks.apply_effects(effects)
    tanks.advance(300.0, (0.0, 0.0), HEALTHY)
    assert tanks.levels_cm == (0.0, 0.0, 0.0, 0.0)
    drained_cm3, start_cm3 = tanks.drained_cm3, tanks.pumped_cm3
    tanks.advance(10.0, (0.0, 0.0), HEALTHY)
    assert tanks.drained_cm3 == drained_cm3, "nothing flows in"
    tanks.advance(10.0, (0.0, 1.0), HEALTHY)
    assert tanks.levels_cm == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-12)
    assert tanks.drained_cm3 - drained_cm3 == pytest.approx(tanks.pumped_cm3 - start_cm3)


def test_low_outlets_make_and_lose_no_water_when_tanks_empty_and_overflow() -> None:
    tanks = Tanks(low([40.0, 5.0, 20.0, 2.0], height_cm=[20.0, 12.0, 3.0, 2.0], overflow_to_lower=[0.5, 1.0]))
    start_cm3, random = tanks.contents_cm3, np.random.default_rng(5)
    for _ in range(60):
        v1, v2 = random.choice([0.0, 2.0, 10.0], 2).tolist()
        tanks.advance(float(random.uniform(0.0, 20.0)), (v1, v2), HEALTHY)
        assert all(0.0 <= h <= top for h, top in zip(tanks.levels_cm, (20.0, 12.0, 3.0, 2.0), strict=True))
        assert abs(imbalance_cm3(tanks, start_cm3)) < 1e-6
    assert tanks.spilled_cm3 > tanks.caught_cm3 > 0.0


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_a_share_of_an_upper_tank_s_overflow_falls_into_the_lower_one(share: float) -> None:
    """Tank 4 overflows: what falls into tank 2 is missing outside the rig."""
    tanks = Tanks(ideal(tanks={"height_cm": [20.0, 20.0, 20.0, 2.0], "overflow_to_lower": share, **EMPTY}))
    tanks.levels_cm = quad((0.0, 0.0, 0.0, 2.0))
    start_cm3 = tanks.contents_cm3
    tanks.advance(5.0, (10.0, 0.0), HEALTHY)
    over_cm3 = 5.0 * (0.3 * 33.3 - 0.057 * math.sqrt(2.0 * 981.0 * 2.0))
    assert tanks.spilled_cm3 == pytest.approx(over_cm3, rel=1e-3)
    assert tanks.caught_cm3 == pytest.approx(share * over_cm3, rel=1e-3)
    assert abs(imbalance_cm3(tanks, start_cm3)) < 1e-9


def split_of(rig: Rig) -> tuple[float, float]:
    return rig._paths.splits


def splits_after_starts(rig: Rig, starts: int) -> list[tuple[float, float]]:
    """The splits in force in each of several spells of flow, with pauses of both pumps between."""
    splits = []
    for start in range(starts):
        drive(rig, 4.0 * start + 2.0, v=(3.0, 2.0))
        splits.append(split_of(rig))
        drive(rig, 4.0 * start + 3.0, v=(4.0, 1.0))
        assert split_of(rig) == splits[-1], "a flow that only changes leaves the valve alone"
        drive(rig, 4.0 * start + 4.0, v=(0.0, 0.0))
    return splits


def test_a_valve_with_play_has_another_split_each_time_the_flow_starts() -> None:
    rig = rig_with(settings=ideal({"split_scatter": [0.02, 0.0]}), seed=3)
    splits = splits_after_starts(rig, 40)
    first = np.array([split for split, _ in splits])
    assert {split for _, split in splits} == {0.60}
    assert len(set(first)) == 40
    assert first.std() == pytest.approx(0.02 * 0.7, rel=0.3)
    assert first.mean() == pytest.approx(0.7, abs=0.01)
    again = rig_with(settings=ideal({"split_scatter": [0.02, 0.05]}), seed=3)
    assert [split for split, _ in splits_after_starts(again, 3)] == first[:3].tolist(), "of its own stream"


def test_the_water_follows_the_drawn_split_and_a_fault_of_the_valve_wins() -> None:
    rig = rig_with(fault("valve_split", 1, 0.2, at_s=5.0), settings=ideal({"split_scatter": 0.1}, tanks=EMPTY), seed=8)
    drive(rig, 0.5, v=(5.0, 0.0))
    levels_cm = rig.truth().levels_cm
    split, _ = split_of(rig)
    assert split != 0.7
    assert levels_cm[0] * 28.0 / (levels_cm[0] * 28.0 + levels_cm[3] * 32.0) == pytest.approx(split, abs=0.01)
    drive(rig, 5.5, v=(5.0, 0.0))
    before_cm = rig.truth().levels_cm
    drive(rig, 5.6, v=(5.0, 0.0))
    rise_cm = rig.truth().levels_cm[3] - before_cm[3]
    outflow_cm3 = 0.1 * 0.057 * math.sqrt(2.0 * 981.0 * before_cm[3])
    assert rise_cm * 32.0 + outflow_cm3 == pytest.approx(0.8 * 3.33 * 5.0 * 0.1, rel=0.02)


def test_a_sensor_has_its_own_gain_of_either_sign_offset_and_noise() -> None:
    settings = emulator(
        sensors={"gain_V_cm": [0.5, -0.3, 0.2, -0.1], "offset_V": [0.1, 8.0, -0.2, 1.5], "noise_V": 0.0, "adc_bits": 16}
    )
    frames = drive(rig_with(settings=settings), 0.1)
    levels_cm = equilibrium_cm(settings)
    expected = [
        offset + gain * h
        for offset, gain, h in zip((0.1, 8.0, -0.2, 1.5), (0.5, -0.3, 0.2, -0.1), levels_cm, strict=True)
    ]
    assert [level_volts(frames, tank)[0] for tank in (1, 2, 3, 4)] == pytest.approx(expected, abs=4e-4)


def test_every_sensor_has_its_own_noise() -> None:
    noise_V = [0.002, 0.05, 0.0, 0.01]
    frames = drive(rig_with(settings=ideal(sensors={"noise_V": noise_V, "adc_bits": 0})), 60.0)
    found = [float(np.std(level_volts(frames, tank))) for tank in (1, 2, 3, 4)]
    assert found == pytest.approx(noise_V, rel=0.1, abs=2e-4)


def test_waves_have_their_size_and_stay_similar_for_some_seconds_beside_the_same_noise() -> None:
    """The difference of two signals with the same seed is the waves alone; 20 minutes of them."""
    wavy, calm = (AddedSignal(ideal(sensors={"wave_V": [wave_V, 0.0, 0.0, 0.0]}), 7) for wave_V in (0.02, 0.0))
    signals_V = np.array([[wavy.next_V(), calm.next_V()] for _ in range(60_000)])
    wave_V = signals_V[:, 0] - signals_V[:, 1]
    assert not wave_V[:, 1:].any()
    wave = wave_V[:, 0]
    assert wave.std() == pytest.approx(0.02, rel=0.15)
    assert abs(wave.mean()) < 0.003
    for lag_s in (0.1, 3.0, 20.0):
        at = round(lag_s / 0.02)
        assert np.corrcoef(wave[at:], wave[:-at])[0, 1] == pytest.approx(math.exp(-lag_s / 3.0), abs=0.12)


def test_waves_reach_the_reading_and_leave_the_level() -> None:
    wavy, calm = (rig_with(settings=ideal(sensors={"wave_V": wave_V, "adc_bits": 0})) for wave_V in (0.05, 0.0))
    spread = [float(np.std(level_volts(drive(rig, 30.0), 3))) for rig in (wavy, calm)]
    assert spread[0] > 5.0 * spread[1]
    assert wavy.truth().levels_cm == calm.truth().levels_cm


def test_a_file_without_the_new_keys_is_the_same_rig() -> None:
    new = {
        "dead_zone_V",
        "curve_1_V",
        "split_scatter",
        "delay_s",
        "datum_cm",
        "overflow_to_lower",
        "offset_V",
        "wave_V",
    }
    values = tomllib.loads((CONFIG / "emulator.toml").read_text())
    old = {
        name: {key: value for key, value in table.items() if key not in new} if isinstance(table, dict) else table
        for name, table in values.items()
    }
    assert sum(len(table) for table in values.values() if isinstance(table, dict)) - 8 == sum(
        len(table) for table in old.values() if isinstance(table, dict)
    )
    assert EmulatorSettings.model_validate(old) == EmulatorSettings.model_validate(values)


REFUSALS = [
    ("pumps.dead_zone_V = -0.1", "pumps.dead_zone_V = -0.1: is outside 0 .. 9"),
    ("pumps.dead_zone_V = [0.1, 0.2, 0.3]", "must be a number in 0 .. 9, or a list of 2 of them"),
    ("pumps.curve_1_V = -0.06", "pumps.curve_1_V = -0.06: is outside -0.05 .. 1"),
    ("pumps.delay_s = 11.0", "pumps.delay_s = 11.0: is outside 0 .. 10"),
    ("pumps.split_scatter = [0.1, 0.6]", "must be a number in 0 .. 0.5, or a list of 2 of them"),
    ("tanks.height_cm = [20.0, 20.0, 0.5, 20.0]", "must be a number in 1 .. 1000, or a list of 4 of them"),
    ("tanks.datum_cm = -1.0", "tanks.datum_cm = -1.0: is outside 0 .. 1000"),
    ("tanks.overflow_to_lower = 1.1", "tanks.overflow_to_lower = 1.1: is outside 0 .. 1"),
    ("sensors.gain_V_cm = 0.0", "sensors.gain_V_cm = 0.0: is outside ±(0.01 .. 10)"),
    ("sensors.gain_V_cm = [0.5, 0.5, 0.5, -11.0]", "must be a number in ±(0.01 .. 10), or a list of 4 of them"),
    ("sensors.offset_V = nan", "sensors.offset_V = nan: is outside -20 .. 20"),
    ("sensors.noise_V = [0.1, 0.1]", "must be a number in 0 .. 1, or a list of 4 of them"),
    ("sensors.wave_V = -0.1", "sensors.wave_V = -0.1: is outside 0 .. 1"),
]


def test_a_start_above_the_rim_of_one_tank_is_refused(tmp_path: Any) -> None:
    scenario = tmp_path / "low.toml"
    scenario.write_text("[emulator.tanks]\nheight_cm = [20.0, 12.0, 20.0, 20.0]\n")
    with pytest.raises(SettingsError, match=r"start_V = .* gives a level of 12\.78 cm, which is outside 0 \.\. 12 cm"):
        load(CONFIG / "emulator.toml", scenario)


@pytest.mark.parametrize(("line", "expected"), REFUSALS)
def test_a_value_out_of_range_is_refused_with_file_key_and_range(line: str, expected: str, tmp_path: Any) -> None:
    scenario = tmp_path / "odd.toml"
    scenario.write_text(f"[emulator]\n{line}\n")
    with pytest.raises(SettingsError) as caught:
        load(CONFIG / "emulator.toml", scenario)
    assert str(caught.value).startswith(f"{scenario}: ")
    assert expected in str(caught.value)
