"""Each fault of the level sensors, by what is on the wire."""

from typing import Any

import can
import numpy as np
import pytest

from firmware_sim.faults.base import Fault
from tests.firmware_sim.fault_bench import channel_status, drive, fault, level_volts, rig_with

ADC_STEP_V = 10.24 / 4096


def frames_with(*faults: Fault, until_s: float = 3.0, **more: Any) -> list[can.Message]:
    return drive(rig_with(*faults, **more), until_s)


@pytest.mark.parametrize("tank", [1, 2, 3, 4])
@pytest.mark.parametrize("value", [-0.2, 0.3])
def test_sensor_bias(tank: int, value: float) -> None:
    healthy, faulty = frames_with(), frames_with(fault("sensor_bias", tank, value))
    change_V = np.array(level_volts(faulty, tank, 1.0)) - np.array(level_volts(healthy, tank, 1.0))
    assert change_V == pytest.approx(value, abs=ADC_STEP_V)
    assert level_volts(faulty, tank, 0.0, 1.0) == level_volts(healthy, tank, 0.0, 1.0)
    assert set(channel_status(faulty, tank)) == {0}


def test_sensor_bias_of_one_channel_leaves_the_others_alone() -> None:
    healthy, faulty = frames_with(), frames_with(fault("sensor_bias", 2, 1.0))
    for tank in (1, 3, 4):
        assert level_volts(faulty, tank) == level_volts(healthy, tank)


def test_sensor_drift_grows_from_its_onset() -> None:
    healthy, faulty = frames_with(), frames_with(fault("sensor_drift", 1, -0.5))
    change_V = np.array(level_volts(faulty, 1, 1.0, 3.0)) - np.array(level_volts(healthy, 1, 1.0, 3.0))
    assert change_V == pytest.approx(-0.5 * 0.02 * np.arange(len(change_V)), abs=ADC_STEP_V)


def test_sensor_stuck_holds_the_last_code_before_its_onset() -> None:
    frames = drive(rig_with(fault("sensor_stuck", 1, at_s=1.01)), 10.0, v=(6.0, 6.0))
    before = level_volts(frames, 1, 0.0, 1.01)[-1]
    assert set(level_volts(frames, 1, 1.01)) == {before}
    assert set(channel_status(frames, 1)) == {0}


def test_sensor_stuck_keeps_its_code_while_a_later_fault_covers_it() -> None:
    faults = [fault("sensor_stuck", 1), fault("sensor_open", 1, at_s=2.0, until_s=2.5)]
    frames = drive(rig_with(*faults), 4.0, v=(9.0, 9.0))
    assert set(level_volts(frames, 1, 1.0, 2.0)) == set(level_volts(frames, 1, 2.5))
    assert set(channel_status(frames, 1, 2.0, 2.5)) == {2}


def test_sensor_noise_has_its_standard_deviation() -> None:
    frames = drive(rig_with(fault("sensor_noise", 3, 0.1)), 60.0)
    noise_V = np.array(level_volts(frames, 3, 1.0))
    assert noise_V.std() == pytest.approx(0.1, rel=0.06)
    assert set(channel_status(frames, 3)) == {0}


def test_sensor_open_reads_over_range_and_says_so() -> None:
    frames = frames_with(fault("sensor_open", 4, until_s=2.0))
    assert level_volts(frames, 4, 1.0, 2.0) == pytest.approx([10.2375] * 50, abs=2e-4)
    assert set(channel_status(frames, 4, 1.0, 2.0)) == {2}
    assert set(channel_status(frames, 4, 2.0)) == {0}


def test_sensor_garbage_is_uniform_over_the_range_and_says_ok() -> None:
    frames = drive(rig_with(fault("sensor_garbage", 2)), 60.0)
    garbage_V = np.array(level_volts(frames, 2, 1.0))
    assert garbage_V.mean() == pytest.approx(5.12, abs=0.2)
    assert garbage_V.std() == pytest.approx(10.24 / np.sqrt(12.0), rel=0.05)
    assert garbage_V / ADC_STEP_V == pytest.approx(np.round(garbage_V / ADC_STEP_V), abs=0.05)
    assert set(channel_status(frames, 2)) == {0}
