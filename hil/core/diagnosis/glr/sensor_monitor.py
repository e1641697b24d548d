"""Sensors that tests of single readings condemn, and their way back."""

from __future__ import annotations

from math import isfinite, nan, sqrt
from typing import NamedTuple

from hil.core.diagnosis.glr import rollback
from hil.core.diagnosis.glr.filter import PERIOD, READING, VARIANCE
from hil.core.diagnosis.glr.hypotheses import JUMPS
from hil.core.diagnosis.glr.memory import Declared, DetectorConfig, Lost, Memory
from hil.core.diagnosis.glr.model import BIAS, DRIFT
from hil.core.diagnosis.glr.replay import RING
from hil.core.diagnosis.glr.sensor_statistics import NOISY_PERIODS, OPEN_RUN
from hil.core.types import Alarm, Measurement

AGREES_STDS = 4.0
"""A lost sensor agrees with the filter when its reading is within so many standard deviations."""


def examine(config: DetectorConfig, m: Memory, measurement: Measurement) -> list[Alarm]:
    """Test every sensor in use; the alarms."""
    alarms = []
    m.is_doubtful = False
    for i in range(4):
        if m.usable[i]:
            kind, run = _fault(config, m, measurement, i)
            if kind:
                alarms += _lose(config, m, i, kind, 1 + run // max(measurement.readings, 1))
            else:
                alarms += _noise(config, m, measurement, i)
                is_wet = measurement.level_V[i] > config.empty_V
                m.is_doubtful |= is_wet and m.sensors[i].may_be_stuck(measurement, i)
    return alarms


def readmit(config: DetectorConfig, m: Memory, measurement: Measurement) -> list[Alarm]:
    """Trust a lost sensor again that has agreed with the filter for long enough; the alarms that say so."""
    alarms = []
    gain = config.model.level_gain_V_cm
    for i in list(m.lost):
        expected_V = gain * float(m.x[i])
        std_V = sqrt(max(gain * gain * m.P[i, i], 0.0) + m.entry[VARIANCE + i])
        is_sound = measurement.valid[i] and measurement.readings > 0 and not m.sensors[i].is_stuck(measurement, i)
        agrees = is_sound and abs(measurement.level_V[i] - expected_V) < AGREES_STDS * std_V
        m.agrees[i] = m.agrees[i] + 1 if agrees and not m.sensors[i].is_noisy() else 0
        if m.agrees[i] * m.entry[PERIOD] >= config.tuning.readmit_s:
            kind, number, _ = m.lost.pop(i)
            m.usable[i] = True
            m.restart_bank()
            alarms.append(Alarm(m.t_s, kind, i + 1, nan, nan, m.t_s, m.t_s, (f"{kind} {i + 1}",), number, True))
    return alarms


def _fault(config: DetectorConfig, m: Memory, measurement: Measurement, i: int) -> tuple[str, int]:
    """What is wrong with sensor i, and for how many readings it has been."""
    channel = m.sensors[i]
    if measurement.invalid_run[i] >= OPEN_RUN:
        return "sensor_open", measurement.invalid_run[i]
    is_wet = measurement.level_V[i] > config.empty_V
    if measurement.readings > 0 and is_wet and channel.is_stuck(measurement, i):
        return "sensor_stuck", measurement.repeats[i] + 1
    if channel.is_garbage():
        return "sensor_garbage", channel.noisy_periods * measurement.readings
    return "", 0


def _noise(config: DetectorConfig, m: Memory, measurement: Measurement, i: int) -> list[Alarm]:
    """A noisy sensor is still used, for what it is worth; what its first noisy readings led to is taken back."""
    channel = m.sensors[i]
    name = f"sensor_noise {i + 1}"
    if i in m.noisy and channel.is_calm():
        number = m.noisy.pop(i)
        channel.forgive()
        return [Alarm(m.t_s, "sensor_noise", i + 1, 0.0, nan, m.t_s, m.t_s, (name,), number, True)]
    if i in m.noisy or not channel.is_noisy():
        return []
    channel.accept_noise()
    size_V = sqrt(max(channel.variance_V2 - channel.sound_V2, 0.0))
    back = NOISY_PERIODS + 1
    if _is_recent(m, back):
        variance_V2 = m.scale[i] * (channel.variance_V2 / measurement.readings + config.tuning.reading_floor_V**2)
        _, amended, alarms = _amend(config, m, i, back, float(variance_V2))
    else:
        amended, alarms = _news(m), []
    m.noisy[i] = amended.number
    alarm = Alarm(amended.detected_s, "sensor_noise", i + 1, size_V, nan, m.t_s, m.t_s, (name,), amended.number)
    return [*alarms, alarm]


def _lose(config: DetectorConfig, m: Memory, i: int, kind: str, back: int) -> list[Alarm]:
    """Go on without sensor i, and without what it said in the last `back` steps."""
    m.usable[i] = False
    m.agrees[i] = 0
    size = float(m.history.entries[(m.now - 1) % RING][READING + i])
    start, amended, alarms = _amend(config, m, i, back, None)
    m.forget(BIAS + i)
    m.forget(DRIFT + i)
    m.lost[i] = Lost(kind, amended.number, m.t_s)
    name = f"{kind} {i + 1}"
    size = size if isfinite(size) else nan
    onset_s = m.time_of(start)
    return [*alarms, Alarm(amended.detected_s, kind, i + 1, size, nan, onset_s, m.t_s, (name,), amended.number)]


class Amended(NamedTuple):
    """Number and time of the alarm that a sensor's goes on under."""

    number: int
    detected_s: float


def _news(m: Memory) -> Amended:
    m.alarms += 1
    return Amended(m.alarms, m.t_s)


def _is_recent(m: Memory, back: int) -> bool:
    """Whether anything was suspected or declared in the last `back` steps."""
    since = max(m.now - back, 0)
    is_suspected = m.suspicion is not None and m.suspicion.detected_s >= m.time_of(since)
    return is_suspected or (m.checkpoint is not None and m.checkpoint.onset >= since - rollback.SAME_STEPS)


def _amend(
    config: DetectorConfig, m: Memory, i: int, back: int, variance_V2: float | None
) -> tuple[int, Amended, list[Alarm]]:
    """Go back by some steps and live through them again, with the readings of sensor i for what they were worth.

    A fault that was suspected or declared in that time may be the sensor's doing: it is taken back, and found again if
    it is real. The sensor's alarm goes on under its number. Returns the step gone back to, that, and what is over.
    """
    start, withdrawn = rollback.go_back(m, m.now - back)
    rollback.revalue(m, start, i, variance_V2)
    rollback.relive(config, m, start, m.now - 1)
    suspicion, m.suspicion = m.suspicion, None
    m.max_ratio = 0.0
    if withdrawn:
        (_, first), *others = withdrawn
        return start, Amended(first.number, first.detected_s), [_over(m, j, fault) for j, fault in others]
    if suspicion is not None and suspicion.number is not None:
        return start, Amended(suspicion.number, suspicion.detected_s), []
    return start, _news(m), []


def _over(m: Memory, j: int, fault: Declared) -> Alarm:
    """The alarm that takes a fault back."""
    target = JUMPS[j].target
    name = f"{fault.kind} {target}"
    return Alarm(m.t_s, fault.kind, target, nan, nan, m.t_s, m.t_s, (name,), fault.number, is_recovery=True)
