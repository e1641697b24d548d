"""A control law on tanks of its own, without bus, supervisor or diagnosis: to tune laws, and to test them in a moment.

The tanks are eq. (1) once more, written for this module, so that an error of the controller's model can't cancel here.
Pump lag and drawn parameters; readings every 20 ms with noise and 12 bit, of which a step gets the mean; commands
within range and rate; faults reported by a perfect diagnosis some time later.

    python -m tools.law_table       the table of docs/reference/laws.md
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from hil.core import estimator
from hil.core.control_law import Authority, ControlLaw, LawInputs
from hil.core.diagnosis.detector import FaultDetector
from hil.core.estimator import LevelFilter
from hil.core.following import Followed, follow
from hil.core.tanks import TankModel, equilibrium, holding_voltages
from hil.core.types import Alarm, Diagnosis, Measurement, Pair, Quad

Array = NDArray[np.float64]

PERIOD_S, READING_S, LAG_S = 0.1, 0.02, 0.2
NOISE_V, STEP_V = 0.005, 10.24 / 4096
MAX_V, RATE_V_S = 10.0, 20.0
REPORT_S = 0.5
"""How long the diagnosis takes to report a fault."""

Schedule = Sequence[tuple[float, Pair]]


@dataclass(frozen=True, slots=True)
class References:
    """References (2,) in V, each from its time on; a trial has no start phase."""

    schedule: Schedule
    start: None = None

    def at(self, t_s: float) -> Pair:
        """Those of a time; before the first, the first."""
        past = (value for at_s, value in reversed(self.schedule) if at_s <= t_s + 1e-6)
        return next(past, self.schedule[0][1])

    def rate(self, t_s: float) -> Pair:  # noqa: ARG002 - every change is a step
        """Rates in V/s."""
        return 0.0, 0.0


@dataclass(frozen=True, slots=True)
class Trial:
    """references, faults (effectiveness), manual (drives, from and until when): what happens; level_cm : at the start.

    noise_V : of a reading. report_s : age at which the diagnosis reports a fault. lag_s : of the pumps.
    """

    duration_s: float
    references: Schedule
    faults: Schedule = ((0.0, (1.0, 1.0)),)
    manual: tuple[float, float, Pair] | None = None
    level_cm: Quad | None = None
    given_V: Pair = (0.0, 0.0)
    noise_V: float = NOISE_V
    report_s: float = REPORT_S
    lag_s: float = LAG_S


@dataclass(frozen=True, eq=False)
class Course:
    """What happened: a row each step. t_s (n,), level_cm (n, 4), wanted_V, given_V, reference_V, target_V (n, 2)."""

    t_s: Array
    level_cm: Array
    wanted_V: Array
    given_V: Array
    reference_V: Array
    target_V: Array
    shown: tuple[dict[str, float], ...]
    alarms: tuple[Alarm, ...]
    level_gain_V_cm: float

    @property
    def outputs(self) -> Array:
        """(n, 2) true outputs, without noise."""
        return self.level_gain_V_cm * self.level_cm[:, :2]

    def iae(self, begin_s: float, end_s: float) -> Pair:
        """(2,) integral of |r - y| from begin to end."""
        inside = (self.t_s >= begin_s) & (self.t_s < end_s)
        first, second = (np.abs(self.reference_V - self.outputs)[inside].sum(axis=0) * PERIOD_S).tolist()
        return first, second

    def noise(self, begin_s: float, end_s: float) -> float:
        """Standard deviation of the wanted drives about a straight line, of the noisier pump, V."""
        inside = (self.t_s >= begin_s) & (self.t_s < end_s)
        line = np.polynomial.polynomial.polyfit(self.t_s[inside], self.wanted_V[inside], 1)
        trend = np.polynomial.polynomial.polyval(self.t_s[inside], line).T
        return float(np.max(np.std(self.wanted_V[inside] - trend, axis=0)))

    def overshoot(self, begin_s: float, end_s: float, smallest_V: float = 0.02) -> float:
        """Largest excursion past a reference that moved at begin_s, over the size of its move."""
        inside = (self.t_s >= begin_s) & (self.t_s < end_s)
        before = self.reference_V[np.searchsorted(self.t_s, begin_s - 1e-6) - 1]
        worst = 0.0
        for output in (0, 1):
            move = self.reference_V[inside][0, output] - before[output]
            if abs(move) >= smallest_V:
                past = (self.outputs[inside][:, output] - self.reference_V[inside][:, output]) * np.sign(move)
                worst = max(worst, float(past.max() / abs(move)))
        return worst

    def settled_s(self, begin_s: float, end_s: float, band_V: float = 0.02) -> float:
        """How long after begin_s both outputs stay within band_V of their references."""
        inside = (self.t_s >= begin_s) & (self.t_s < end_s)
        outside = (np.abs(self.reference_V - self.outputs)[inside] > band_V).any(axis=1)
        times = self.t_s[inside][outside]
        return float(times[-1] + PERIOD_S - begin_s) if times.size else 0.0


def drawn(model: TankModel, seed: int, spread: float = 0.03) -> TankModel:
    """A rig that differs from its file: pump gains, splits and outlets by a relative standard deviation."""
    factor = (1.0 + spread * np.random.default_rng(seed).standard_normal(8)).tolist()
    (k1, k2), (g1, g2), outlets = model.pump_gain_cm3_Vs, model.valve_split, model.outlet_cm2
    a1, a2, a3, a4 = (a * f for a, f in zip(outlets, factor[4:], strict=True))
    return replace(
        model,
        pump_gain_cm3_Vs=(k1 * factor[0], k2 * factor[1]),
        valve_split=(min(g1 * factor[2], 0.99), min(g2 * factor[3], 0.99)),
        outlet_cm2=(a1, a2, a3, a4),
    )


def run(
    law: ControlLaw,
    known: TankModel,
    truth: TankModel,
    trial: Trial,
    seed: int = 0,
    detector: FaultDetector | None = None,
) -> Course:
    """One run. known : the tanks of the rig file, for the level filter. truth : those of the rig.

    detector : finds the faults instead of the perfect diagnosis.
    """
    rng = np.random.default_rng(seed)
    level_filter = LevelFilter(known, (LAG_S, LAG_S), 0.5)
    references, gain = References(trial.references), known.level_gain_V_cm
    levels = list(trial.level_cm if trial.level_cm is not None else _at_rest(truth, references.at(0.0)))
    pump_V, given, wanted = list(trial.given_V), trial.given_V, trial.given_V
    rows: list[tuple[float, ...]] = []
    shown: list[dict[str, float]] = []
    y1, y2, y3, y4 = _reading(levels, truth, [0.0] * 4)
    level_V = (y1, y2, y3, y4)
    memory, estimate, authority = None, None, Authority.NOBODY
    diagnosis, followed, alarms = Diagnosis(), Followed(), list[Alarm]()
    found = None if detector is None else detector.start()
    for k in range(round(trial.duration_s / PERIOD_S)):
        t_s, period_s = k * PERIOD_S, PERIOD_S if k else 0.0
        measurement = Measurement(level_V, (True, True, True, True), 0.0, 5)
        estimate = (
            estimator.start(level_filter, measurement, given)
            if estimate is None
            else estimator.step(level_filter, estimate, given, diagnosis.effectiveness, measurement, period_s)
        )
        if detector is None:
            diagnosis = Diagnosis(effectiveness=References(trial.faults).at(t_s - trial.report_s))
        else:
            found, diagnosis = detector.step(found, t_s, measurement, estimate, given)
        alarms += diagnosis.new_alarms
        followed = follow(followed, diagnosis, t_s)
        inputs = LawInputs(
            t_s=t_s,
            period_s=period_s,
            level_cm=(level_V[0] / gain, level_V[1] / gain, level_V[2] / gain, level_V[3] / gain),
            estimate=estimate,
            diagnosis=diagnosis,
            followed=followed,
            reference_V=references.at(t_s),
            requested_V=references.at(t_s),
            references=references,
            wanted_V=wanted,
            given_V=given,
            excess_V=(wanted[0] - given[0], wanted[1] - given[1]) if authority is Authority.LAW else (0.0, 0.0),
            authority=authority,
        )
        if memory is None:
            memory = law.start(inputs)
        memory, request = law.step(memory, inputs)
        wanted, before = request.drive_V, given
        authority, given = _given(trial, t_s, wanted, before)
        rows.append((t_s, *levels, *wanted, *given, *inputs.reference_V, *request.target_V))
        shown.append(dict(request.shown))
        noise = (trial.noise_V * rng.standard_normal((round(PERIOD_S / READING_S), 4))).tolist()
        level_V = _moved(levels, pump_V, given, truth, References(trial.faults).at(t_s), noise, trial.lag_s)
    return _course(rows, shown, alarms, known.level_gain_V_cm)


def _course(rows: list[tuple[float, ...]], shown: list[dict[str, float]], alarms: list[Alarm], gain: float) -> Course:
    """Rows : of a step: time, levels, drives that were wanted and given, references, target."""
    t_s, level_cm, *pairs = np.split(np.array(rows), (1, 5, 7, 9, 11), axis=1)
    wanted_V, given_V, reference_V, target_V = pairs
    return Course(t_s[:, 0], level_cm, wanted_V, given_V, reference_V, target_V, tuple(shown), tuple(alarms), gain)


def _given(trial: Trial, t_s: float, wanted: Pair, before: Pair) -> tuple[Authority, Pair]:
    """Who decides the command, and the command."""
    if trial.manual is not None and trial.manual[0] <= t_s < trial.manual[1]:
        return Authority.OPERATOR, trial.manual[2]
    return Authority.LAW, _allowed(wanted, before)


def _allowed(wanted: Pair, before: Pair) -> Pair:
    """Commands within range and rate."""
    step = RATE_V_S * PERIOD_S
    first, second = (
        min(max(v, old - step, 0.0), old + step, MAX_V) for v, old in zip(wanted, before, strict=True)
    )  # fmt: skip
    return first, second


def _reading(levels: list[float], model: TankModel, noise: list[float]) -> list[float]:
    """(4,) a reading with this noise, to 12 bit; exact without any."""
    k = model.level_gain_V_cm
    if not any(noise):
        return [k * level for level in levels]
    return [max(round((k * level + n) / STEP_V) * STEP_V, 0.0) for level, n in zip(levels, noise, strict=True)]


def _moved(
    levels: list[float],
    pump_V: list[float],
    given: Pair,
    truth: TankModel,
    effectiveness: Pair,
    noise: list[list[float]],
    lag_s: float,
) -> Quad:
    """Advance levels and pumps, in place, by a control period; the mean of the readings on the way."""
    A, a, (k1, k2), (g1, g2) = truth.area_cm2, truth.outlet_cm2, truth.pump_gain_cm3_Vs, truth.valve_split
    c = sqrt(2.0 * truth.gravity_cm_s2)
    total = [0.0, 0.0, 0.0, 0.0]
    for of_reading in noise:
        for pump in (0, 1):
            pump_V[pump] += READING_S / lag_s * (given[pump] - pump_V[pump])
        q1, q2 = effectiveness[0] * k1 * pump_V[0], effectiveness[1] * k2 * pump_V[1]
        out1, out2, out3, out4 = (a[i] * c * sqrt(levels[i]) if levels[i] > 0.0 else 0.0 for i in range(4))
        rates = (out3 + g1 * q1 - out1, out4 + g2 * q2 - out2, (1.0 - g2) * q2 - out3, (1.0 - g1) * q1 - out4)
        for i, rate in enumerate(rates):
            levels[i] = min(max(levels[i] + READING_S * rate / A[i], 0.0), truth.height_cm[i])
        for i, reading in enumerate(_reading(levels, truth, of_reading)):
            total[i] += reading / len(noise)
    y1, y2, y3, y4 = total
    return y1, y2, y3, y4


def _at_rest(truth: TankModel, reference_V: Pair) -> Quad:
    """The levels at which these outputs rest on the true rig."""
    k = truth.level_gain_V_cm
    return equilibrium(truth, holding_voltages(truth, (reference_V[0] / k, reference_V[1] / k)))
