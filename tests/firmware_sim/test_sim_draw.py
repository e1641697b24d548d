"""The rig's truth: parameters drawn by the seed, sensors off scale, turbulence, wear."""

from pathlib import Path

import numpy as np
import pytest

from firmware_sim.parameter_spread import drawn
from firmware_sim.rig import Rig
from firmware_sim.settings import EmulatorSettings, SettingsError, equilibrium_cm, load
from tests.firmware_sim.fault_bench import QUIET, drive, level_volts, rig_with
from tests.firmware_sim.sim_bench import CONFIG, SECOND, emulator, shipped


def spread(settings: EmulatorSettings, share: float) -> EmulatorSettings:
    return settings.model_copy(update={"parameter_spread": share})


def test_without_spreads_nothing_is_drawn() -> None:
    assert drawn(shipped(), 5) == shipped()


def test_parameters_lie_within_their_spread_and_fill_it() -> None:
    ratios = []
    for seed in range(200):
        own, nominal = drawn(spread(shipped(), 0.03), seed), shipped()
        ratios.append(
            [
                *np.divide(own.tanks.outlet_cm2, nominal.tanks.outlet_cm2),
                *np.divide(own.pumps.gain_cm3_Vs, nominal.pumps.gain_cm3_Vs),
                *np.divide(own.pumps.valve_split, nominal.pumps.valve_split),
            ]
        )
        assert own.tanks.area_cm2 == nominal.tanks.area_cm2
        assert own.pumps.lag_s == nominal.pumps.lag_s
    deviation = np.array(ratios) - 1.0
    assert np.abs(deviation).max() <= 0.03
    assert deviation.std(axis=0) == pytest.approx(0.03 / np.sqrt(3.0), rel=0.12)
    assert np.abs(np.corrcoef(deviation.T) - np.eye(8)).max() < 0.25


def test_the_same_seed_draws_the_same_rig_and_starts_in_its_own_equilibrium() -> None:
    settings = spread(shipped(), 0.03)
    first, again, other = (Rig(settings, (), seed, 0) for seed in (4, 4, 5))
    assert first.parameters == again.parameters != other.parameters
    assert first.truth().levels_cm == equilibrium_cm(first.parameters)
    assert first.truth().levels_cm != equilibrium_cm(settings)


def test_a_valve_split_stays_within_its_limits() -> None:
    settings = spread(emulator(pumps={"valve_split": [1.0, 0.0]}), 0.5)
    for seed in range(20):
        assert all(0.0 < split < 1.0 for split in drawn(settings, seed).pumps.valve_split)


def test_lags_are_one_value_one_each_or_drawn() -> None:
    assert drawn(emulator(pumps={"lag_s": [0.1, 0.4]}), 1).pumps.lag_s == (0.1, 0.4)
    lags = drawn(emulator(pumps={"lag_s": 0.2, "lag_spread": 0.5}), 1).pumps.lag_s
    assert isinstance(lags, tuple)
    assert len(set(lags)) == 2
    assert all(0.1 <= lag <= 0.3 for lag in lags)
    rig = rig_with(settings=emulator(pumps={"lag_s": [0.0, 1.0]}))
    drive(rig, 1.0)
    assert rig._tanks.flow_V == pytest.approx((3.0, 3.0 * (1 - np.exp(-1.0))), abs=0.002)


@pytest.mark.parametrize("errors", [[0.02, -0.03, 0.0, 0.1]])
def test_a_given_scale_error_is_that_of_its_sensor(errors: list[float]) -> None:
    settings = emulator(sensors={"noise_V": 0.0, "adc_bits": 16, "scale_error": errors})
    frames = drive(rig_with(settings=settings), 0.1)
    for tank, level_cm in enumerate(equilibrium_cm(settings), start=1):
        assert level_volts(frames, tank)[0] == pytest.approx(0.5 * level_cm * (1.0 + errors[tank - 1]), abs=3e-4)


def test_a_scale_error_of_one_number_is_drawn_for_each_sensor() -> None:
    errors = drawn(emulator(sensors={"scale_error": 0.02}), 3).sensors.scale_error
    assert isinstance(errors, tuple)
    assert len(set(errors)) == 4
    assert all(-0.02 <= error <= 0.02 for error in errors)


def test_turbulence_has_its_intensity_and_keeps_the_balance() -> None:
    """A volume that random flow brings in grows with the square root of time, before the outlets take it back."""
    settings = emulator(
        tanks={"turbulence_cm3_sqrt_s": [4.0, 0.0, 0.0, 0.0], "outlet_cm2": [1e-4] * 4, "start_V": [0.0, 0.0]},
        pumps={"lag_s": 0.0},
    )
    levels = []
    for seed in range(150):
        rig = Rig(settings, (), seed, 0)
        drive(rig, 0.0)
        rig._tanks.levels_cm = (10.0, 10.0, 0.0, 0.0)
        rig.pump.applied_V = (0.0, 0.0)
        rig._follow_pump(rig.now_ns)
        start_cm3 = rig._tanks.contents_cm3
        rig.advance(rig.now_ns + 4 * SECOND)
        tanks = rig._tanks
        levels.append(tanks.levels_cm)
        gone_cm3 = tanks.drained_cm3 + tanks.spilled_cm3 - tanks.pumped_cm3
        assert tanks.contents_cm3 - start_cm3 == pytest.approx(tanks.stirred_cm3 - gone_cm3, abs=1e-9)
    std_cm = np.std([level[0] for level in levels])
    assert std_cm == pytest.approx(4.0 * np.sqrt(4.0) / 28.0, rel=0.15)
    assert np.std([level[1] for level in levels]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("tank", [1, 2, 3, 4])
def test_turbulence_of_one_tank_alone_stirs_that_tank(tank: int) -> None:
    intensity = [0.5 if tank == one else 0.0 for one in (1, 2, 3, 4)]
    calm, stirred = (Rig(emulator(tanks={"turbulence_cm3_sqrt_s": each}), (), 1, 0) for each in (0.0, intensity))
    for rig in (calm, stirred):
        drive(rig, 3.0)
        rig.advance(rig.now_ns + SECOND)
    moved = [a != b for a, b in zip(calm._tanks.levels_cm, stirred._tanks.levels_cm, strict=True)]
    assert moved[tank - 1]
    assert stirred._tanks.stirred_cm3 != 0.0


def test_wear_takes_its_share_of_the_gain_per_hour() -> None:
    rig = rig_with(
        settings=QUIET.model_copy(update={"pumps": QUIET.pumps.model_copy(update={"wear_per_h": (3.6, 0.0)})})
    )
    drive(rig, 100.0)
    first, second = rig.truth().effectiveness
    assert first == pytest.approx(1.0 - 3.6 * 100.0 / 3600.0, abs=1e-4)
    assert second == 1.0


def test_a_start_that_the_spread_may_bring_above_the_rim_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "emulator.toml"
    text = (CONFIG / "emulator.toml").read_text().replace("parameter_spread = 0.0", "parameter_spread = 0.3", 1)
    file.write_text(text)
    with pytest.raises(SettingsError, match=r"start_V = \[3.0, 3.0\]: with parameter_spread = 0.3 can give a level"):
        load(file)
    file.write_text(text.replace("parameter_spread = 0.3", "parameter_spread = 0.05"))
    for seed in range(50):
        assert max(Rig(load(file)[0], (), seed, 0).truth().levels_cm) < 20.0
