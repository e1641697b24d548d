"""Faults that grow and faults that come and go: their size in time, and what the water does."""

import math
from typing import Any

import pytest

from firmware_sim.faults import FaultSchedule
from firmware_sim.faults.catalogue import KINDS
from firmware_sim.settings import SettingsError, load
from tests.firmware_sim.fault_bench import drive, fault, level_volts, named, rig_with, run_s
from tests.firmware_sim.sim_bench import CONFIG, SECOND
from tests.narrowing import not_none

PLANT_KINDS = [
    ("pump_effectiveness", 1, 0.2, 1.0),
    ("leak", 3, 0.5, 0.0),
    ("outlet_block", 2, 0.8, 0.0),
    ("valve_split", 2, 0.1, 0.6),
    ("pump_lag", 1, 8.0, 2.0),
    ("sensor_bias", 4, -2.0, 0.0),
    ("clock_jump", "pump", 60.0, 0.0),
    ("frame_delay", "PumpStatus", 0.5, 0.0),
]
"""Kind, target, full size, and the size in a healthy rig with a valve split of 0.6 and lags of 2 s."""


def size_at(one: Any, times_s: list[float]) -> list[float]:
    """The size that a fault has set at these times."""
    schedule = FaultSchedule((one,))
    schedule.start(0)
    sizes = []
    for time_s in times_s:
        while schedule.next_ns is not None and schedule.next_ns <= time_s * SECOND:
            schedule.advance(schedule.next_ns)
        effects, at = schedule.effects, one.target if isinstance(one.target, str) else one.target - 1
        split, lag = effects.valve_split[at % 2 if isinstance(at, int) else 0], effects.lag_s[0]
        bias_V = effects.channels[at].bias_V if at in effects.channels else 0.0
        sizes.append(
            {
                "pump_effectiveness": effects.effectiveness[0],
                "leak": effects.leak[2],
                "outlet_block": effects.blocked[1],
                "valve_split": 0.6 if split is None else split.of(0.6),
                "pump_lag": 2.0 if lag is None else lag.of(2.0),
                "sensor_bias": bias_V,
                "clock_jump": effects.wall_ahead_ns.get("pump", 0) / SECOND,
                "frame_delay": effects.delay_ns.get(0x181, 0) / SECOND,
            }[one.kind]
        )
    return sizes


@pytest.mark.parametrize(("kind", "target", "value", "healthy"), PLANT_KINDS)
def test_a_fault_grows_linearly_from_healthy_to_its_value(
    kind: str, target: int | str, value: float, healthy: float
) -> None:
    growing = fault(kind, target, value, at_s=10.0, until_s=100.0, ramp_s=40.0)
    sizes = size_at(growing, [9.9, 10.0, 20.0, 30.0, 50.0, 99.0, 100.0])
    quarter, half = healthy + 0.25 * (value - healthy), healthy + 0.5 * (value - healthy)
    assert sizes == pytest.approx([healthy, healthy, quarter, half, value, value, healthy])
    assert sizes[4] == value, "to the last bit"


def test_the_kinds_with_a_size_say_from_where_they_grow() -> None:
    without = {kind for kind, table in KINDS.items() if "value" in table.model_fields and not table.grows_from}
    assert without == {"pump_stuck_on", "frame_burst", "wrong_length", "wrong_id", "foreign_command"}


def test_a_growing_blockage_lets_ever_less_out_and_no_water_is_lost() -> None:
    """The open share of the outlet, from inflow and rise of tank 3: before, growing, grown, and after the end."""
    rig = rig_with(fault("outlet_block", 3, 0.6, at_s=1.0, ramp_s=40.0, until_s=51.0))
    start_cm3, inflow_cm3_s, open_shares = rig._tanks.contents_cm3, 0.4 * 3.35 * 3.0, []
    for middle_s in (0.5, 11.0, 21.0, 41.1, 50.0, 51.5):
        drive(rig, middle_s - 0.04)
        before_cm = rig.truth().levels_cm[2]
        drive(rig, middle_s + 0.04)
        after_cm = rig.truth().levels_cm[2]
        outflow_cm3_s = inflow_cm3_s - 28.0 * (after_cm - before_cm) / 0.08
        open_shares.append(outflow_cm3_s / (0.071 * math.sqrt(2.0 * 981.0 * 0.5 * (before_cm + after_cm))))
        tanks = rig._tanks_now()
        change_cm3 = tanks.contents_cm3 - start_cm3
        assert tanks.pumped_cm3 - tanks.drained_cm3 - tanks.spilled_cm3 == pytest.approx(change_cm3, abs=1e-6)
    assert open_shares == pytest.approx([1.0, 0.85, 0.7, 0.4, 0.4, 1.0], abs=0.002)


