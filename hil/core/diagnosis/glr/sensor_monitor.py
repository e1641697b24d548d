"""Sensors that fail the tests of single readings: they are no longer used, until they agree with the filter again."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite, nan, sqrt
from typing import NamedTuple

from hil.core.diagnosis.glr import rollback
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, READING, VARIANCE
from hil.core.diagnosis.glr.hypotheses import JUMPS
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Declared, Lost
from hil.core.diagnosis.glr.model import BIAS, DRIFT
from hil.core.diagnosis.glr.refilter import RING
from hil.core.diagnosis.glr.sensor_statistics import OPEN_RUN
from hil.core.types import Alarm, Measurement

AGREES_STDS = 4.0
"""A lost sensor agrees with the filter when its reading is within so many standard deviations."""


def examine(config: DetectorConfig, m: Memory, measurement: Measurement) -> list[Alarm]:
    """Test every sensor in use; the alarms."""
    alarms = []
    m.is_doubtful = False
    for i in range(4):
        if m.usable[i]:
            if i not in m.noisy and m.sensors[i].is_unremarkable(measurement, i):
                continue
            kind, run = _fault(config, m, measurement, i)
            if kind:
                alarms += _lose(config, m, i, kind, 1 + run // max(measurement.readings, 1))
            else:
                alarms += _noise(config, m, measurement, i)
                is_wet = measurement.level_V[i] > config.empty_V[i]
                m.is_doubtful |= is_wet and m.sensors[i].may_be_stuck(measurement, i)
    return alarms


def readmit(config: DetectorConfig, m: Memory, measurement: Measurement) -> list[Alarm]:
    """Use a lost sensor again that has agreed with the filter for long enough; the alarms that report it."""
    alarms = []
    gain = config.model.level_gain_V_cm
    for i in list(m.lost):
        expected_V = gain * float(m.x[i])
        std_V = sqrt(max(gain * gain * m.P[i, i], 0.0) + m.entry[VARIANCE + i])
        is_valid = measurement.valid[i] and measurement.readings > 0 and not m.sensors[i].is_stuck(measurement, i)
        agrees = is_valid and abs(measurement.level_V[i] - expected_V) < AGREES_STDS * std_V
        m.agrees[i] = m.agrees[i] + 1 if agrees and not m.sensors[i].is_noisy() else 0
        if m.agrees[i] * m.entry[PERIOD] >= config.tuning.readmit_s:
            lost = m.lost.pop(i)
            m.usable[i] = True
            m.restart_bank()
            alarms.append(_alarm_now(m, lost.kind, i + 1, nan, lost.number, is_recovery=True))
    return alarms


def _fault(config: DetectorConfig, m: Memory, measurement: Measurement, i: int) -> tuple[str, int]:
    """What is wrong with sensor i, and for how many readings it has been."""
    sensor = m.sensors[i]
    if measurement.invalid_run[i] >= OPEN_RUN:
        return "sensor_open", measurement.invalid_run[i]
    is_wet = measurement.level_V[i] > config.empty_V[i]
    if measurement.readings > 0 and is_wet and sensor.is_stuck(measurement, i):
        return "sensor_stuck", measurement.repeats[i] + 1
    if sensor.is_garbage():
        return "sensor_garbage", sensor.noisy_periods * measurement.readings
    return "", 0


def _noise(config: DetectorConfig, m: Memory, measurement: Measurement, i: int) -> list[Alarm]:
    """Keep using a noisy sensor, with its larger variance; withdraw faults declared from its first noisy readings."""
    sensor = m.sensors[i]
    if i in m.noisy and sensor.is_calm():
        number = m.noisy.pop(i)
        sensor.end_noise()
        return [_alarm_now(m, "sensor_noise", i + 1, 0.0, number, is_recovery=True)]
    if i in m.noisy or not sensor.is_noisy():
        return []
    back = sensor.noisy_periods + 1
    sensor.accept_noise()
    size_V = sqrt(max(sensor.variance_V2 - sensor.healthy_V2, 0.0))
    if _is_recent(m, back):
        variance_V2 = m.scale[i] * (sensor.variance_V2 / measurement.readings + config.floor_V2[i])
        _, amended, alarms = _amend(config, m, i, back, float(variance_V2))
    else:
        amended, alarms = _new_alarm(m), []
    m.noisy[i] = amended.number
    alarm = _alarm_now(m, "sensor_noise", i + 1, size_V, amended.number)
    return [*alarms, replace(alarm, detected_s=amended.detected_s)]


def _lose(config: DetectorConfig, m: Memory, i: int, kind: str, back: int) -> list[Alarm]:
    """Stop using sensor i, and filter the last `back` steps again without its readings."""
    m.usable[i] = False
    m.agrees[i] = 0
    size = float(m.history.entries[(m.now - 1) % RING][READING + i])
    start, amended, alarms = _amend(config, m, i, back, None)
    m.forget(BIAS + i)
    m.forget(DRIFT + i)
    m.lost[i] = Lost(kind=kind, number=amended.number, since_s=m.t_s)
    alarm = Alarm(
        detected_s=amended.detected_s,
        kind=kind,
        target=i + 1,
        size=size if isfinite(size) else nan,
        onset_s=m.time_of(start),
        isolated_s=m.t_s,
        candidates=(f"{kind} {i + 1}",),
        number=amended.number,
    )
    return [*alarms, alarm]


class Amended(NamedTuple):
    """Number and time of the alarm that a sensor's alarm continues."""

    number: int
    detected_s: float


