"""How far parameters have moved from the file, by the record of an ordinary run."""

from dataclasses import replace

import numpy as np
import pytest

from hil.core.identification.drift import ALL_CHECKED, drift_of, rate_per_hour
from hil.core.identification.parameters import RigModel, values_of, with_values
from hil.core.identification.records import LevelRecord
from hil.core.tanks import equilibrium
from hil.core.uncertainty import Uncertainty
from tests.identification.made_records import record_of

FILE = RigModel()
SHARES = Uncertainty((0.03, 0.03), (0.03, 0.03), (0.03,) * 4, (0.5, 0.5))
PERIOD_S = 0.1


def moved_run(truth: RigModel, *, seed: int = 1, second: bool = True) -> LevelRecord:
    """150 s from the equilibrium at 3 V, with steps of pump 1, and of pump 2 if wanted."""
    voltage_V = np.full((1500, 2), 3.0)
    voltage_V[200:600, 0], voltage_V[600:1000, 0], voltage_V[1000:, 0] = 3.6, 2.6, 3.2
    if second:
        voltage_V[400:800, 1], voltage_V[800:, 1] = 2.5, 3.5
    return record_of(truth, voltage_V, PERIOD_S, equilibrium(truth.tanks, (3.0, 3.0)), seed=seed)


def test_a_pump_that_gives_less_is_found_and_nothing_else_has_moved() -> None:
    """3.1 % is nothing to a file that is sure of its pumps to 3 % only, and much to one that claims 0.1 %."""
    truth = with_values(FILE, {"k1": 0.969 * values_of(FILE)["k1"]})
    drift = drift_of(moved_run(truth), FILE, SHARES)
    pump = drift["k1"]
    assert pump.share == pytest.approx(-0.031, abs=0.003)
    assert pump.shift_sd == pytest.approx(-1.03, abs=0.1)
    assert replace(pump, file_sd=0.001 * pump.file).shift_sd < -5.0
    for one in drift.moved:
        assert abs(one.estimate - values_of(truth)[one.name]) < 4.0 * one.sd, one


def test_a_lively_rig_determines_less_but_nothing_wrong() -> None:
    """Residuals that wander for a minute used to give intervals that were three times too narrow."""
    quiet = moved_run(FILE)
    random, wander = np.random.default_rng(2), np.zeros_like(quiet.reading_V)
    left = np.exp(-PERIOD_S / 60.0)
    for row in range(1, len(wander)):
        wander[row] = left * wander[row - 1] + 0.04 * np.sqrt(1.0 - left**2) * random.standard_normal(4)
    drift = drift_of(replace(quiet, reading_V=quiet.reading_V + wander), FILE, SHARES)
    assert len(drift.undetermined) >= 4
    for one in drift.moved:
        assert abs(one.estimate - one.file) < 4.0 * one.sd, one


def test_an_idle_pump_is_not_determined() -> None:
    drift = drift_of(moved_run(FILE, second=False), FILE, SHARES)
    assert "k2" in drift.undetermined
    assert "a1" not in drift.undetermined


def test_a_run_at_rest_and_a_short_one_say_why_they_determine_nothing() -> None:
    voltage_V = np.full((1500, 2), 3.0)
    rest = record_of(FILE, voltage_V, PERIOD_S, equilibrium(FILE.tanks, (3.0, 3.0)))
    assert drift_of(rest, FILE, SHARES).why == "no pump was moved by 0.2 V"
    short = record_of(FILE, voltage_V[:100], PERIOD_S, equilibrium(FILE.tanks, (3.0, 3.0)))
    drift = drift_of(short, FILE, SHARES)
    assert drift.why == "less than 60 s without a fault"
    assert drift.undetermined == ALL_CHECKED


def test_a_rate_over_runs_has_its_uncertainty() -> None:
    hours = np.array([0.0, 10.0, 20.0])
    rate, sd = rate_per_hour(hours, -0.001 * hours, np.full(3, 0.002))
    assert rate == pytest.approx(-0.001)
    assert sd == pytest.approx(0.002 / np.sqrt(200.0))
