"""The detection bound: how soon, at the least, half of all runs can have an alarm, whatever the detector.

The detector is taken to know the fault's kind, size and onset; it does not know the rig's parameters, its levels and
its lags, which are learned from the readings as far as the readings allow. All that is random is the readings' noise.
The readings' log-likelihood ratio, with the fault against without, is then normal, with mean -D without and D with
the fault and variance 2 D: D = s' J s / 2, where J is the energy of the jump's signature, as in the bank. A detector
that raises a false alarm at a share p of all steps has raised one within the n steps since the onset with a probability
of n p at the most. By the lemma of Neyman and Pearson (1933) it has then found the fault with a probability of

    Q(z - sqrt(2 D)) at the most,   Q(z) = n p,   Q(z) = probability that a standard normal number exceeds z

and that reaches one half where sqrt(2 D) = z. It is computed reading by reading, so that it is not rounded to control
periods. Derivation and a check by simulation: `docs/explanation/diagnosis.md`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, sqrt
from statistics import NormalDist

import numpy as np

from hil.core.diagnosis.glr import kernels
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import ENTRY, PERIOD, READING, VARIANCE, VOLTAGE, WEIGHT
from hil.core.diagnosis.glr.hypotheses import JUMPS, PUMPS
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import BIAS, LEVEL, MOVING, Array, N
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Measurement, Pair, Quad

DAY_S = 86_400.0
"""One false alarm in this time."""

MAX_S = 60.0
STEP_TOLERANCE = 1e-9
ALL = (True, True, True, True)

Held = Sequence[tuple[float, Pair]]
"""Pump voltages before the fault: how long, s, and what, V, one after the other."""


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
    lag_s: float | Pair,
    noise_V: float | Quad,
    jumps: Mapping[int, float],
    held: Held,
    period_s: float,
    reading_s: float,
) -> float | None:
    """Seconds from the onset to the bound, for detectors that decide every period_s; None if over a minute.

    jumps : sizes by place in JUMPS, one jump or the two pumps'. held : the pump voltages from the start of the run, in
    the equilibrium of the first of them with pumps at rest, to the onset; the last ones stay. reading_s : between
    readings of noise_V each. lag_s, noise_V : one, or each pump's and sensor's.
    """
    if not jumps or (len(jumps) > 1 and set(jumps) != set(PUMPS)):
        return None
    config, m = learned(model, lag_s, noise_V, held, period_s, reading_s)
    entry = entry_of(held[-1][1], [noise**2 for noise in config.noise_V], reading_s)
    m.restart_bank()
    slot = int((m.bank.onset >= 0).argmax())
    for number in range(1, round(MAX_S / reading_s) + 1):
        expected_step(config, m, entry)
        b = m.bank
        kernels.advance_bank(config.model.level_gain_V_cm, entry, m.result, b)
        distance = 0.5 * sum(size * size * float(b.energy[j, slot]) for j, size in jumps.items())
        if len(jumps) > 1:
            distance += jumps[PUMPS[0]] * jumps[PUMPS[1]] * float(b.cross[slot])
        if sqrt(2.0 * max(distance, 0.0)) >= wanted_stds(number * reading_s, period_s):
            return reading_s * number
    return None


def wanted_stds(since_s: float, period_s: float) -> float:
    """The z of the false alarms that are allowed in the steps of this time, see above."""
    steps = max(ceil(since_s / period_s - STEP_TOLERANCE), 1)
    return NormalDist().inv_cdf(1.0 - steps * period_s / DAY_S)


def learned(
    model: TankModel, lag_s: float | Pair, noise_V: float | Quad, held: Held, period_s: float, reading_s: float
) -> tuple[DetectorConfig, Memory]:
    """The filter after these voltages: what can be known at the onset.

    Levels do not wander and parameters stay as they are: this filter has no margin for what the model does not say.
    """
    lags_s = lag_s if isinstance(lag_s, tuple) else (lag_s, lag_s)
    noises_V = noise_V if isinstance(noise_V, tuple) else (noise_V, noise_V, noise_V, noise_V)
    config = DetectorConfig.of(model, lags_s, noises_V, Tuning())
    config.model.walk[:] = 0.0
    k = model.level_gain_V_cm
    h1, h2, h3, h4 = equilibrium(model, held[0][1])
    m = Memory.begin(config, 0.0, Measurement((k * h1, k * h2, k * h3, k * h4), ALL, 0.0, 1), (0.0, 0.0))
    for time_s, voltage_V in held:
        entry = entry_of(voltage_V, [noise**2 * reading_s / period_s for noise in noises_V], period_s)
        for _ in range(round(time_s / period_s)):
            expected_step(config, m, entry)
    return config, m


def entry_of(voltage_V: Pair, variance_V2: float | Sequence[float], step_s: float) -> Array:
    """An entry of the history with readings at the end of the step, of this variance, one or (4,); see `filter`."""
    entry = np.zeros(ENTRY)
    entry[VOLTAGE : VOLTAGE + 2] = voltage_V
    entry[VARIANCE : VARIANCE + 4] = variance_V2
    entry[PERIOD], entry[WEIGHT] = step_s, 1.0
    return entry


def expected_step(config: DetectorConfig, m: Memory, entry: Array) -> None:
    """One step of the filter on readings that are just what it expects."""
    expected = m.x.copy()
    kernels.predict(
        config.model, expected, np.zeros(2), entry[VOLTAGE : VOLTAGE + 2], entry[PERIOD], np.empty((MOVING, N))
    )
    gain = config.model.level_gain_V_cm
    entry[READING : READING + 4] = gain * expected[LEVEL : LEVEL + 4] + expected[BIAS : BIAS + 4]
    kernels.filter_step(config.model, m.x, m.P, entry, m.result)
