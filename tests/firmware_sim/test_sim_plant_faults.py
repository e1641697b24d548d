"""Each fault of pumps, valves, reservoir and tanks, by what the water does."""

import math

import pytest

from firmware_sim.faults.base import Fault
from firmware_sim.settings import equilibrium_cm
from firmware_sim.truth import Truth
from tests.firmware_sim.fault_bench import QUIET, drive, fault, rig_with
from tests.firmware_sim.sim_bench import emulator

STEADY = equilibrium_cm(QUIET)
LONG_S = 1500.0
SLOW = {"watchdog_s": 10.0, "levels_period_s": 1.0, "status_period_s": 1.0, "heartbeat_period_s": 10.0}


def settled(*faults: Fault, v: tuple[float, float] = (3.0, 3.0)) -> Truth:
    """Levels long after the faults; commands only where they have to be kept alive."""
    rig = rig_with(*faults, settings=emulator(pumps={"lag_s": 0.0, "dac_bits": 0}, nodes=SLOW))
    drive(rig, LONG_S, v, period_ns=5_000_000_000)
    return rig.truth()


def head_cm(flow_cm3_s: float, outlet_cm2: float) -> float:
    return (flow_cm3_s / outlet_cm2) ** 2 / (2.0 * 981.0)


def test_pump_effectiveness() -> None:
    truth = settled(fault("pump_effectiveness", 1, 0.4))
    assert truth.effectiveness == (0.4, 1.0)
    assert truth.levels_cm == pytest.approx(equilibrium_cm(emulator(tanks={"start_V": [1.2, 3.0]})), abs=1e-3)


def test_pump_dead() -> None:
    truth = settled(fault("pump_dead", 2))
    assert truth.effectiveness == (1.0, 0.0)
    assert truth.levels_cm[2] == 0.0
    assert truth.faults == ("pump_dead 2",)


def test_pump_stuck_on_goes_on_at_its_voltage_while_the_node_reports_its_own() -> None:
    rig = rig_with(fault("pump_stuck_on", 1, 4.0))
    drive(rig, 30.0, v=(3.0, 3.0))
    rig.advance(rig.now_ns + 600_000_000_000)
    truth = rig.truth()
    assert truth.applied_V == (0.0, 0.0)
    assert truth.levels_cm[0] == pytest.approx(head_cm(0.7 * 3.33 * 4.0, 0.071), abs=0.01)
    assert truth.levels_cm[3] == pytest.approx(head_cm(0.3 * 3.33 * 4.0, 0.057), abs=0.01)
    assert truth.levels_cm[2] == 0.0


def test_pump_lag_slows_the_flow_of_its_pump_only() -> None:
    faulty, healthy = rig_with(fault("pump_lag", 1, 20.0, at_s=0.0)), rig_with()
    for rig in (faulty, healthy):
        drive(rig, 10.0, v=(6.0, 6.0))
    assert healthy.truth().levels_cm[3] - faulty.truth().levels_cm[3] > 1.0
    assert healthy.truth().levels_cm[2] == faulty.truth().levels_cm[2]
    flow_V = faulty._tanks.flow_V
    assert flow_V[0] == pytest.approx(6.0 * (1.0 - math.exp(-10.0 / 20.0)), abs=1e-6)


def test_valve_split() -> None:
    truth = settled(fault("valve_split", 1, 0.5))
    expected = equilibrium_cm(emulator(pumps={"valve_split": [0.5, 0.6]}))
    assert truth.levels_cm == pytest.approx(expected, abs=1e-3)


def test_reservoir_low_leaves_both_pumps_with_air_even_one_that_is_stuck_on() -> None:
    truth = settled(fault("reservoir_low"), fault("pump_stuck_on", 1, 9.0, at_s=2.0))
    assert truth.levels_cm == (0.0, 0.0, 0.0, 0.0)
    assert truth.effectiveness == (0.0, 0.0)


@pytest.mark.parametrize("tank", [1, 2, 3, 4])
def test_leak_lets_its_share_of_the_outflow_out_of_the_rig(tank: int) -> None:
    truth = settled(fault("leak", tank, 0.25))
    assert truth.levels_cm[tank - 1] == pytest.approx(STEADY[tank - 1] / 1.25**2, abs=1e-3)
    if tank > 2:
        flow = 0.071 * math.sqrt(2 * 981.0) if tank == 3 else 0.057 * math.sqrt(2 * 981.0)
        lost_cm3_s = flow * (math.sqrt(STEADY[tank - 1]) - math.sqrt(truth.levels_cm[tank - 1]))
        below = (math.sqrt(STEADY[tank - 3]) - lost_cm3_s / flow) ** 2
        assert truth.levels_cm[tank - 3] == pytest.approx(below, abs=1e-3)


@pytest.mark.parametrize("tank", [3, 4])
def test_outlet_block_raises_the_level_until_the_flow_is_the_same(tank: int) -> None:
    truth = settled(fault("outlet_block", tank, 0.5))
    assert truth.levels_cm[tank - 1] == pytest.approx(STEADY[tank - 1] * 4.0, abs=1e-3)
    assert truth.levels_cm[tank - 3] == pytest.approx(STEADY[tank - 3], abs=1e-3)


def test_outlet_block_of_a_lower_tank_ends_at_the_rim() -> None:
    truth = settled(fault("outlet_block", 1, 1.0))
    assert truth.levels_cm[0] == 20.0
    assert truth.spilled_cm3 > 0.0


def test_a_fault_that_ends_leaves_a_healthy_rig() -> None:
    faults = [fault("leak", 1, 1.0, until_s=20.0), fault("valve_split", 2, 0.1, until_s=30.0)]
    assert settled(*faults).levels_cm == pytest.approx(STEADY, abs=1e-3)


def test_of_two_faults_of_one_pump_the_later_holds_and_then_the_earlier_again() -> None:
    rig = rig_with(fault("pump_effectiveness", 1, 0.5, at_s=1.0), fault("pump_dead", 1, at_s=2.0, until_s=3.0))
    seen = []
    for until_s in (0.5, 1.5, 2.5, 3.5):
        drive(rig, until_s)
        seen.append(rig.truth().effectiveness[0])
    assert seen == [1.0, 0.5, 0.0, 0.5]
