"""Tanks whose outlets lie below their zero: equilibrium, rates, linear model and targets, also of empty tanks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from firmware_sim import settings as emulator
from firmware_sim.faults.effects import Effects
from firmware_sim.tank_slopes import slopes_of
from hil.core.reachable import nearest_reachable
from hil.core.tanks import (
    TankModel,
    equilibrium,
    holding_voltages,
    level_rates,
    linearise,
    outflows,
    through_flow_matrix,
)
from hil.core.types import Pair, Quad
from tests.core.core_bench import BENCH
from tests.narrowing import pair, quad

DATUMS = st.tuples(*[st.one_of(st.just(0.0), st.floats(0.05, 40.0))] * 4)
LEVELS = st.tuples(*[st.one_of(st.just(0.0), st.floats(0.01, 20.0))] * 4)
VOLTS = st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 10.0))
SHIPPED = emulator.load(emulator.default_config_dir() / "emulator.toml")[0]


def deep(datum_cm: Quad) -> TankModel:
    return replace(BENCH, datum_cm=datum_cm)


@given(DATUMS, LEVELS, VOLTS)
def test_the_rates_are_the_emulators_also_of_empty_tanks(datum_cm: Quad, level_cm: Quad, pump_V: Pair) -> None:
    theirs = SHIPPED.model_copy(update={"tanks": SHIPPED.tanks.model_copy(update={"datum_cm": datum_cm})})
    expected = slopes_of(theirs, Effects())(*level_cm, *pump_V)
    assert level_rates(deep(datum_cm), level_cm, pump_V) == pytest.approx(expected[:4], abs=1e-12)


@given(DATUMS, VOLTS)
def test_the_equilibrium_is_the_emulators_and_stands_still(datum_cm: Quad, pump_V: Pair) -> None:
    tanks = SHIPPED.tanks.model_copy(update={"datum_cm": datum_cm, "start_V": pump_V})
    model = deep(datum_cm)
    levels = equilibrium(model, pump_V)
    assert levels == pytest.approx(emulator.equilibrium_cm(SHIPPED.model_copy(update={"tanks": tanks})), abs=1e-9)
    assert level_rates(model, levels, pump_V) == pytest.approx((0.0,) * 4, abs=1e-9)


def test_an_empty_tank_lets_out_what_flows_in_up_to_what_its_datum_draws() -> None:
    model = deep((0.0, 0.0, 4.0, 4.0))
    _, _, out3, out4 = outflows(model, (9.0, 9.0, 0.0, 0.0), (1.0, 9.0))
    assert out4 == pytest.approx(0.3 * 3.33 * 1.0)
    assert out3 == pytest.approx(0.071 * math.sqrt(2 * 981 * 4.0))
    assert outflows(BENCH, (9.0, 9.0, 0.0, 0.0), (1.0, 9.0))[2:] == (0.0, 0.0)


@given(DATUMS, st.tuples(*[st.floats(0.5, 18.0)] * 2))
def test_the_holding_voltages_hold(datum_cm: Quad, lower_cm: Pair) -> None:
    model = deep(datum_cm)
    v1, v2 = holding_voltages(model, lower_cm)
    assume(min(v1, v2) >= 0.0)
    assert equilibrium(model, (v1, v2))[:2] == pytest.approx(lower_cm, abs=1e-6)


@given(DATUMS, st.tuples(*[st.floats(0.5, 18.0)] * 4), VOLTS)
def test_the_linear_model_is_the_derivative_of_the_rates(datum_cm: Quad, level_cm: Quad, pump_V: Pair) -> None:
    model = deep(datum_cm)
    A = linearise(model, level_cm).A
    for j in range(4):
        up, down = (
            np.array(level_rates(model, quad(h + (d if i == j else 0.0) for i, h in enumerate(level_cm)), pump_V))
            for d in (1e-5, -1e-5)
        )
        assert (up - down) / 2e-5 == pytest.approx(A[:, j], abs=1e-6)


@settings(max_examples=30)
@given(st.tuples(*[st.floats(0.0, 3.0)] * 4), st.tuples(*[st.floats(2.0, 18.0)] * 2))
def test_the_nearest_target_is_the_nearest_on_a_grid(datum_cm: Quad, lower_cm: Pair) -> None:
    model, limit_V = deep(datum_cm), (2.0, 1.5)
    found = nearest_reachable(model, lower_cm, limit_V)
    grid = np.linspace(0.0, 1.0, 201)
    v1, v2 = (axis.ravel() for axis in np.meshgrid(grid * limit_V[0], grid * limit_V[1]))
    flow = through_flow_matrix(model)[:2] @ np.array([v1, v2])
    speed_cm2 = np.array(model.outlet_cm2[:2])[:, None] * math.sqrt(2.0 * model.gravity_cm_s2)
    levels = np.maximum((flow / speed_cm2) ** 2 - np.array(datum_cm[:2])[:, None], 0.0)
    distance = ((levels - np.array(lower_cm)[:, None]) ** 2).sum(axis=0)
    own = sum((a - b) ** 2 for a, b in zip(found.lower_cm, lower_cm, strict=True))
    assume(min(found.lower_cm) > 0.0)
    assert own <= distance.min() + 1e-6
    assert equilibrium(model, found.holding_V)[:2] == pytest.approx(pair(found.lower_cm), abs=1e-6)
