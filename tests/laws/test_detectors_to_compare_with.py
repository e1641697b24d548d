"""The simple detectors: they find pumps, tell them apart, and leave a rig alone that differs from its file."""

from __future__ import annotations

import pytest

from hil.core.diagnosis.dedicated_observers import DedicatedObservers
from hil.core.diagnosis.detector import FaultDetector
from hil.core.diagnosis.gain_alarms import CONFIRM_S, RECOVERY_S, GainAlarms, judge
from hil.core.diagnosis.interacting_models import InteractingModels
from hil.core.diagnosis.missing_flow import pump_gains
from hil.core.diagnosis.sliding_mode import SlidingModeBank
from hil.core.tanks import equilibrium, holding_voltages, level_rates
from tests.laws.law_rigs import MINUS, MINUS_PLANT, lqr, raised, rest_outputs
from tools.law_trial import Course, Trial, drawn, run

REST = rest_outputs(MINUS_PLANT)
DETECTORS: dict[str, FaultDetector] = {
    "dedicated_observers": DedicatedObservers(MINUS),
    "sliding_mode": SlidingModeBank(MINUS),
    "interacting_models": InteractingModels(MINUS, 0.0023),
}
every_detector = pytest.mark.parametrize("name", DETECTORS)


def course(name: str, duration_s: float, fault: tuple[float, float], seed: int) -> Course:
    truth = drawn(MINUS, seed)
    h1, h2, _, _ = equilibrium(MINUS, MINUS_PLANT.operating_V)
    held_V = holding_voltages(truth, (h1, h2))
    faults, references = ((0.0, (1.0, 1.0)), (20.0, fault)), ((0.0, REST), (14.0, raised(REST, 0.2)))
    return run(
        lqr(MINUS_PLANT), MINUS, truth, Trial(duration_s, references, faults, given_V=held_V), seed, DETECTORS[name]
    )


@every_detector
@pytest.mark.parametrize(("fault", "target"), [((0.4, 1.0), 1), ((1.0, 0.5), 2)])
def test_a_pump_that_loses_gain_is_found_and_told_from_the_other(
    name: str, fault: tuple[float, float], target: int
) -> None:
    alarms = course(name, 26.0, fault, 3).alarms
    assert {alarm.target for alarm in alarms} == {target}
    assert 20.0 < alarms[0].detected_s < 22.5
    assert alarms[-1].size == pytest.approx(min(fault), abs=0.15)


@every_detector
def test_a_rig_that_differs_from_its_file_is_left_alone(name: str) -> None:
    assert course(name, 40.0, (1.0, 1.0), 11).alarms == ()


def test_missing_flow_gives_back_the_gains() -> None:
    level_cm, drive_V, theta = (12.0, 12.0, 1.5, 1.4), (3.0, 3.2), (0.4, 0.8)
    rates = level_rates(MINUS, level_cm, drive_V)
    weak = level_rates(MINUS, level_cm, (theta[0] * drive_V[0], theta[1] * drive_V[1]))
    inflow = [now - then for now, then in zip(weak, rates, strict=True)]
    assert pump_gains(MINUS, inflow, drive_V, (1.0, 1.0)) == pytest.approx(theta)
    assert pump_gains(MINUS, inflow, (0.0, 0.0), (0.9, 0.7)) == (0.9, 0.7)


def test_an_alarm_needs_time_and_so_does_a_recovery() -> None:
    memory, detected_s, recovered_s = GainAlarms(), list[float](), list[float]()
    for k in range(200):
        gain = 0.5 if 1.0 <= 0.1 * k < 5.0 else 1.0
        memory, diagnosis = judge(memory, 0.1 * k, (gain, 1.0), (0.0, 0.0))
        detected_s += [alarm.detected_s for alarm in diagnosis.new_alarms if not alarm.is_recovery]
        recovered_s += [alarm.detected_s for alarm in diagnosis.new_alarms if alarm.is_recovery]
    assert detected_s[0] == pytest.approx(1.0 + CONFIRM_S)
    assert recovered_s == pytest.approx([5.0 + RECOVERY_S])
