"""The derivatives of the simulation and of the residuals, against central differences of the values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.core.identification.parameters import PARAMETERS, RigModel, values_of, with_values
from hil.core.identification.records import LevelRecord, RulerReading
from hil.core.identification.residuals import whitened
from hil.core.identification.simulation import LEVELS, levels
from tests.identification.made_records import Array, record_of, steps

INITIAL = (1.0, 0.6, 2.0, 0.3)
NAMES = (*(row.name for row in PARAMETERS if not row.group.startswith("sensor")), *LEVELS)


def drawn(seed: int) -> RigModel:
    """A rig with all that the model has, and low rims, so that its tanks run empty and over."""
    random = np.random.default_rng(seed)
    values = values_of(RigModel())
    for name, value in values.items():
        values[name] = value * random.uniform(0.7, 1.4)
    ranges = {"dead_zone": 1.0, "curve": 0.03, "delay": 0.7, "datum": 3.0, "overflow": 1.0, "sensor_offset": 0.2}
    for name in values:
        if (top := ranges.get(name.rstrip("1234"))) is not None:
            values[name] = random.uniform(0.05, 1.0) * top
        if name.startswith("gamma"):
            values[name] = random.uniform(0.3, 0.7)
    rig = with_values(RigModel(), values)
    return replace(rig, tanks=replace(rig.tanks, height_cm=(6.0, 5.0, 3.0, 2.5), arriving=(0.9, 1.0)))


def voltages(seed: int) -> Array:
    voltage_V = steps(seed, 120.0, 0.1, low_V=0.0, high_V=9.0, hold_s=15.0)
    voltage_V[300:600] = 0.0
    return voltage_V


def levels_at(rig: RigModel, record: LevelRecord, name: str, change: float) -> Array:
    initial = list(INITIAL)
    if name in LEVELS:
        initial[LEVELS.index(name)] += change
    else:
        rig = with_values(rig, {name: values_of(rig)[name] + change})
    return levels(rig, record, (initial[0], initial[1], initial[2], initial[3])).level_cm


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_derivatives_are_those_of_the_computed_levels_also_where_tanks_are_empty_and_spill(seed: int) -> None:
    rig = drawn(seed)
    record = record_of(rig, voltages(seed), 0.1, INITIAL)
    simulated = levels(rig, record, INITIAL, NAMES)
    tops = np.array(rig.tanks.height_cm)
    assert (simulated.level_cm[:, 2:] == tops[2:]).any()
    assert (simulated.level_cm == 0.0).any()
    for column, name in enumerate(NAMES):
        h = 1e-6
        expected = (levels_at(rig, record, name, h) - levels_at(rig, record, name, -h)) / (2.0 * h)
        off = simulated.by[:, :, column] - expected
        scale = np.sqrt(np.mean(expected**2))
        # by the delay the grid of steps moves, and with it the step in which a tank runs empty
        allowed = 0.02 if name.startswith("delay") else 1e-4
        assert np.sqrt(np.mean(off**2)) <= allowed * scale + 1e-9, name


def test_derivatives_in_chosen_rows_are_those_of_all_rows() -> None:
    rig = drawn(4)
    record = record_of(rig, voltages(4), 0.1, INITIAL)
    some = np.array([3, 40, 41, 1100], dtype=np.int64)
    full, part = levels(rig, record, INITIAL, NAMES), levels(rig, record, INITIAL, NAMES, some)
    assert np.array_equal(part.by, full.by[some])
    assert np.array_equal(part.level_cm, full.level_cm)


def test_derivatives_of_residuals_of_sensors_saturated_readings_and_the_ruler() -> None:
    rig = drawn(5)
    record = record_of(rig, voltages(5), 0.1, INITIAL, saturation_V=(0.25, 1.5))
    record = replace(record, ruler=(RulerReading(33.33, 2, 1.0), RulerReading(80.0, 0, 2.0)))
    names = ("k1", "a3", "sensor_gain1", "sensor_gain2", "sensor_offset1", "sensor_offset4")
    noise_V = (0.02, 0.03, 0.02, 0.05)

    def at(model: RigModel) -> tuple[Array, Array]:
        simulated = levels(model, record, INITIAL, names[:2])
        found = whitened(model, record, simulated, noise_V, (0, 1), names)
        return found.flat, found.flat_jacobian

    residual, jacobian = at(rig)
    low_V, high_V = record.ends
    assert (record.reading_V <= low_V).any()
    assert (record.reading_V >= high_V).any()
    assert len(residual) == 4 * len(record.time_s) + 2
    for column, name in enumerate(names):
        h = 1e-6
        up, down = (at(with_values(rig, {name: values_of(rig)[name] + change}))[0] for change in (h, -h))
        assert jacobian[:, column] == pytest.approx((up - down) / (2.0 * h), rel=1e-3, abs=2e-3), name


def test_a_saturated_reading_says_nothing_where_the_prediction_lies_beyond_the_same_end() -> None:
    rig = RigModel()
    n = 50
    record = LevelRecord(
        "over", np.arange(n, dtype=float) * 0.1, np.full((n, 2), 3.0), np.full((n, 4), 4.0), saturation_V=(0.0, 4.0)
    )
    found = whitened(rig, record, levels(rig, record, (12.0,) * 4, ("k1",)), rig.noise_V, (0,), ("k1",))
    assert np.abs(found.residual).max() < 1e-6
    below = whitened(rig, record, levels(rig, record, (7.0,) * 4, ("k1",)), rig.noise_V, (0,), ("k1",))
    assert below.residual[0] == pytest.approx([(3.996 - 3.5) / 0.005] * 4, rel=0.01)
