"""The tuning's defaults, where they show: in the page that explains them, and in what they limit."""

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from hil.core.diagnosis.glr import stuck_check
from hil.core.diagnosis.glr.filter import READING, VARIANCE, VOLTAGE
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Declared, StuckCheck, Suspicion
from hil.core.diagnosis.glr.model import LAG
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.types import Measurement
from tests.glr.glr_bench import DETECTOR, NO_ESTIMATE, PERIOD_S

PAGE = Path(__file__).parents[2] / "docs/explanation/diagnosis.md"
UNITS = {"%": 0.01, "mV": 1e-3}


def documented() -> dict[str, float]:
    """The defaults of the page's table of tuning constants, in the units of `Tuning`."""
    found = {}
    for line in PAGE.read_text().splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        names = re.findall(r"`(\w+)`", cells[1]) if len(cells) > 3 else []
        if names and all(name in Tuning.__dataclass_fields__ for name in names):
            for name, value in zip(names, cells[2].split(", "), strict=True):
                number, _, unit = value.partition(" ")
                found[name] = float(number) * UNITS.get(unit, 1.0)
    return found


def test_the_defaults_are_those_that_the_documentation_gives() -> None:
    """A default changed by 10 % shows in a campaign only; a change needs numbers before and after, and this page."""
    page = documented()
    assert len(page) >= 20
    assert {name: getattr(Tuning(), name) for name in page} == pytest.approx(page)


def test_every_constant_is_explained() -> None:
    explained = str(Tuning.__doc__)
    assert [field.name for field in fields(Tuning) if not re.search(rf"\b{field.name}\b", explained)] == []


def a_memory() -> Memory:
    """The detector's memory after half a minute of readings without any noise, at rest."""
    level_V = (6.2, 6.4, 0.8, 0.7)
    reading = Measurement(level_V, (True,) * 4, 0.0, 5, (0.0,) * 4, (0.0,) * 4)
    memory: Memory | None = None
    for number in range(300):
        memory, _ = DETECTOR.step(memory, number * PERIOD_S, reading, NO_ESTIMATE, (3.0, 3.0))
    assert memory is not None
    return memory


def test_a_mean_of_many_quiet_readings_is_trusted_to_half_a_millivolt() -> None:
    memory = a_memory()
    DETECTOR._note(
        memory, memory.t_s + PERIOD_S, Measurement((6.2, 6.4, 0.8, 0.7), (True,) * 4, 0.0, 1_000_000), (3, 3)
    )
    used = np.isfinite(memory.entry[READING : READING + 4])
    assert used.any()
    std_V = np.sqrt(memory.entry[VARIANCE : VARIANCE + 4] / memory.scale)[used]
    assert std_V == pytest.approx(np.full(len(std_V), 5e-4), rel=0.01)


def a_stuck_check(memory: Memory, pump: int) -> StuckCheck:
    memory.declared[pump] = Declared("pump_effectiveness", -0.4, 1.0, 7, 20.0, 21.0)
    check = memory.stuck_checks[pump] = StuckCheck(
        pump=pump,
        number=7,
        detected_s=20.0,
        onset_s=19.5,
        until_s=memory.t_s + 5.0,
        voltage_V=3.0,
        patience_s=0.0,
        x=memory.x.copy(),
        P=memory.P.copy(),
        growing_x=memory.x.copy(),
        growing_P=memory.P.copy(),
    )
    return check


@pytest.mark.parametrize("pump", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("moved", "is_stuck"), [(0.145, False), (0.155, True)])
def test_a_pump_is_stuck_only_when_its_voltage_has_moved_by_15_per_cent(
    pump: int, sign: float, moved: float, is_stuck: bool
) -> None:
    memory = a_memory()
    check = a_stuck_check(memory, pump)
    memory.entry[VOLTAGE + pump] = check.voltage_V * (1.0 + sign * moved)
    enough = 1.01 * DETECTOR.config.tuning.detect
    alarms = stuck_check.judge(DETECTOR.config, memory, check, 0.0, enough)
    assert [(alarm.kind, alarm.target, alarm.number) for alarm in alarms] == [("pump_stuck_on", pump + 1, 7)] * is_stuck
    assert (pump not in memory.stuck_checks) is is_stuck


