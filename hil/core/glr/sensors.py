"""Sensors that tests of single readings condemn, and their way back."""

from __future__ import annotations

from math import isfinite, nan, sqrt

from hil.core.glr import bank, process
from hil.core.glr.channels import OPEN_RUN
from hil.core.glr.hypotheses import JUMPS
from hil.core.glr.memory import Declared, Lost, Memory, Setup
from hil.core.glr.process import BIAS, DRIFT
from hil.core.glr.replay import RING
from hil.core.types import Alarm, Measurement

SAME_STEPS = 5
"""A fault that is said to have begun so few steps before its sensor failed, or later, may be the sensor's doing."""

AGREES_STDS = 4.0
"""A lost sensor agrees with the filter when its reading is within so many standard deviations."""


def examine(setup: Setup, m: Memory, measurement: Measurement) -> list[Alarm]:
    """Test every sensor in use; the alarms."""
    alarms = []
    m.is_doubtful = False
    for i in range(4):
        if m.usable[i]:
            kind, run = _fault(setup, m, measurement, i)
            if kind:
                alarms += _lose(setup, m, i, kind, 1 + run // max(measurement.readings, 1))
            else:
                alarms += _noise(m, i)
                is_wet = measurement.level_V[i] > setup.empty_V
                m.is_doubtful |= is_wet and m.channels[i].may_be_stuck(measurement, i)
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
            kind, number, _ = m.lost.pop(i)
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


def _lose(setup: Setup, m: Memory, i: int, kind: str, back: int) -> list[Alarm]:
    """Go on without sensor i, and without what it said in the last `back` steps.

    A fault that was declared in that time may be the sensor's doing: it is taken back, and found again if it is real.
    The sensor's alarm goes on under its number.
    """
    start, withdrawn = _go_back(m, m.now - back)
    m.usable[i] = False
    m.agrees[i] = 0
    m.forget(BIAS + i)
    m.forget(DRIFT + i)
    size = float(m.history.entries[(m.now - 1) % RING][2 + i])
    _relive(setup, m, start, i)
    suspicion, m.suspicion = m.suspicion, None
    m.statistic = 0.0
    alarms = []
    if withdrawn:
        (_, first), *others = withdrawn
        number, detected_s = first.number, first.detected_s
        alarms = [_over(m, j, fault) for j, fault in others]
    elif suspicion is not None and suspicion.number is not None:
        number, detected_s = suspicion.number, suspicion.detected_s
    else:
        m.alarms += 1
        number, detected_s = m.alarms, m.t_s
    m.lost[i] = Lost(kind, number, m.t_s)
    name = f"{kind} {i + 1}"
    size = size if isfinite(size) else nan
    return [*alarms, Alarm(detected_s, kind, i + 1, size, nan, m.time_of(start), m.t_s, (name,), number)]


def _go_back(m: Memory, step: int) -> tuple[int, list[tuple[int, Declared]]]:
    """Put the filter to where it was at a step or before; where that is, and what is no longer declared, by place."""
    b, checkpoint = m.bank, m.checkpoint
    known = [s for s in range(bank.SLOTS) if b.onset[s] >= 0]
    old_enough = [s for s in known if b.onset[s] <= step]
    if not old_enough and checkpoint is not None and checkpoint.onset >= step - SAME_STEPS:
        m.x[:], m.P[:] = checkpoint.x, checkpoint.P
        withdrawn = [(j, fault) for j, fault in m.declared.items() if j not in checkpoint.declared]
        m.declared, m.checkpoint, m.probation = dict(checkpoint.declared), None, None
        return checkpoint.step, withdrawn
    slot = max(old_enough, key=lambda s: int(b.onset[s])) if old_enough else min(known, key=lambda s: int(b.onset[s]))
    m.x[:], m.P[:] = m.history.x[slot], m.history.P[slot]
    return int(b.onset[slot]), []


def _relive(setup: Setup, m: Memory, start: int, i: int) -> None:
    """Filter and bank once more, from a step on to the last one, without sensor i."""
    b = m.bank
    m.restart_bank(start)
    for step in range(start + 1, m.now + 1):
        entry = m.history.entries[step % RING]
        entry[2 + i] = nan
        if step < m.now:
            m.history.none[step % RING] = process.step(
                setup.c, setup.walk, m.x, m.P, entry, m.A, m.K, m.white, m.innovation
            )
            bank.advance(setup.c[13], entry, m.A, m.K, m.white, m.innovation, b.effect, b.energy, b.match, b.cross)
            m.open_slot(step)


def _over(m: Memory, j: int, fault: Declared) -> Alarm:
    """The alarm that takes a fault back."""
    target = JUMPS[j].target
    name = f"{fault.kind} {target}"
    return Alarm(m.t_s, fault.kind, target, nan, nan, m.t_s, m.t_s, (name,), fault.number, is_recovery=True)
