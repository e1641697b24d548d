"""The course of a fault in time, and the detector `ideal` that follows it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from firmware_sim.faults import NS_PER_S, FaultSchedule, PumpEffectiveness
from hil.bench.detectors import known_pump_faults
from hil.core.diagnosis.ideal import IdealDetector, PumpFault
from hil.core.fault_course import FaultCourse
from hil.core.types import Alarm
from hil.edge.config.scenario_file import Scenario, load_scenario
from hil.edge.config.settings_file import SettingsError, validated
from hil.review.alarms import injected
from tests.core.core_bench import NO_ESTIMATE, NO_MEASUREMENT


def test_a_growing_fault_goes_linearly_from_healthy_to_its_value() -> None:
    course = FaultCourse(10.0, 100.0, ramp_s=40.0)
    sizes = [course.size(t_s, 1.0, 0.2) for t_s in (9.0, 10.0, 20.0, 30.0, 50.0, 99.0, 100.0)]
    assert sizes == pytest.approx([1.0, 1.0, 0.8, 0.6, 0.2, 0.2, 1.0])


def test_an_abrupt_fault_has_its_size_at_once() -> None:
    assert [FaultCourse(10.0).size(t_s, 0.0, 0.3) for t_s in (9.999, 10.0, 1e9)] == [0.0, 0.3, 0.3]


def test_growth_does_not_wait_while_an_intermittent_fault_is_away() -> None:
    course = FaultCourse(0.0, ramp_s=10.0, period_s=4.0, duty=0.5)
    sizes = [course.size(t_s, 1.0, 0.0) for t_s in (1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0)]
    assert sizes == pytest.approx([0.9, 1.0, 0.5, 1.0, 0.1, 1.0, 0.0])


def followed(fault: PumpFault, until_s: float) -> tuple[list[float], list[Alarm]]:
    """What the ideal detector without delay says of the fault's pump at every 0.1 s."""
    detector = IdealDetector((fault,), 0.0)
    memory, shares = detector.start(), []
    alarms: list[Alarm] = []
    for step in range(round(until_s * 10) + 1):
        memory, diagnosis = detector.step(memory, step / 10, NO_MEASUREMENT, NO_ESTIMATE, (3.0, 3.0))
        shares.append(diagnosis.effectiveness[fault.target - 1])
        alarms += diagnosis.new_alarms
    return shares, alarms


def test_the_ideal_detector_follows_a_growing_loss_under_one_number() -> None:
    """An alarm at every control step would fill the record; the law still gets the size of every step."""
    shares, alarms = followed(PumpFault(1.0, 2, 0.5, ramp_s=100.0), 120.0)
    assert shares[510] == pytest.approx(0.75)
    assert shares[-1] == 0.5
    assert {alarm.number for alarm in alarms} == {2}
    assert 45 <= len(alarms) <= 51
    assert alarms[-1].size == 0.5
    assert not any(alarm.is_recovery for alarm in alarms)


def test_the_ideal_detector_sees_an_intermittent_loss_come_and_go() -> None:
    _, alarms = followed(PumpFault(1.0, 1, 0.5, until_s=11.0, period_s=5.0, duty=0.4), 20.0)
    assert [(alarm.detected_s, alarm.size, alarm.is_recovery) for alarm in alarms] == [
        (1.0, 0.5, False),
        (3.0, 1.0, True),
        (6.0, 0.5, False),
        (8.0, 1.0, True),
    ]


GROWING = """
[scenario]
name = "growing"
duration_s = 60.0

[[fault]]
at_s = 2.0
kind = "pump_effectiveness"
target = 1
value = 0.3
ramp_s = 20.0
period_s = 8.0
duty = 0.75
until_s = 50.0

[[fault]]
at_s = 30.0
kind = "pump_effectiveness"
target = 1
value = 0.9
ramp_s = 4.0
until_s = 40.0
"""


def test_scenario_emulator_and_review_agree_on_growing_and_intermittent_faults() -> None:
    table = tomllib.loads(GROWING)
    detector = IdealDetector(known_pump_faults(validated(Scenario, table, "growing.toml")), 0.0)
    schedule = FaultSchedule(tuple(PumpEffectiveness.model_validate(fault) for fault in table["fault"]))
    schedule.start(0)
    played = injected(table["fault"])
    for tenth in range(600):
        t_s = tenth / 10 + 0.05
        schedule.advance(round(t_s * NS_PER_S))
        _, diagnosis = detector.step((1.0, 1.0), t_s, NO_MEASUREMENT, NO_ESTIMATE, (3.0, 3.0))
        there = [fault for fault in played if fault.course.is_present(t_s)]
        left = there[-1].course.size(t_s, 1.0, there[-1].value) if there else 1.0
        assert schedule.effects.effectiveness[0] == pytest.approx(diagnosis.effectiveness[0], abs=1e-7) == left, t_s


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (("ramp_s = 20.0", "ramp_s = -1.0"), "fault[0].ramp_s"),
        (("ramp_s = 20.0", "ramp_s = inf"), "fault[0].ramp_s"),
        (("duty = 0.75", "duty = 1.0"), "fault[0].duty"),
        (("period_s = 8.0", "period_s = 0.0"), "fault[0].period_s"),
        (("duty = 0.75\n", ""), "an intermittent fault needs both"),
        (("period_s = 8.0\n", ""), "an intermittent fault needs both"),
    ],
)
def test_a_course_that_can_t_be_is_refused(change: tuple[str, str], named: str, tmp_path: Path) -> None:
    file = tmp_path / "growing.toml"
    file.write_text(GROWING.replace(*change, 1))
    with pytest.raises(SettingsError) as caught:
        load_scenario(file)
    assert str(file) in str(caught.value)
    assert named in str(caught.value)
