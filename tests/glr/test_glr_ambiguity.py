"""Drift or level: compared from one onset, asked while it is open, proven by a movement of the pumps only."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.core.diagnosis.glr import ambiguity, drift_review
from hil.core.diagnosis.glr.filter import ENTRY, PERIOD, VOLTAGE
from hil.core.diagnosis.glr.hypotheses import BOTH, JUMPS, ROWS, VARIANTS, H, drift_of, outlet_of
from hil.core.diagnosis.glr.memory_parts import Lost
from hil.core.diagnosis.glr.model import BIAS, DRIFT, LEVEL, OUTLET, N
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.types import OpenQuestion

CONFIG: Any = SimpleNamespace(tuning=Tuning(), model=SimpleNamespace(level_gain_V_cm=0.5))


def memory(**fields: Any) -> Any:
    """What the functions here look at: replays without evidence, no alarm, pumps at 3 V."""
    replays = SimpleNamespace(
        evidence=np.zeros(ROWS), x=np.zeros((ROWS, N)), before=np.zeros((ROWS, N)), target=np.full(ROWS, -1)
    )
    entry = np.zeros(ENTRY)
    entry[VOLTAGE : VOLTAGE + 2], entry[PERIOD] = 3.0, 0.1
    return SimpleNamespace(
        **(
            {"replays": replays, "suspicion": None, "rival": None, "lost": {}, "entry": entry, "is_wide": False}
            | fields
        )
    )


def suspicion(**fields: Any) -> Any:
    return SimpleNamespace(**({"number": 7, "leader": None, "mean_V": None, "moved_s": 0.0} | fields))


@pytest.mark.parametrize("tank", [1, 2])
def test_the_outlet_is_compared_with_the_drift_from_the_same_onset(tank: int) -> None:
    """With a later onset of its own it lost by 13 while both looked the same, and a blockage was declared a drift."""
    aligned = [way for way in VARIANTS if way.onset_of is not None and way.number == outlet_of(tank)]
    assert [JUMPS[way.onset_of or 0].state for way in aligned] == [DRIFT + tank - 1]
    assert all(way.rate > 0.0 for way in aligned)


@pytest.mark.parametrize(("state", "tank"), [(OUTLET, 1), (OUTLET + 1, 2), (DRIFT, 1), (DRIFT + 1, 2)])
def test_the_question_is_open_while_either_explanation_is_the_likeliest(state: int, tank: int) -> None:
    leader = next(n for n, jump in enumerate(JUMPS) if jump.state == state)
    m = memory(suspicion=suspicion(leader=leader))
    m.replays.x[drift_of(tank), LEVEL + tank - 1] = 12.0
    m.replays.x[outlet_of(tank), LEVEL + tank - 1] = 12.5
    assert ambiguity.open_question(CONFIG, m) == OpenQuestion(alarm=7, tank=tank, apart_cm=0.5)


@pytest.mark.parametrize(
    "open_alarm", [None, suspicion(), suspicion(leader=BOTH), suspicion(leader=0), suspicion(leader=2, number=None)]
)
def test_no_question_about_other_faults(open_alarm: Any) -> None:
    assert ambiguity.open_question(CONFIG, memory(suspicion=open_alarm)) is None


def rival(lead: float = 30.0, moved_lead: float = 0.0, sensor: int = 0) -> Any:
    own_x, own_P = np.zeros(N), np.zeros((N, N))
    own_x[LEVEL + sensor] = 2.0
    own_x[BIAS + sensor], own_P[BIAS + sensor, BIAS + sensor] = 0.5, 0.02**2
    number = outlet_of(sensor + 1) if sensor < 2 else 0
    return SimpleNamespace(
        number=number,
        sensor=sensor,
        suspicion=suspicion(),
        lead=lead,
        moved_lead=moved_lead,
        mean_V=np.array([3.0, 3.0]),
        own_x=own_x,
        own_P=own_P,
        x=np.full(N, 0.25),
    )


def test_a_declared_drift_is_asked_about_until_a_movement_has_spoken_for_it() -> None:
    asked = ambiguity.open_question(CONFIG, memory(rival=rival()))
    assert asked == OpenQuestion(alarm=7, tank=1, apart_cm=1.75)
    assert ambiguity.open_question(CONFIG, memory(rival=rival(moved_lead=20.0))) is None
    assert ambiguity.open_question(CONFIG, memory(rival=rival(sensor=2))) is None


def proven(moved_V: float, gain: float = 25.0, **more: Any) -> float:
    """What is proven of sensor 1 after one step with this movement and this gain of the drift's lead."""
    m = memory(lost={0: Lost("sensor_drift", 7, 0.0)})
    m.entry[VOLTAGE] += moved_V
    drift_review._prove(CONFIG, m, rival(**more), m.lost[0], gain)
    return float(m.lost[0].proven_V)