@pytest.mark.parametrize(("growing", "is_stuck"), [(-30.0, True), (0.0, True), (15.0, False)])
def test_a_gain_that_goes_on_changing_must_be_less_likely_than_a_stuck_pump(growing: float, is_stuck: bool) -> None:
    """A pump that faded by 2 % a second while its voltage rose gave a constant flow, and tripped as stuck."""
    memory = a_memory()
    check = a_stuck_check(memory, 0)
    check.growing_evidence = growing
    memory.entry[VOLTAGE] = 1.2 * check.voltage_V
    enough = 1.01 * DETECTOR.config.tuning.detect
    assert bool(stuck_check.judge(DETECTOR.config, memory, check, 0.0, enough)) is is_stuck


@pytest.mark.parametrize(("number", "ended"), [(None, []), (8, [8])])
def test_an_alarm_that_is_open_when_a_pump_is_found_stuck_ends_without_a_name(
    number: int | None, ended: list[int]
) -> None:
    """Its flow that did not follow was the lag of the same pump as well, in 12 of 29 runs."""
    memory = a_memory()
    check = a_stuck_check(memory, 0)
    memory.suspicion = Suspicion(number=number, detected_s=memory.t_s)
    memory.replays.dropped[:] = 1
    memory.entry[VOLTAGE] = 1.2 * check.voltage_V
    stuck, *others = stuck_check.judge(DETECTOR.config, memory, check, 0.0, 1.01 * DETECTOR.config.tuning.detect)
    assert stuck.kind == "pump_stuck_on"
    assert not memory.suspicion
    assert [alarm.number for alarm in others if alarm.is_recovery] == ended
    assert [alarm.candidates for alarm in others] == [("pump_stuck_on 1",)] * len(ended)


def test_nothing_else_is_found_beside_a_stuck_pump() -> None:
    """The run trips, and the filter believes that the flow follows the voltage."""
    memory = a_memory()
    memory.declared[0] = Declared("pump_stuck_on", 2.0, 1.0, 7, 20.0, 21.0)
    reading = Measurement((6.2, 6.4, 0.8, 0.7), (True,) * 4, 0.0, 5, (0.0,) * 4, (0.0,) * 4)
    for number in range(300, 330):
        memory, diagnosis = DETECTOR.step(memory, number * PERIOD_S, reading, NO_ESTIMATE, (0.0, 3.0))
        assert diagnosis.new_alarms == ()
    assert memory.max_ratio > DETECTOR.config.tuning.detect
    assert not memory.is_wide
    del memory.declared[0]
    memory, _ = DETECTOR.step(memory, 330 * PERIOD_S, reading, NO_ESTIMATE, (0.0, 3.0))
    assert memory.suspicion is not None or memory.is_wide


def test_a_slow_pump_is_judged_when_its_voltage_has_been_elsewhere_for_two_lags() -> None:
    memory = a_memory()
    lag_s = 1.5
    memory.x[LAG] = lag_s / DETECTOR.config.model.lag_s[0]
    memory.declared[0] = Declared("pump_effectiveness", -0.4, 1.0, 7, 20.0, 21.0)
    stuck_check.begin(DETECTOR.config, memory, 0, 7, 20.0, 19.5)
    check, begun_s, told_at_s = memory.stuck_checks[0], memory.t_s, []
    for at_s, elsewhere in ((0.5, True), (1.5, False), (2.0, True), (4.9, True), (5.1, True)):
        memory.t_s = begun_s + at_s
        memory.x[LAG] = 9.0  # a flow that does not follow makes the lag longer; that does not count
        memory.entry[VOLTAGE] = (1.2 if elsewhere else 1.0) * check.voltage_V
        if stuck_check.judge(DETECTOR.config, memory, check, 0.0, DETECTOR.config.tuning.detect):
            told_at_s.append(at_s)
            break
    assert told_at_s == [5.1]


@pytest.mark.parametrize(("lag_s", "patience_s"), [(0.2, 0.0), (0.99, 0.0), (1.01, 2.02)])
def test_a_fast_pump_is_judged_at_once(lag_s: float, patience_s: float) -> None:
    memory = a_memory()
    memory.x[LAG + 1] = lag_s / DETECTOR.config.model.lag_s[1]
    stuck_check.begin(DETECTOR.config, memory, 1, 7, 20.0, 19.5)
    assert memory.stuck_checks[1].patience_s == pytest.approx(patience_s)