def test_a_growing_leak_loses_the_integral_of_its_flow() -> None:
    """The volume that a growing hole loses in its first seconds is that of half its final area."""
    growing, tight = rig_with(fault("leak", 1, 0.1, at_s=0.0, ramp_s=5.0)), rig_with()
    drive(growing, 5.0)
    drive(tight, 5.0)
    level_cm = tight.truth().levels_cm[0]
    missing_cm3 = (level_cm - growing.truth().levels_cm[0]) * 28.0
    assert missing_cm3 == pytest.approx(0.5 * 0.1 * 0.071 * math.sqrt(2 * 981 * level_cm) * 5.0, rel=0.05)


def test_a_growing_drift_is_the_square_of_time_and_then_goes_on_evenly() -> None:
    frames = drive(rig_with(fault("sensor_drift", 1, 0.1, at_s=1.0, ramp_s=4.0)), 10.0)
    readings_V = level_volts(frames, 1)
    at = {run_s(frame): reading for frame, reading in zip(named(frames, "LowerLevels"), readings_V, strict=True)}
    rises_V = [at[time_s] - at[1.0] for time_s in (3.0, 5.0, 9.0)]
    assert rises_V == pytest.approx([0.1 * 2.0**2 / 8.0, 0.1 * 2.0, 0.1 * 6.0], abs=0.003)


def test_growing_noise_and_loss_reach_their_size() -> None:
    frames = drive(rig_with(fault("sensor_noise", 2, 0.5, at_s=0.0, ramp_s=20.0)), 40.0)

    def spread(from_s: float, to_s: float) -> float:
        readings = level_volts(frames, 2, from_s, to_s)
        mean = sum(readings) / len(readings)
        return math.sqrt(sum((reading - mean) ** 2 for reading in readings) / len(readings))

    assert spread(0.0, 1.0) < 0.05
    assert spread(9.0, 11.0) == pytest.approx(0.25, rel=0.25)
    assert spread(20.0, 40.0) == pytest.approx(0.5, rel=0.1)
    frames = drive(rig_with(fault("frame_loss", "LowerLevels", 1.0, at_s=0.0, ramp_s=20.0)), 22.0)
    counts = [len(named(frames, "LowerLevels", from_s, from_s + 2.0)) for from_s in (0.0, 9.0, 20.0)]
    assert counts[0] > 85
    assert 35 <= counts[1] <= 65
    assert counts[2] == 0


def test_a_growing_babble_sends_the_integral_of_its_rate() -> None:
    frames = drive(rig_with(fault("babble", "foreign", 100.0, at_s=1.0, ramp_s=4.0, until_s=7.0)), 8.0)
    count = [sum(f.arbitration_id == 0x7A5 and run_s(f) < to_s for f in frames) for to_s in (1.0, 3.0, 5.0, 8.0)]
    assert count == pytest.approx([0, 50, 200, 400], abs=3)


@pytest.mark.parametrize("kind", ["pump_dead", "sensor_open"])
def test_an_intermittent_fault_is_there_for_its_share_of_each_period(kind: str) -> None:
    rig = rig_with(fault(kind, 1, at_s=1.0, until_s=9.5, period_s=2.0, duty=0.25))
    seen = {}
    for tenth in range(120):
        drive(rig, tenth / 10.0)
        seen[tenth] = rig.truth().faults != ()
    assert {tenth for tenth, is_there in seen.items() if is_there} == {
        begin + after for begin in (10, 30, 50, 70, 90) for after in range(5)
    }


