"""Drift review: whether the sensor drifted, or the level.

A sensor drift and a leak or blockage, most of all of the same tank, change the same reading in a similar way, and
differ only in what the level does afterwards. A drift that is declared wrongly is dangerous: the sensor that shows how
the tank fills is no longer used. So the filters of both hypotheses continue with its readings for some time, and the
verdict is reversed when the other hypothesis explains them better.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from hil.core.diagnosis.glr import declaration
from hil.core.diagnosis.glr.ambiguity import MEAN_S, MOVED_V
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, READING, VOLTAGE
from hil.core.diagnosis.glr.hypotheses import JUMPS, H, outlet_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Lost, Rival, Suspicion
from hil.core.diagnosis.glr.model import BIAS, DRIFT, LEVEL, OUTLET
from hil.core.types import Alarm, Measurement

PROVEN_STDS, MODEL_SHARE = 3.0, 0.1
"""The sensor certainly reads too high by its bias less so many standard deviations and this share of the level: the
level that a time constant tells is as good as the rig file's areas and pump gains."""


def rival_of(
    config: DetectorConfig, m: Memory, winner: int, order: list[int], suspicion: Suspicion, *, has_moved: bool
) -> Rival | None:
    """The leak or blockage that may be behind a drift that has just been declared; None when none is likely enough.

    That of the same tank if its replay goes on, however small it is so far; otherwise the likeliest. has_moved :
    whether the pumps moved before the declaration.
    """
    r, tuning = m.replays, config.tuning
    if winner >= H or JUMPS[winner].state < DRIFT:
        return None
    near = r.evidence >= r.evidence[winner] - tuning.drop_margin
    for number in (outlet_of(JUMPS[winner].target), *order):
        if number < H and OUTLET <= JUMPS[number].state < BIAS and near[number] and not r.dropped[number]:
            return Rival(
                number=number,
                suspicion=suspicion,
                sensor=JUMPS[winner].state - DRIFT,
                onset=int(r.onset[number]),
                before=r.before[number].copy(),
                x=r.x[number].copy(),
                P=r.P[number].copy(),
                own_x=r.x[winner].copy(),
                own_P=r.P[winner].copy(),
                lead=float(r.evidence[winner] - r.evidence[number]),
                until_s=m.t_s + tuning.rival_s,
                target=int(r.target[number]),
                mean_V=m.entry[VOLTAGE : VOLTAGE + 2].copy(),
                moved_lead=float(r.evidence[winner] - r.evidence[number]) if has_moved else 0.0,
            )
    return None


def step(config: DetectorConfig, m: Memory, measurement: Measurement) -> list[Alarm]:
    """One step of both filters; the alarm that reverses the verdict."""
    rival = m.rival
    if rival is None:
        return []
    lost = m.lost.get(rival.sensor)
    if lost is None or lost.kind != "sensor_drift" or m.suspicion is not None or m.t_s > rival.until_s:
        m.rival = None
        return []
    i = rival.sensor
    entry = m.entry.copy()
    is_usable = measurement.readings > 0 and measurement.valid[i] and measurement.level_V[i] > config.empty_V[i]
    if is_usable and not m.sensors[i].is_stuck(measurement, i):
        entry[READING + i] = measurement.level_V[i]
    gain = config.filter_beside(rival.own_x, rival.own_P, entry, m.growing)
    gain -= config.filter_beside(rival.x, rival.P, entry, rival.target)
    rival.lead += gain
    _prove(config, m, rival, lost, gain)
    if rival.lead > config.tuning.drop_margin:
        m.rival = None
    if rival.lead > -config.tuning.detect:
        return []
    return _reverse(config, m, rival)


def _prove(config: DetectorConfig, m: Memory, rival: Rival, lost: Lost, gain: float) -> None:
    """Note what the sensor certainly reads too high, once a movement of the pumps has spoken for the drift.

    gain : of the drift's lead at this step. What is gained while a pump is away from where it was counts; at rest a
    lead says little.
    """
    voltages = m.entry[VOLTAGE : VOLTAGE + 2]
    away_V = float(np.abs(voltages - rival.mean_V).max())
    rival.mean_V += min(float(m.entry[PERIOD]) / MEAN_S, 1.0) * (voltages - rival.mean_V)
    rival.moved_lead += gain if away_V > MOVED_V else 0.0
    if rival.number != outlet_of(rival.sensor + 1) or min(rival.lead, rival.moved_lead) < config.tuning.detect:
        return
    state = BIAS + rival.sensor
    in_doubt_V = PROVEN_STDS * sqrt(max(float(rival.own_P[state, state]), 0.0))
    in_doubt_V += MODEL_SHARE * config.model.level_gain_V_cm * max(float(rival.own_x[LEVEL + rival.sensor]), 0.0)
    proven_V = float(rival.own_x[state]) - in_doubt_V
    m.lost[rival.sensor] = lost._replace(proven_V=max(lost.proven_V, proven_V))


def _reverse(config: DetectorConfig, m: Memory, rival: Rival) -> list[Alarm]:
    """The rival's filter becomes the filter, and the sensor is used again; under the number of the drift's alarm."""
    m.rival = None
    del m.lost[rival.sensor]
    m.usable[rival.sensor] = True
    m.x[:], m.P[:], m.growing = rival.x, rival.P, rival.target
    alarm = declaration.declare(config, m, rival.number, rival.before, rival.onset, rival.suspicion)
    m.restart_bank()
    return [alarm]
