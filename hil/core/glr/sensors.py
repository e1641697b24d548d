"""Sensors that tests of single readings condemn, and their way back."""

from __future__ import annotations

from math import isfinite, nan, sqrt

from hil.core.glr import bank, process
from hil.core.glr.channels import OPEN_RUN
from hil.core.glr.memory import Memory, Setup
from hil.core.glr.process import BIAS, DRIFT
from hil.core.glr.replay import RING
from hil.core.types import Alarm, Measurement

AGREES_STDS = 4.0
"""A lost sensor agrees with the filter when its reading is within so many standard deviations."""


def examine(setup: Setup, m: Memory, measurement: Measurement) -> list[Alarm]:
    """Test every sensor in use; the alarms."""
    alarms = []
    for i in range(4):
        if m.usable[i]:
            kind, run = _fault(setup, m, measurement, i)
            if kind:
                alarms.append(_lose(setup, m, i, kind, 1 + run // max(measurement.readings, 1)))
            else:
                alarms += _noise(m, i)
    return alarms


def readmit(setup: Setup, m: Memory, measurement: Measurement) -> list[Alarm]:
    """Trust a lost sensor again that has agreed with the filter for long enough; the alarms that say so."""
    alarms = []
    gain = float(setup.c[13])
    for i in list(m.lost):
        expected_V = gain * float(m.x[i])
        std_V = sqrt(max(gain * gain * m.P[i, i], 0.0) + m.entry[6 + i])
        is_sound = measurement.valid[i] and measurement.readings > 0 and not m.channels[i].is_stuck(measurement, i)
        agrees = is_sound and abs(measurement.level_V[i] - expected_V) < AGREES_STDS * std_V
        m.agrees[i] = m.agrees[i] + 1 if agrees and not m.channels[i].is_noisy() else 0
        if m.agrees[i] * m.entry[10] >= setup.tuning.readmit_s:
            kind, number = m.lost.pop(i)
            m.usable[i] = True
            m.restart_bank()
            alarms.append(Alarm(m.t_s, kind, i + 1, nan, nan, m.t_s, m.t_s, (f"{kind} {i + 1}",), number, True))
    return alarms


def _fault(setup: Setup, m: Memory, measurement: Measurement, i: int) -> tuple[str, int]:
    """What is wrong with sensor i, and for how many readings it has been."""
    channel = m.channels[i]
    if measurement.invalid_run[i] >= OPEN_RUN:
        return "sensor_open", measurement.invalid_run[i]
    is_wet = measurement.level_V[i] > setup.empty_V
    if measurement.readings > 0 and is_wet and channel.is_stuck(measurement, i):
        return "sensor_stuck", measurement.repeats[i] + 1
    if channel.is_garbage():
        return "sensor_garbage", channel.noisy_periods * measurement.readings
    return "", 0


def _noise(m: Memory, i: int) -> list[Alarm]:
    """A noisy sensor is still used, for what it is worth."""
    channel = m.channels[i]
    if i not in m.noisy and channel.is_noisy():
        m.alarms += 1
        m.noisy[i] = m.alarms
        channel.accept_noise()
    elif i in m.noisy and channel.is_calm():
        number = m.noisy.pop(i)
        channel.forgive()
        name = f"sensor_noise {i + 1}"
        return [Alarm(m.t_s, "sensor_noise", i + 1, 0.0, nan, m.t_s, m.t_s, (name,), number, True)]
    else:
        return []
    size_V = sqrt(max(channel.variance_V2 - channel.sound_V2, 0.0))
    name = f"sensor_noise {i + 1}"
    return [Alarm(m.t_s, "sensor_noise", i + 1, size_V, nan, m.t_s, m.t_s, (name,), m.noisy[i])]


def _lose(setup: Setup, m: Memory, i: int, kind: str, back: int) -> Alarm:
    """Go on without sensor i, and without what it said in the last `back` steps."""
    b = m.bank
    known = [s for s in range(bank.SLOTS) if b.onset[s] >= 0]
    old_enough = [s for s in known if b.onset[s] < m.now - back]
    slot = max(old_enough, key=lambda s: int(b.onset[s])) if old_enough else min(known, key=lambda s: int(b.onset[s]))
    onset = int(b.onset[slot])
    m.usable[i] = False
    m.agrees[i] = 0
    m.x[:], m.P[:] = m.history.x[slot], m.history.P[slot]
    m.forget(BIAS + i)
    m.forget(DRIFT + i)
    for step in range(onset + 1, m.now + 1):
        entry = m.history.entries[step % RING]
        entry[2 + i] = nan
        if step < m.now:
            m.history.none[step % RING] = process.step(
                setup.c, setup.walk, m.x, m.P, entry, m.A, m.K, m.white, m.innovation
            )
    suspicion, m.suspicion = m.suspicion, None
    number, detected_s = (suspicion.number, suspicion.detected_s) if suspicion else (None, m.t_s)
    if number is None:
        m.alarms += 1
        number = m.alarms
    m.lost[i] = (kind, number)
    m.bank.clear()
    m.statistic = 0.0
    onset_s = m.time_of(onset)
    size = float(m.history.entries[(m.now - 1) % RING][2 + i])
    return Alarm(
        detected_s, kind, i + 1, size if isfinite(size) else nan, nan, onset_s, m.t_s, (f"{kind} {i + 1}",), number
    )