def test_only_a_movement_proves_what_a_sensor_reads_too_high() -> None:
    """At rest a lead is luck, or the shape of the growth; the interlocks keep the sensor's veto then."""
    assert proven(0.3) == pytest.approx(0.5 - 3.0 * 0.02 - 0.1 * 0.5 * 2.0)
    assert proven(-0.3) == pytest.approx(0.34)
    assert proven(0.1) == 0.0
    assert proven(0.3, gain=19.0) == 0.0
    assert proven(0.3, lead=19.0) == 0.0


def test_a_movement_counts_from_some_time_on() -> None:
    m = memory(suspicion=suspicion())
    for step in range(300):
        m.entry[VOLTAGE] = 3.3 if step >= 50 else 3.0
        ambiguity.watch_movement(m)
        if step == 240:
            assert not ambiguity.has_moved(m)
    assert ambiguity.has_moved(m)


def test_a_drift_too_small_to_be_declared_is_not_replaced_by_what_is_far_behind() -> None:
    """Near 1 mV/s the drift led a weaker pump by 57, fell below the smallest size, and the pump was declared; then two
    sensors, and the run tripped as `sensors_lost`."""
    m = memory()
    m.replays.evidence[drift_of(1)], m.replays.evidence[0] = 141.8, 84.7
    m.replays.x[drift_of(1), DRIFT] = -0.00098
    assert ambiguity.is_led_by_small(m, 0)
    m.replays.x[drift_of(1), DRIFT] = -0.00102
    assert not ambiguity.is_led_by_small(m, 0)
    assert not ambiguity.is_led_by_small(m, drift_of(1))
    assert H > 0


@pytest.mark.parametrize("tank", [1, 2])
def test_a_leak_that_hardly_leads_the_drift_is_declared_as_the_drift(tank: int) -> None:
    """A second fault cut the time short: a falling drift was called a leak, and the tank would have filled."""
    m, outlet, drift = memory(), outlet_of(tank), drift_of(tank)
    evidence = np.zeros(H + 1)
    evidence[outlet], evidence[drift] = 30.0, 30.0 - 0.9 * Tuning().margin
    m.replays.x[outlet, OUTLET + tank - 1] = 0.2
    assert ambiguity.safer(CONFIG, m, outlet, evidence) == drift
    assert ambiguity.safer(CONFIG, m, drift, evidence) == drift
    evidence[drift] = 30.0 - 1.1 * Tuning().margin
    assert ambiguity.safer(CONFIG, m, outlet, evidence) == outlet, "it leads by the margin"


@pytest.mark.parametrize(
    ("is_wide", "evidence", "lead", "is_open"),
    [
        (True, 20000.0, 39.0, True),
        (True, 20000.0, 46.0, False),
        (True, 250.0, 9.0, False),
        (False, 20000.0, 11.0, False),
    ],
)
def test_what_the_model_errs_by_grows_with_what_it_explains(
    evidence: float, lead: float, *, is_wide: bool, is_open: bool
) -> None:
    """A drift of -50 mV/s was a leak on an unknown rig, and 599 cm3 went over the rim."""
    m, outlet, drift = memory(is_wide=is_wide), outlet_of(2), drift_of(2)
    m.replays.evidence[outlet], m.replays.evidence[drift] = evidence, evidence - lead
    m.replays.x[outlet, OUTLET + 1] = 0.5
    assert ambiguity.is_drift_or_level(CONFIG, m, outlet, is_late=False) is is_open
    safer = ambiguity.safer(CONFIG, m, outlet, m.replays.evidence)
    assert safer == (drift if is_open else outlet)


@pytest.mark.parametrize("number", [0, BOTH, outlet_of(1)])
def test_what_does_not_fill_a_tank_stays_as_it_is(number: int) -> None:
    m = memory()
    m.replays.x[outlet_of(1), OUTLET] = -0.2
    assert ambiguity.safer(CONFIG, m, number, np.zeros(H + 1)) == number
