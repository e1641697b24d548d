"""The level node: converter, clipping and status, noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.frames import ChannelStatus, NodeState
from firmware_sim.level_node import LevelNode, Quad, converter
from tests.firmware_sim.sim_bench import MS, emulator

OK, UNDER, OVER = ChannelStatus.OK, ChannelStatus.UNDER_RANGE, ChannelStatus.OVER_RANGE


def level_node(seed: int = 1, **sensors: float) -> LevelNode:
    return LevelNode(emulator(sensors=sensors), seed, 0, lambda _change: None)


def readings_volt(payloads: tuple[bytes, bytes]) -> list[float]:
    """Four voltages of a pair of level frames."""
    return [int.from_bytes(data[at : at + 2], "little") / 5000 for data in payloads for at in (0, 2)]


@given(st.floats(0.0, 10.24), st.sampled_from([12, 16]))
def test_adc_is_off_by_half_a_step_except_above_its_highest_code(signal_V: float, bits: int) -> None:
    step_V = 10.24 / 2**bits
    reading_V, status = converter(bits)(signal_V)
    assert status is OK
    assert abs(reading_V - signal_V) <= (step_V if signal_V > 10.24 - step_V else step_V / 2) + 1e-12
    assert reading_V / step_V == pytest.approx(round(reading_V / step_V), abs=1e-6)


@pytest.mark.parametrize(
    ("bits", "signal_V", "reading_V", "status"),
    [
        (0, 6.1312, 6.1312, OK),
        (0, 0.0, 0.0, OK),
        (0, -0.0999, 0.0, OK),
        (0, -0.1001, 0.0, UNDER),
        (0, 10.24, 10.24, OK),
        (0, 10.3399, 10.24, OK),
        (0, 10.3401, 10.24, OVER),
        (12, -0.0999, 0.0, OK),
        (12, -0.1001, 0.0, UNDER),
        (12, 0.0, 0.0, OK),
        (12, 0.00126, 0.0025, OK),
        (12, 10.24, 10.2375, OK),
        (12, 10.3399, 10.2375, OK),
        (12, 10.3401, 10.2375, OVER),
        (12, 99.0, 10.2375, OVER),
        (16, 10.3401, 10.23984375, OVER),
    ],
)
def test_readings_and_status_at_the_ends_of_the_range(
    bits: int, signal_V: float, reading_V: float, status: ChannelStatus
) -> None:
    read_V, said = converter(bits)(signal_V)
    assert read_V == pytest.approx(reading_V)
    assert said is status


@pytest.mark.parametrize(
    ("levels_cm", "nibbles"), [((12, 12, 2, 2), 0x00), ((21, 12, 2, 2), 0x02), ((12, 30, 2, 2), 0x20)]
)
def test_status_of_each_channel_is_sent_beside_its_reading(levels_cm: Quad, nibbles: int) -> None:
    lower, upper = level_node(noise_V=0.0).levels(levels_cm)
    assert lower[4] == nibbles
    assert upper[4] == 0


def test_both_frames_of_a_pair_carry_the_same_counter_and_it_wraps() -> None:
    node = level_node()
    counters = [[data[5] for data in node.levels((1, 2, 3, 4))] for _ in range(18)]
    assert counters == [[number % 16] * 2 for number in range(18)]


def test_noise_has_the_standard_deviation_of_the_settings_and_no_colour() -> None:
    node = level_node(noise_V=0.02, adc_bits=0)
    samples_V = np.array([readings_volt(node.levels((12.0, 10.0, 8.0, 6.0))) for _ in range(5000)])
    assert samples_V.mean(axis=0) == pytest.approx([6.0, 5.0, 4.0, 3.0], abs=0.001)
    assert samples_V.std(axis=0) == pytest.approx([0.02] * 4, rel=0.04)
    residual = samples_V - samples_V.mean(axis=0)
    lag_one = (residual[1:] * residual[:-1]).mean(axis=0) / residual.var(axis=0)
    assert np.abs(lag_one).max() < 0.06
    correlation = np.corrcoef(residual.T) - np.eye(4)
    assert np.abs(correlation).max() < 0.06


def test_without_noise_and_converter_a_level_arrives_to_a_tenth_of_a_millivolt() -> None:
    node = level_node(noise_V=0.0, adc_bits=0)
    assert readings_volt(node.levels((12.26, 12.78, 1.63, 1.41))) == pytest.approx([6.13, 6.39, 0.815, 0.705], abs=1e-4)


def test_boots_then_runs() -> None:
    node = level_node()
    node.run_event(200 * MS - 1)
    before = node.state
    node.run_event(200 * MS)
    assert (before, node.state) == (NodeState.BOOT, NodeState.RUN)
    assert node.next_event_ns is None


@given(st.floats(0.1, 10.1))
def test_without_a_converter_rounding_to_the_wire_is_carried_on_so_that_the_mean_is_exact(signal_V: float) -> None:
    convert = converter(0)
    readings = [convert(signal_V)[0] for _ in range(100)]
    assert max(abs(reading - signal_V) for reading in readings) <= 0.0002 + 1e-9
    assert abs(sum(readings) / 100 - signal_V) <= 0.0002 / 100


def test_channels_keep_their_remainders_apart() -> None:
    node = level_node(noise_V=0.0, adc_bits=0)
    sums = [0.0] * 4
    for _ in range(100):
        sums = [a + b for a, b in zip(sums, readings_volt(node.levels((4.00013, 4.00027, 2.00031, 2.0))), strict=True)]
    assert [total / 100 for total in sums] == pytest.approx([2.000065, 2.000135, 1.000155, 1.0], abs=3e-6)
