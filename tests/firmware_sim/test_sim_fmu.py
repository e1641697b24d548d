"""The co-simulation unit beside the emulator: other people's FMI reader drives it, the levels are the same."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from firmware_sim.faults import Fault, pump_faults, sensor_faults, tank_faults
from firmware_sim.faults.catalogue import kinds_in
from firmware_sim.fmu.variables import INPUT_OF_KIND, variables
from firmware_sim.parameter_spread import drawn
from firmware_sim.settings import equilibrium_cm
from tests.firmware_sim.fault_bench import fault
from tests.firmware_sim.fmu_bench import (
    LEVELS,
    NAMES,
    Change,
    UnitFile,
    at_2_s,
    largest_difference,
    moved,
    rig_values,
    run_rig,
    run_unit,
)
from tests.firmware_sim.sim_bench import ROOT, SECOND, emulator, shipped

ROUNDING = 1e-9
"""In cm and cm3."""


def test_the_unit_starts_where_the_emulator_does(unit: UnitFile) -> None:
    with unit.instance() as instance:
        assert instance.start().get(*LEVELS) == pytest.approx(equilibrium_cm(shipped()), abs=1e-12)


def test_levels_and_volumes_are_those_of_the_emulator(unit: UnitFile) -> None:
    assert largest_difference(unit, shipped(), moved, 30.0).max() < ROUNDING


RIGS: dict[str, dict[str, dict[str, Any]]] = {
    "dead zone and curve": {"pumps": {"dead_zone_V": [0.8, 0.3], "curve_1_V": [0.05, -0.02]}},
    "delay": {"pumps": {"delay_s": [0.75, 1.333], "lag_s": 0.0}},
    "delay and wear": {"pumps": {"delay_s": 0.5, "wear_per_h": [2.0, 5.0]}},
    "different lags": {"pumps": {"lag_s": [0.05, 3.0]}},
    "low outlets": {"tanks": {"datum_cm": [1.0, 0.0, 2.5, 4.0]}},
    "empty at the start": {"tanks": {"start_V": [0.0, 0.0]}},
    "empty, with low outlets": {"tanks": {"start_V": [0.0, 0.0], "datum_cm": 3.0}},
    "overflow into lower tanks": {
        "tanks": {"height_cm": [14.0, 13.0, 2.0, 1.6], "overflow_to_lower": [0.7, 1.0], "start_V": [3.0, 3.0]}
    },
    "other phase": {"pumps": {"valve_split": [0.35, 0.25]}, "tanks": {"start_V": [2.0, 2.0]}},
}


@pytest.mark.parametrize("rig", RIGS)
def test_a_rig_as_it_is_acts_as_in_the_emulator(unit: UnitFile, rig: str) -> None:
    settings = emulator(**RIGS[rig])
    assert largest_difference(unit, settings, moved, 20.0).max() < ROUNDING


def test_overflow_and_empty_tanks_are_reached() -> None:
    """The cases above are what their names say."""
    full = run_rig(emulator(**RIGS["overflow into lower tanks"]), [], moved, 20.0).values[-1]
    assert full[NAMES.index("spilled_cm3")] > full[NAMES.index("caught_cm3")] > 1.0
    empty = run_rig(emulator(**RIGS["empty at the start"]), [], moved, 20.0).values
    assert empty[:, 2:4].min() == 0.0


def test_tanks_that_run_empty_are_those_of_the_emulator(unit: UnitFile) -> None:
    settings = emulator(tanks={"start_V": [0.6, 0.6]})
    truth = run_rig(settings, [], lambda _t_s: (0.0, 0.0), 20.0)
    assert truth.values[-1][2:4].tolist() == [0.0, 0.0]
    assert truth.values[0][2:4].min() > 0.05
    assert largest_difference(unit, settings, lambda _t_s: (0.0, 0.0), 20.0).max() < ROUNDING


FAULTS: dict[str, tuple[Fault, list[Change]]] = {
    "pump_effectiveness": (fault("pump_effectiveness", 1, 0.4, at_s=2.0), at_2_s(effectiveness1=0.4)),
    "pump_dead": (fault("pump_dead", 2, at_s=2.0), at_2_s(effectiveness2=0.0)),
    "pump_lag": (fault("pump_lag", 1, 4.0, at_s=2.0), at_2_s(lag1_s=4.0)),
    "valve_split": (fault("valve_split", 2, 0.1, at_s=2.0), at_2_s(split2=0.1)),
    "reservoir_low": (fault("reservoir_low", at_s=2.0), at_2_s(effectiveness1=0.0, effectiveness2=0.0)),
    "leak": (fault("leak", 3, 2.0, at_s=2.0), at_2_s(leak3=2.0)),
    "outlet_block": (fault("outlet_block", 1, 0.9, at_s=2.0), at_2_s(blocked1=0.9)),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_input_acts_as_the_fault_of_the_emulator(unit: UnitFile, kind: str) -> None:
    assert largest_difference(unit, shipped(), moved, 10.0, [FAULTS[kind]]).max() < ROUNDING
    healthy = run_rig(shipped(), [], moved, 10.0)
    with unit.instance() as instance:
        values = run_unit(instance.start(), [*healthy.changes, *FAULTS[kind][1]], healthy.samples_ns, LEVELS)
    assert np.abs(values - healthy.values[:, :4]).max() > 0.1


def test_faults_together_with_low_outlets_and_delay(unit: UnitFile) -> None:
    settings = emulator(tanks={"datum_cm": 2.0}, pumps={"delay_s": 0.3})
    together = [FAULTS[kind] for kind in ("leak", "outlet_block", "valve_split", "pump_effectiveness")]
    assert largest_difference(unit, settings, moved, 20.0, together).max() < ROUNDING


def test_every_fault_of_process_and_sensors_has_its_input_or_none(unit: UnitFile) -> None:
    assert list(INPUT_OF_KIND) == list(kinds_in((pump_faults, tank_faults, sensor_faults)))
    inputs = {one.name for one in unit.description.modelVariables if one.causality == "input"}
    for text in INPUT_OF_KIND.values():
        named = re.findall(r"\w+N\w*|\w+[12]\b", text)
        assert bool(named) == bool(text)
        assert {name.replace("N", "1") for name in named} <= inputs


def test_the_page_says_which_input_plays_which_fault() -> None:
    page = (ROOT / "docs/how-to/plant-elsewhere.md").read_text(encoding="utf-8")
    for kind, text in INPUT_OF_KIND.items():
        assert f"| `{kind}` | {text or 'none: replace hN_V'} |\n" in page


def test_the_page_has_every_variable(unit: UnitFile) -> None:
    page = (ROOT / "docs/how-to/plant-elsewhere.md").read_text(encoding="utf-8")
    for one in unit.description.modelVariables:
        assert f"`{re.sub('(?<=[a-z])(?<!cm)(?<!_s)[1-4]', 'N', one.name, count=1)}`" in page, one.name


def test_a_level_signal_is_that_of_the_sensor_with_its_faults(unit: UnitFile) -> None:
    settings = emulator(
        sensors={
            "gain_V_cm": [0.5, -0.4, 0.5, 0.5],
            "offset_V": [0.1, 9.0, 0.0, 0.0],
            "scale_error": [0.02, 0.0, 0.0, 0.0],
        }
    )
    with unit.instance() as instance:
        instance.start(**rig_values(settings))
        h1, h2, h3, _ = instance.get(*LEVELS)
        instance.set(bias2_V=-0.3, scale_error3=-0.1)
        signals = instance.get("h1_V", "h2_V", "h3_V")
    assert signals == pytest.approx([0.1 + 0.5 * 1.02 * h1, 9.0 - 0.4 * h2 - 0.3, 0.5 * 0.9 * h3], abs=1e-12)


def test_flows_are_the_rates_of_the_volumes(unit: UnitFile) -> None:
    with unit.instance() as instance:
        instance.start(v1_applied_V=6.0, v2_applied_V=2.0, leak3=1.0, lag1_s=0.0, lag2_s=0.0)
        instance.step(0, SECOND)
        before = instance.get("pumped_cm3", "drained_cm3")
        flows = instance.get("flow1_cm3_s", "flow2_cm3_s", "drain1_cm3_s", "drain2_cm3_s")
        instance.step(SECOND, SECOND + 10_000)
        after = instance.get("pumped_cm3", "drained_cm3")
    rates = [(one - other) / 1e-5 for one, other in zip(after, before, strict=True)]
    assert [sum(flows[:2]), sum(flows[2:])] == pytest.approx(rates, rel=1e-5)


def test_the_step_of_the_other_side_does_not_matter(unit: UnitFile) -> None:
    """Steps that end on level periods give the same bits; others the same levels, but other volumes at a rim."""
    settings = emulator(tanks=RIGS["overflow into lower tanks"]["tanks"], pumps={"delay_s": 0.313})
    ends = []
    for period_ns in (20_000_000, 100_000_000, 1_000_000_000, 7_300_000):
        moments = [*range(period_ns, 4 * SECOND, period_ns), 4 * SECOND]
        with unit.instance() as instance:
            instance.start(**rig_values(settings) | {"v1_applied_V": 9.0, "v2_applied_V": 8.0})
            run_unit(instance, [], moments, ())
            ends.append(np.array(instance.get(*NAMES)))
    assert np.array_equal(ends[0], ends[1])
    assert np.array_equal(ends[0], ends[2])
    assert np.abs(ends[3] - ends[0])[:4].max() < 1e-6
    assert ends[3] == pytest.approx(ends[0], rel=3e-4)


def test_drawn_parameters_are_those_of_the_seed(unit: UnitFile) -> None:
    """Also where a drawn value lies outside the range of the setting."""
    settings = emulator(
        pumps={"lag_s": 60.0, "lag_spread": 0.5}, sensors={"scale_error": 0.1}, tanks={"start_V": [2.5, 2.5]}
    ).model_copy(update={"parameter_spread": 0.1})
    one = rig_values(drawn(settings, 1))
    truth = run_rig(settings, [], moved, 10.0)
    with unit.instance() as instance:
        instance.start(**one | {name: min(one[name], 60.0) for name in ("lag1_s", "lag2_s")})
        assert instance.get(*LEVELS) == pytest.approx(truth.values[0][:4], abs=1e-12)
    lags = [variable for variable in variables(drawn(settings, 1)) if variable.name in ("lag1_s", "lag2_s")]
    assert max(lag.start or 0.0 for lag in lags) > 60.0
    assert all(lag.low == 0.0 and lag.start is not None and lag.high == max(60.0, lag.start) for lag in lags)