def _new_alarm(m: Memory) -> Amended:
    m.alarms += 1
    return Amended(number=m.alarms, detected_s=m.t_s)


def _is_recent(m: Memory, back: int) -> bool:
    """Whether anything was suspected or declared in the last `back` steps."""
    since = max(m.now - back, 0)
    is_suspected = m.suspicion is not None and m.suspicion.detected_s >= m.time_of(since)
    return is_suspected or (m.checkpoint is not None and m.checkpoint.onset >= since - rollback.SAME_STEPS)


def _amend(
    config: DetectorConfig, m: Memory, i: int, back: int, variance_V2: float | None
) -> tuple[int, Amended, list[Alarm]]:
    """Filter the last `back` steps again, with the right variance of sensor i's readings.

    A fault that was suspected or declared in that time may be caused by the sensor: it is withdrawn, and found again if
    it is real. The sensor's alarm takes over its number. Returns the first of these steps, that number and time, and
    the alarms that withdraw faults.
    """
    start, withdrawn = rollback.go_back(m, m.now - back)
    rollback.set_reading_variance(m, start, i, variance_V2)
    rollback.refilter(config, m, start, m.now - 1)
    suspicion, m.suspicion = m.suspicion, None
    m.max_ratio = 0.0
    if withdrawn:
        (_, first), *others = withdrawn
        return (
            start,
            Amended(number=first.number, detected_s=first.detected_s),
            [_withdrawal(m, j, fault) for j, fault in others],
        )
    if suspicion is not None and suspicion.number is not None:
        return start, Amended(number=suspicion.number, detected_s=suspicion.detected_s), []
    return start, _new_alarm(m), []


def _withdrawal(m: Memory, j: int, fault: Declared) -> Alarm:
    """The alarm that withdraws a fault."""
    return _alarm_now(m, fault.kind, JUMPS[j].target, nan, fault.number, is_recovery=True)


def _alarm_now(m: Memory, kind: str, target: int, size: float, number: int, *, is_recovery: bool = False) -> Alarm:
    """An alarm whose times are all those of this step."""
    return Alarm(
        detected_s=m.t_s,
        kind=kind,
        target=target,
        size=size,
        onset_s=m.t_s,
        isolated_s=m.t_s,
        candidates=(f"{kind} {target}",),
        number=number,
        is_recovery=is_recovery,
    )
