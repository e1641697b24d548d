"""Pumps as they are: the drive of a voltage and back, and what is still under way to the tanks."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from firmware_sim import settings as emulator
from hil.core import closed_loop, controller
from hil.core.loop_state import LoopState
from hil.core.pumps import STRAIGHT, PumpPath, UnderWay
from hil.core.reconfiguration import Reconfiguration
from hil.core.types import Mode, NodeState, Pair
from tests.core.core_bench import (
    BENCH,
    PERIOD_S,
    bench_loop,
    controller_config,
    inputs,
    integrals_after,
    rig_design,
    volts,
)
from tests.narrowing import pair

BENT = PumpPath(dead_zone_V=(0.5, 0.3), curve_1_V=(0.03, -0.02))
SECOND = 1_000_000_000
VOLT = st.floats(0.0, 10.0)
ZONES = st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 2.0))
CURVES = st.tuples(st.floats(-0.045, 0.2), st.floats(-0.045, 0.2))


@given(ZONES, CURVES, st.tuples(VOLT, VOLT))
def test_the_drive_is_the_flow_that_the_emulator_gives_over_its_gain(zones: Pair, curves: Pair, at_V: Pair) -> None:
    shipped = emulator.load(emulator.default_config_dir() / "emulator.toml")[0].pumps
    theirs = shipped.model_copy(update={"dead_zone_V": zones, "curve_1_V": curves})
    assert PumpPath(zones, curves).drive(at_V) == pytest.approx(theirs.flow_voltages(at_V), rel=1e-12)


@given(ZONES, CURVES, st.tuples(VOLT, VOLT))
def test_the_voltage_of_a_drive_gives_that_drive(zones: Pair, curves: Pair, at_V: Pair) -> None:
    pumps = PumpPath(zones, curves)
    drive = pumps.drive(at_V)
    assert pumps.drive(pumps.voltage(drive)) == pytest.approx(drive, abs=1e-9)
    for pump in (0, 1):
        if drive[pump] > 0.0:
            assert pumps.voltage(drive)[pump] == pytest.approx(at_V[pump], abs=1e-6)


def test_a_pump_that_shall_give_nothing_is_off_and_not_at_the_edge_of_its_dead_zone() -> None:
    assert BENT.voltage((0.0, -1.5)) == (0.0, -1.5)
    assert BENT.voltage((1e-9, 1e-9)) == pytest.approx((0.5, 0.3))
    assert BENT.drive((0.5, 0.3)) == (0.0, 0.0)


@given(CURVES, st.floats(0.1, 8.0))
def test_the_slope_is_that_of_the_voltage_over_the_drive(curves: Pair, drive: float) -> None:
    pumps = PumpPath((0.5, 0.5), curves)
    for pump in (0, 1):
        assume(1.0 + 4.0 * curves[pump] * drive > 0.05)
        up, down = (pumps.voltage((drive + d, drive + d))[pump] for d in (1e-5, -1e-5))
        assert pumps.slope(pump, drive) == pytest.approx((up - down) / 2e-5, rel=1e-3)


def test_a_drive_out_of_reach_is_a_voltage_at_the_end_of_the_range() -> None:
    concave = PumpPath(curve_1_V=(-0.04, -0.04))
    assert math.isfinite(concave.voltage((50.0, 50.0))[0])
    assert concave.within_range(0, 50.0) == 10.0
    assert BENT.within_range(0, 50.0) == 10.0
    assert BENT.within_range(1, -3.0) == 0.0
    assert BENT.within_range(1, BENT.drive((4.0, 4.0))[1]) == pytest.approx(4.0)
    assert BENT.max_drives == pytest.approx(BENT.drive((10.0, 10.0)))


def test_a_straight_pump_is_left_alone() -> None:
    assert STRAIGHT.is_straight
    assert STRAIGHT.is_direct
    odd = (-1.23456789, 17.0)
    assert STRAIGHT.drive(odd) is odd
    assert STRAIGHT.voltage(odd) is odd
    assert STRAIGHT.slope(0, 3.0) == 1.0


def played(pumps: PumpPath, drives: list[Pair], period_ns: int) -> list[Pair]:
    """What arrives in each period, with these drives one after the other and nothing before."""
    way, arrived = UnderWay(((-1, 0, (0.0, 0.0)),)), []
    for number, drive in enumerate(drives):
        begin, end = number * period_ns, (number + 1) * period_ns
        way = way.with_drive(pumps, begin, end, drive)
        arrived.append(way.arrived(pumps, begin, end))
    return arrived


def test_what_a_pump_gives_arrives_after_its_delay_each_pump_its_own() -> None:
    arrived = played(PumpPath(delay_s=(0.2, 0.05)), [(4.0, 4.0)] * 2 + [(1.0, 2.0)] * 3, SECOND // 10)
    assert [first for first, _ in arrived] == pytest.approx([0.0, 0.0, 4.0, 4.0, 1.0])
    assert [second for _, second in arrived] == pytest.approx([2.0, 4.0, 3.0, 2.0, 2.0])


@given(st.lists(st.tuples(VOLT, VOLT), min_size=1, max_size=30), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_no_water_is_lost_on_the_way(drives: list[Pair], first_s: float, second_s: float) -> None:
    after = [(0.0, 0.0)] * 12
    arrived = played(PumpPath(delay_s=(first_s, second_s)), drives + after, SECOND // 10)
    for pump in (0, 1):
        assert sum(a[pump] for a in arrived) == pytest.approx(sum(d[pump] for d in drives), abs=1e-6)


def test_the_largest_drive_under_way_is_known_until_it_has_arrived() -> None:
    pumps, way = PumpPath(delay_s=(0.2, 0.2)), UnderWay()
    assert way.largest() == (0.0, 0.0)
    for number, drive in enumerate([(8.0, 1.0), (0.0, 2.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)]):
        way = way.with_drive(pumps, number * SECOND // 10, (number + 1) * SECOND // 10, drive)
        assert way.largest()[0] == (8.0 if number < 3 else 0.0)


# in the law


def stepped(pumps: PumpPath, limit_V: Pair, level_cm: tuple[float, ...]) -> LoopState:
    """The loop after a second at these levels, with nothing applied."""
    loop = bench_loop(pumps=pumps, rule=Reconfiguration(BENCH, rig_design(), limit_V, (3.0, 3.0), pumps))
    state = closed_loop.begin(loop, inputs(volts(level_cm)), 0)
    for number in range(10):
        state, _ = closed_loop.step(loop, state, inputs(volts(level_cm)), round(number * PERIOD_S * SECOND))
    return state


REST = (12.263, 12.783, 1.634, 1.409)


def test_the_law_asks_for_the_voltage_whose_drive_it_wants() -> None:
    straight, bent = (stepped(pumps, pumps.max_drives, REST) for pumps in (STRAIGHT, BENT))
    assert bent.drive_V == pytest.approx(straight.raw_V)
    assert BENT.drive(bent.raw_V) == pytest.approx(straight.raw_V)
    assert bent.raw_V != pytest.approx(straight.raw_V, abs=0.05)


def test_a_target_out_of_reach_is_told_in_volts_of_the_pump() -> None:
    reason = Reconfiguration(BENCH, rig_design(), BENT.max_drives, (3.0, 3.0), BENT).law((9.0, 9.0), (0.2, 1.0)).reason
    most = BENT.voltage((0.2 * BENT.max_drives[0], 1.0))[0]
    assert f"V of {most:.2f} V" in reason


@pytest.mark.parametrize("pumps", [STRAIGHT, BENT])
def test_anti_windup_follows_what_the_pump_gave(pumps: PumpPath) -> None:
    """The integrals end where they would with straight pumps at the same drives."""
    state = stepped(pumps, pumps.max_drives, (5.0, 5.0, 0.5, 0.5))
    loop = bench_loop(pumps=pumps)
    given_V = pumps.voltage((6.0, 5.0))
    short = pair(a - b for a, b in zip(given_V, pumps.voltage((5.5, 5.0)), strict=True))
    seen = inputs(volts(REST), pumps.voltage((5.5, 5.0)), shortfall_V=short)
    straight = inputs(volts(REST), (5.5, 5.0), shortfall_V=(0.5, 0.0))
    expected = closed_loop.conclude(bench_loop(), state, straight, (6.0, 5.0), Mode.RUNNING)
    bent = closed_loop.conclude(loop, state, seen, given_V, Mode.RUNNING)
    assert integrals_after(bent) == pytest.approx(integrals_after(expected), abs=1e-9)


def test_the_record_is_in_volts() -> None:
    reconfiguration = Reconfiguration(BENCH, rig_design(), BENT.max_drives, (3.0, 3.0), BENT)
    config = controller_config(bench_loop(pumps=BENT, rule=reconfiguration))
    state = controller.ControllerState()
    for number in range(6):
        seen = inputs(volts(REST), state=NodeState.READY if number < 3 else NodeState.RUN)
        state, output = controller.step(config, state, seen, round(number * PERIOD_S * SECOND))
    record = output.record
    assert record is not None
    assert BENT.drive(record.operating_V) == pytest.approx((3.0, 3.0), abs=0.01)
