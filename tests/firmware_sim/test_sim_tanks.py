"""The plant: physics, not stored numbers."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from firmware_sim.settings import EmulatorSettings, equilibrium_cm
from firmware_sim.tanks import Tanks
from tests.firmware_sim.sim_bench import emulator
from tests.narrowing import quad

HEALTHY = [1.0, 1.0]
Floats = npt.NDArray[np.float64]
NO_LAG = emulator(pumps={"lag_s": 0.0})


def balance_error_cm3(tanks: Tanks, start_cm3: float) -> float:
    return tanks.pumped_cm3 - tanks.drained_cm3 - tanks.spilled_cm3 - (tanks.contents_cm3 - start_cm3)


def equation_1(
    configuration: EmulatorSettings, applied_V: Floats, effectiveness: Floats
) -> Callable[[float, Floats], Floats]:
    """Right-hand side of eq. (1) with pump lag, written with arrays: levels and flow voltages, (6,)."""
    area, outlet = np.array(configuration.tanks.area_cm2), np.array(configuration.tanks.outlet_cm2)
    gain, split = np.array(configuration.pumps.gain_cm3_Vs), np.array(configuration.pumps.valve_split)

    def rates(_t: float, x: Floats) -> Floats:
        out = outlet * np.sqrt(2.0 * configuration.tanks.gravity_cm_s2 * x[:4])
        flow = gain * effectiveness * x[4:]
        lower = split * flow + out[2:] - out[:2]
        upper = ((1.0 - split) * flow)[::-1] - out[2:]
        return np.concatenate([np.concatenate([lower, upper]) / area, (applied_V - x[4:]) / configuration.pumps.lag_s])

    return rates


def test_start_levels_are_close_to_those_of_the_paper() -> None:
    assert equilibrium_cm(emulator()) == pytest.approx((12.4, 12.7, 1.8, 1.4), abs=0.2)


def test_equilibrium_stays() -> None:
    tanks = Tanks(NO_LAG)
    start = tanks.levels_cm
    tanks.advance(600.0, (3.0, 3.0), HEALTHY)
    assert tanks.levels_cm == pytest.approx(start, abs=1e-9)


def test_a_step_with_lag_agrees_with_a_precise_integrator() -> None:
    configuration = emulator(pumps={"lag_s": 0.2})
    tanks = Tanks(configuration)
    start = [*tanks.levels_cm, 0.0, 0.0]
    applied_V, effectiveness = np.array([4.0, 2.5]), np.array([0.8, 1.0])
    moments_s = [0.02, 0.1, 0.5, 2.0, 10.0, 60.0]
    exact = solve_ivp(
        equation_1(configuration, applied_V, effectiveness),
        (0.0, 60.0),
        start,
        method="DOP853",
        t_eval=moments_s,
        rtol=1e-12,
        atol=1e-12,
    )
    done_s = 0.0
    for moment_s, levels_cm in zip(moments_s, exact.y.T, strict=True):
        tanks.advance(moment_s - done_s, (4.0, 2.5), [0.8, 1.0])
        done_s = moment_s
        assert tanks.levels_cm == pytest.approx(levels_cm[:4], abs=1e-6)
        assert tanks.flow_V == pytest.approx(levels_cm[4:], abs=1e-9)


@pytest.mark.parametrize("lag_s", [0.0, 0.001, 0.2, 5.0])
def test_no_lag_is_too_short_or_too_long(lag_s: float) -> None:
    tanks = Tanks(emulator(pumps={"lag_s": lag_s}))
    tanks.advance(0.4, (3.0, 3.0), HEALTHY)
    expected = 3.0 * (1.0 - math.exp(-0.4 / lag_s)) if lag_s else 3.0
    assert tanks.flow_V == pytest.approx((expected, expected), abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(0.001, 20.0), st.floats(0, 10), st.floats(0, 10), st.floats(0, 1), st.floats(0, 1)),
        min_size=1,
        max_size=12,
    )
)
def test_no_water_is_made_or_lost_and_levels_stay_in_the_tanks(
    pieces: list[tuple[float, float, float, float, float]],
) -> None:
    tanks = Tanks(emulator())
    start_cm3 = tanks.contents_cm3
    for dt_s, v1, v2, e1, e2 in pieces:
        spilled_cm3 = tanks.spilled_cm3
        tanks.advance(dt_s, (v1, v2), [e1, e2])
        assert all(0.0 <= level <= 20.0 for level in tanks.levels_cm)
        assert tanks.spilled_cm3 >= spilled_cm3
    assert abs(balance_error_cm3(tanks, start_cm3)) < 1e-8 * (1.0 + tanks.pumped_cm3)


def test_tanks_drain_monotonously_with_the_pumps_off_and_then_stay_empty() -> None:
    tanks = Tanks(NO_LAG)
    start_cm3 = tanks.contents_cm3
    before = (math.inf,) * 4
    for _ in range(1200):
        tanks.advance(0.5, (0.0, 0.0), HEALTHY)
        assert all(now <= then for now, then in zip(tanks.levels_cm, before, strict=True))
        before = tanks.levels_cm
    assert tanks.levels_cm == (0.0, 0.0, 0.0, 0.0)
    assert tanks.drained_cm3 == pytest.approx(start_cm3, abs=1e-8)
    tanks.advance(100.0, (0.0, 0.0), HEALTHY)
    assert tanks.levels_cm == (0.0, 0.0, 0.0, 0.0)
    assert tanks.drained_cm3 == pytest.approx(start_cm3, abs=1e-8)


def test_overflow_stops_at_the_rim_and_spills() -> None:
    tanks = Tanks(NO_LAG)
    start_cm3 = tanks.contents_cm3
    tanks.advance(600.0, (10.0, 10.0), HEALTHY)
    assert tanks.levels_cm[0] == 20.0
    assert tanks.levels_cm[1] == 20.0
    assert tanks.spilled_cm3 > 0.0
    assert abs(balance_error_cm3(tanks, start_cm3)) < 1e-6
    drained_cm3 = tanks.drained_cm3
    tanks.advance(100.0, (10.0, 10.0), HEALTHY)
    full_outflow = (0.071 + 0.057) * math.sqrt(2.0 * 981.0 * 20.0) * 100.0
    assert tanks.drained_cm3 - drained_cm3 == pytest.approx(full_outflow, rel=1e-3)


def test_a_spilling_upper_tank_does_not_feed_its_lower_one() -> None:
    wide_open = emulator(pumps={"lag_s": 0.0, "valve_split": [0.0, 0.0]}, tanks={"start_V": [1.0, 1.0]})
    tanks = Tanks(wide_open)
    start_cm3 = tanks.contents_cm3
    tanks.advance(600.0, (10.0, 10.0), HEALTHY)
    assert tanks.levels_cm[3] == 20.0
    assert 19.0 < tanks.levels_cm[1] <= 20.0
    assert abs(balance_error_cm3(tanks, start_cm3)) < 1e-6


@pytest.mark.parametrize(("tank", "other"), list(itertools.permutations(range(4), 2)))
@pytest.mark.parametrize("is_full", [False, True])
def test_a_nearly_empty_tank_keeps_its_water_while_another_one_spills_or_runs_empty(
    tank: int, other: int, is_full: bool
) -> None:
    """Up to 1 mm could be counted as drained in one step, which the balance of volumes does not show."""
    tanks = Tanks(NO_LAG)
    levels_cm = [5.0, 5.0, 5.0, 5.0]
    levels_cm[tank], levels_cm[other] = 0.05, 20.0 if is_full else 1e-9
    tanks.levels_cm = quad(levels_cm)
    dt_s, outlet_cm2, area_cm2 = 1e-3, 0.071, 28.0
    tanks.advance(dt_s, (10.0, 10.0) if is_full else (0.0, 0.0), HEALTHY)
    most_cm = dt_s * outlet_cm2 * math.sqrt(2.0 * 981.0 * 0.05) / area_cm2
    assert tanks.levels_cm[tank] >= 0.05 - most_cm


def test_effectiveness_scales_the_flow_at_once() -> None:
    tanks = Tanks(NO_LAG)
    tanks.advance(10.0, (3.0, 3.0), [0.4, 0.0])
    assert tanks.pumped_cm3 == pytest.approx(0.4 * 3.33 * 3.0 * 10.0)


def test_a_copy_goes_its_own_way() -> None:
    tanks = Tanks(NO_LAG)
    tanks.advance(1.0, (5.0, 5.0), HEALTHY)
    twin, levels = tanks.copy(), tanks.levels_cm
    twin.advance(10.0, (5.0, 5.0), HEALTHY)
    assert tanks.levels_cm == levels
    tanks.advance(10.0, (5.0, 5.0), HEALTHY)
    assert tanks.levels_cm == twin.levels_cm
    assert tanks.pumped_cm3 == twin.pumped_cm3