def test_a_growing_intermittent_fault_comes_back_larger() -> None:
    """Growth does not wait while the fault is away."""
    one = fault("pump_effectiveness", 1, 0.0, at_s=0.0, ramp_s=10.0, period_s=4.0, duty=0.5)
    assert size_at(one, [1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0]) == pytest.approx([0.9, 1.0, 0.5, 1.0, 0.1, 1.0, 0.0])


def test_an_intermittent_sensor_is_stuck_at_another_reading_each_time() -> None:
    rig = rig_with(fault("sensor_stuck", 1, at_s=1.0, period_s=4.0, duty=0.5))
    frames = drive(rig, 9.0, v=(6.0, 6.0))
    first, second = level_volts(frames, 1, 1.1, 2.9), level_volts(frames, 1, 5.1, 6.9)
    assert len(set(first)) == len(set(second)) == 1
    assert second[0] > first[0] + 0.1


def test_an_intermittent_supply_boots_the_node_in_every_period() -> None:
    rig = rig_with(fault("node_reboot", "level", at_s=1.0, period_s=2.0, duty=0.2))
    frames = named(drive(rig, 6.0), "LevelHeartbeat")
    assert int.from_bytes(frames[-1].data[1:3], "little") - int.from_bytes(frames[0].data[1:3], "little") == 3
    assert not any(1.0 < run_s(frame) < 1.4 for frame in frames)


REFUSALS = [
    (
        'kind = "pump_stuck_on"\ntarget = 1\nvalue = 3.0\nramp_s = 5.0',
        "fault[0].ramp_s = 5.0: must be 0: pump_stuck_on",
    ),
    (
        'kind = "pump_dead"\ntarget = 1\nramp_s = 5.0',
        "fault[0].ramp_s = 5.0: must be 0: pump_dead has no size that grows",
    ),
    ('kind = "leak"\ntarget = 1\nvalue = 0.1\nramp_s = -1.0', "fault[0].ramp_s = -1.0: is outside 0 .. 1e+07"),
    ('kind = "leak"\ntarget = 1\nvalue = 0.1\nramp_s = nan', "fault[0].ramp_s = nan: is outside 0 .. 1e+07"),
    ('kind = "leak"\ntarget = 1\nvalue = 0.1\nramp_s = "5"', "fault[0].ramp_s = '5': must be a number in 0 .. 1e+07"),
    ('kind = "leak"\ntarget = 1\nvalue = 0.1\nperiod_s = 5.0', "fault[0].duty = None: must be given with period_s"),
    ('kind = "leak"\ntarget = 1\nvalue = 0.1\nduty = 0.5', "fault[0].duty = 0.5: needs period_s, too"),
    ('kind = "pump_dead"\ntarget = 1\nperiod_s = 5.0\nduty = 1.0', "fault[0].duty = 1.0: is outside 0.001 .. 0.999"),
    ('kind = "pump_dead"\ntarget = 1\nperiod_s = 0.0\nduty = 0.5', "fault[0].period_s = 0.0: is outside 0.01 .. 1e+07"),
]


@pytest.mark.parametrize(("text", "expected"), REFUSALS)
def test_what_can_t_grow_or_come_and_go_is_refused_with_the_reason(text: str, expected: str, tmp_path: Any) -> None:
    scenario = tmp_path / "growing.toml"
    scenario.write_text(f"[[fault]]\nat_s = 1.0\n{text}\n")
    with pytest.raises(SettingsError) as caught:
        load(CONFIG / "emulator.toml", scenario)
    assert str(caught.value).startswith(f"{scenario}: {expected}")


def test_next_time_of_a_growing_fault_ends_with_its_growth() -> None:
    schedule = FaultSchedule((fault("leak", 1, 0.5, at_s=1.0, ramp_s=0.035),))
    schedule.start(0)
    times_ms = []
    while schedule.next_ns is not None:
        times_ms.append(schedule.next_ns // 1_000_000)
        schedule.advance(not_none(schedule.next_ns))
    assert times_ms == [1000, 1010, 1020, 1030, 1035]
