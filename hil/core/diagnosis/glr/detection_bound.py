"""The detection bound: how soon a fault could be found by any detector.

A detector that knows the fault's kind, size and onset, and only tests whether it is present, gathers the Kullback-
Leibler distance s' J(t) s / 2 of the innovations with and without the fault; J is the energy of the jump's signature,
as in the bank. With no more than one false alarm in a day of steps it has to wait until that reaches ln(steps a day).
It is computed reading by reading, so that it is not rounded to control periods.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import log

import numpy as np

from hil.core.diagnosis.glr import kernels
from hil.core.diagnosis.glr.filter import VOLTAGE
from hil.core.diagnosis.glr.hypotheses import JUMPS, PUMPS
from hil.core.diagnosis.glr.memory import DetectorConfig, Memory
from hil.core.diagnosis.glr.model import GAIN, LEAK, LEVEL, PUMP, Array
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Measurement, Pair, Quad

DAY_S = 86_400.0
LEARNING_S = 150.0
MAX_S = 60.0
ALL = (True, True, True, True)


def jumps_of_fault(kind: str, target: int, value: float | None, model: TankModel) -> Mapping[int, float]:
    """Sizes by place in JUMPS of a fault as a scenario has it; none when it is no jump of one state."""
    if kind == "pump_dead":
        kind, value = "pump_effectiveness", 0.0
    if value is None:
        return {}
    for j, jump in enumerate(JUMPS):
        if jump.target == target and kind in (jump.rises, jump.falls):
            if kind == "pump_effectiveness":
                return {j: value - 1.0}
            if kind == "valve_split":
                return {j: value / model.valve_split[target - 1] - 1.0}
            if kind == "outlet_block":
                return {j: -value}
            if kind in ("leak", "sensor_bias", "sensor_drift"):
                return {j: value}
    return {}


def detection_bound_s(
    model: TankModel,
    lag_s: float,
    noise_V: float,
    jumps: Mapping[int, float],
    operating_V: Pair,
    period_s: float,
    reading_s: float,
) -> float | None:
    """Seconds from the onset to ln(steps of period_s a day) nats, pumps held at operating_V; None if over a minute.

    jumps : sizes by place in JUMPS, one jump or the two pumps'. reading_s : between readings of noise_V each. The
    filter has run for some minutes before.
    """
    if not jumps or (len(jumps) > 1 and set(jumps) != set(PUMPS)):
        return None
    config = DetectorConfig.of(model, lag_s, noise_V, Tuning())
    k, levels = model.level_gain_V_cm, equilibrium(model, operating_V)
    h1, h2, h3, h4 = levels
    m = Memory.begin(config, 0.0, Measurement((k * h1, k * h2, k * h3, k * h4), ALL, 0.0, 1), (0.0, 0.0))
    entry = np.array([*operating_V, *(k * h for h in levels), *(noise_V**2,) * 4, reading_s, 1.0, 0.0, 0.0])
    for _ in range(round(LEARNING_S / reading_s)):
        _quiet_step(config, m, entry, levels)
    m.restart_bank()
    slot = int((m.bank.onset >= 0).argmax())
    wanted = log(DAY_S / period_s)
    for number in range(1, round(MAX_S / reading_s) + 1):
        _quiet_step(config, m, entry, levels)
        b = m.bank
        kernels.advance_bank(config.model.level_gain_V_cm, entry, m.result, b)
        gathered = 0.5 * sum(size * size * float(b.energy[j, slot]) for j, size in jumps.items())
        if len(jumps) > 1:
            gathered += jumps[PUMPS[0]] * jumps[PUMPS[1]] * float(b.cross[slot])
        if gathered >= wanted:
            return reading_s * number
    return None


def _quiet_step(config: DetectorConfig, m: Memory, entry: Array, level_cm: Quad) -> None:
    """One step of the filter on readings that are just what it expects: only its covariance moves."""
    m.x[LEVEL : LEVEL + 4] = level_cm
    m.x[PUMP : PUMP + 2] = entry[VOLTAGE : VOLTAGE + 2]
    m.x[GAIN:LEAK] = 1.0
    kernels.filter_step(config.model, m.x, m.P, entry, m.result)
